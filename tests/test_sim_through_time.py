"""Newton through time: a motion that remembers itself is the one that frame after frame would give."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
import sim_cases

from sim.cloud import RestCloud
from sim.direct import DirectFactors, Layout
from sim.energy import Energy
from sim.laws.history import Memory, green_strain, largest, viscous
from sim.newton import Equilibrium, NewtonOptions, Status, equilibrate
from sim.recollection import Passing, Recollection
from sim.sensitivity import Past
from sim.through_time import settle

TIME = np.arange(6.0)
TIGHT = NewtonOptions(tolerance=1e-9)
PULLS = np.array([0.0, 0.02, 0.05, 0.05, 0.01, 0.0])[:, None] * np.array([1.0, 0.3, -0.5])


@pytest.fixture(scope="module")
def elastic():
    return sim_cases.elastic()


def behind(F: np.ndarray) -> Memory:
    """A viscous strain that is behind by about a frame."""
    return viscous(TIME, 1.3)


def remembering(
    energy: Energy, share: float, memory: Callable[[np.ndarray], Memory] = behind, elastic: float = 1.0
) -> Callable:  # fmt: skip
    """What `settle` asks, for a material with such a memory of its deformation gradients."""
    stencil, mu = energy.elastic.stencil, share * energy.elastic.m[:, 0]

    def remembered(y: np.ndarray) -> tuple[Energy, Callable[[], Sequence[Past]]]:
        F = energy.elastic.cloud.deformation_gradient(y)
        what = Recollection(stencil=stencil, memory=memory(F), y=y, F=F)
        terms = (*energy.terms, *what.terms(mu, elastic=elastic))
        return replace(energy, terms=terms), lambda: (Passing(what, mu),)

    return remembered


def marched(energy: Energy, share: float, cloud: RestCloud) -> np.ndarray:
    """Frame after frame, each solved by itself with what the frames before it have left."""
    y = sim_cases.at_rest(cloud, len(TIME))
    for t in range(len(TIME)):
        whole = remembering(energy, share)(y)[0]  # of later frames, which change nothing before them
        y[t] = equilibrate(whole.frames(np.array([t])), y[t : t + 1], options=TIGHT).require_converged().y[0]
    return y


def test_the_motion_is_that_of_frames_solved_one_after_the_other(elastic):
    energy, cloud = sim_cases.clamped(elastic, PULLS), elastic.cloud
    found = settle(remembering(energy, 2.0), sim_cases.at_rest(cloud, len(TIME)), Layout.of(elastic), options=TIGHT)
    expected = marched(energy, 2.0, cloud)
    assert found.equilibrium.converged
    assert np.abs(found.equilibrium.y - expected).max() < 1e-8 * np.abs(expected - cloud.x).max()
    plain = equilibrate(energy, sim_cases.at_rest(cloud, len(TIME)), options=TIGHT)
    assert np.abs(plain.y - expected).max() > 0.1 * np.abs(expected - cloud.x).max()  # it does remember


def test_steps_through_time_are_newtons(elastic):
    """With fresh factors the residual falls quadratically, which it would not if frames passed on something else."""
    energy, y = sim_cases.clamped(elastic, PULLS), sim_cases.at_rest(elastic.cloud, len(TIME))
    ask, one, left = remembering(energy, 2.0), NewtonOptions(tolerance=1e-14, iterations=1), []
    for _ in range(4):
        found = settle(ask, y, Layout.of(elastic), options=one).equilibrium
        y = found.y
        left.append(found.residual.max())
    assert left[2] < 10 * left[1] ** 2 and left[3] < max(10 * left[2] ** 2, 1e-11)


def test_factors_of_a_state_nearby_lead_to_the_same_motion(elastic):
    energy, start = sim_cases.clamped(elastic, PULLS), sim_cases.at_rest(elastic.cloud, len(TIME))
    layout = Layout.of(elastic)
    near = settle(remembering(energy, 1.8), start, layout, options=TIGHT)
    ask = remembering(energy, 2.0)
    fresh = settle(ask, start, layout, options=TIGHT).equilibrium
    again = settle(ask, near.equilibrium.y, layout, factors=near.factors, options=TIGHT)
    assert again.factors is near.factors  # they served to the end
    assert sim_cases.relative(again.equilibrium.y, fresh.y) < 1e-8


def test_a_step_that_is_known_to_be_little_is_not_asked_for_again(elastic):
    """What is left to go after a step is known from its test. Where that is little it is gone, and all is done: the
    last step asked for is not little, and the motion is nearer to the exact one than that."""
    energy, start = sim_cases.clamped(elastic, PULLS), sim_cases.at_rest(elastic.cloud, len(TIME))

    def settled(still: float, steps: int = 60) -> Equilibrium:
        options = NewtonOptions(tolerance=1e-9, iterations=steps)
        return settle(remembering(energy, 2.0), start, Layout.of(elastic), options=options, still=still).equilibrium

    def apart(y: np.ndarray, other: np.ndarray) -> float:
        return np.sqrt(((y - other) ** 2).mean())

    exact = settled(0.0).y
    still = 1e-4 * apart(exact, start)
    found = settled(still)
    before = settled(0.0, found.iterations[0] - 1).y
    assert found.converged and apart(found.y, exact) < 0.1 * still < still < apart(found.y, before)


def test_too_few_steps_are_a_status(elastic):
    energy, start = sim_cases.clamped(elastic, PULLS), sim_cases.at_rest(elastic.cloud, len(TIME))
    few = NewtonOptions(tolerance=1e-9, iterations=1)
    found = settle(remembering(energy, 2.0), start, Layout.of(elastic), options=few).equilibrium
    assert not found.converged
    assert {s for s, r in zip(found.status, found.residual, strict=True) if r > 1e-9} == {Status.ITERATIONS}


@pytest.mark.parametrize(("pull", "served"), [(1.0, True), (12.0, False)])
def test_an_impatient_one_stops_where_a_step_leaves_much(elastic, pull, served):
    """A pull that bends the body far makes every step short; what it comes to is the same all the same."""
    energy, start = sim_cases.clamped(elastic, pull * PULLS), sim_cases.at_rest(elastic.cloud, len(TIME))
    ask, layout = remembering(energy, 2.0), Layout.of(elastic)
    soon = settle(ask, start, layout, options=TIGHT, patient=False).equilibrium
    whole = settle(ask, start, layout, options=TIGHT).equilibrium
    assert whole.converged and soon.converged == served
    after = settle(ask, soon.y, layout, options=TIGHT).equilibrium
    assert soon.iterations[0] <= whole.iterations[0] and sim_cases.relative(after.y, whole.y) < 1e-8


def test_an_impatient_one_stops_where_given_factors_lead_nowhere(elastic):
    """Those of a body twenty times as stiff: a step with them is far too short."""
    energy, start = sim_cases.clamped(elastic, PULLS), sim_cases.at_rest(elastic.cloud, len(TIME))
    stiff = energy.with_elastic(elastic.with_parameters(20 * elastic.m))
    ask, layout = remembering(energy, 2.0), Layout.of(elastic)
    given = DirectFactors.of(stiff.tangent(start), layout)
    soon = settle(ask, start, layout, factors=given, options=TIGHT, patient=False).equilibrium
    patient = settle(ask, start, layout, factors=given, options=TIGHT).equilibrium
    assert patient.converged and not soon.converged and soon.iterations[0] == 1 and (soon.y == start).all()


def test_an_unstable_state_is_not_taken_for_an_equilibrium(elastic):
    """Pushed together hard, the body has a tangent that is not positive: nothing is claimed."""
    energy = sim_cases.clamped(elastic, np.repeat([[-3.0, 0.0, 0.0]], len(TIME), axis=0))
    start = sim_cases.at_rest(elastic.cloud, len(TIME))
    start[:, :, 0] *= 0.4
    found = settle(remembering(energy, 0.1), start, Layout.of(elastic), options=TIGHT).equilibrium
    assert not found.converged and Status.LINE_SEARCH in found.status


def test_strains_that_take_turns_are_followed_as_far_as_asked(elastic):
    """Loads as strong from three sides: which strain is the largest turns with the smallest step. What is returned then
    moves by less than asked when every frame is solved with what it remembers held fixed."""
    pulls = 0.02 * np.array([[0, 0, 0], [1, 0, 0], [0, 0.87, 0], [0, 0, 0.95], [1.02, 0, 0], [-0.5, 0.92, 0]])
    energy, layout = sim_cases.clamped(elastic, pulls), Layout.of(elastic)
    ask = remembering(energy, 0.45, lambda F: largest(green_strain(F)), elastic=0.0)
    start = sim_cases.at_rest(elastic.cloud, len(TIME))
    stuck = settle(ask, start, layout, options=TIGHT).equilibrium
    assert not stuck.converged
    moved = np.sqrt(((stuck.y - start) ** 2).mean())
    found = settle(ask, start, layout, options=TIGHT, stalled=5e-3 * moved).equilibrium
    held = equilibrate(ask(found.y)[0], found.y, options=TIGHT).require_converged()
    assert found.converged
    assert np.sqrt(((held.y - found.y) ** 2).mean()) < 5e-3 * moved
    assert not settle(ask, start, layout, options=TIGHT, stalled=1e-6 * moved).equilibrium.converged
