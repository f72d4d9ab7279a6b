"""Equilibria: closed forms, independence of start and batch, statuses in sentences, and the same bits twice."""

from dataclasses import dataclass

import clouds
import fem_scenes
import numpy as np
import pytest
import sim_cases

from sim.cloud import RestCloud
from sim.elastic import Elastic
from sim.energy import Energy
from sim.lame import Lame
from sim.newton import NewtonOptions, NotConverged, Status, equilibrate
from sim.terms.handles import Handles
from sim.terms.loads import AppliedForce

LOADS = np.array([[0.0, 0.008, -0.02], [0.05, -0.01, 0.006], [0.0, 0.0, 0.0]])  # [N] on a body of about 1 Pa


@pytest.fixture(scope="module")
def energy() -> Energy:
    return sim_cases.clamped(sim_cases.elastic(), LOADS)


@pytest.fixture(scope="module")
def solved(energy):
    return equilibrate(energy, sim_cases.at_rest(energy.elastic.cloud, 3))


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance of two states in spacings."""
    return float(np.linalg.norm(a - b, axis=-1).max() / sim_cases.cloud().spacing)


def test_solution_balances_elasticity_and_load(energy, solved):
    assert solved.converged
    out_of_balance = energy.elastic.gradient(solved.y) - energy.terms[0].force
    out_of_balance[:, energy.fixed] = 0.0
    assert np.linalg.norm(out_of_balance) < 1e-8 * np.linalg.norm(energy.terms[0].force)
    assert distance(solved.y[0], energy.elastic.cloud.x) > 1  # the load does something


def test_support_carries_the_whole_load(energy, solved):
    reaction = energy.elastic.gradient(solved.y)[:, energy.fixed].sum(axis=1)
    on_support = energy.terms[0].force[:, energy.fixed].sum(axis=1)
    assert reaction == pytest.approx(on_support - LOADS, abs=1e-9)


def test_equilibrium_is_a_minimum(energy, solved):
    here, random = energy.value(solved.y)[0], np.random.default_rng(0)
    for size in (1e-3, 1e-2):
        moved = solved.y + size * energy.free(random.normal(size=solved.y.shape)) * energy.elastic.cloud.spacing
        assert (energy.value(moved)[0] > here).all()


@pytest.mark.parametrize("linear", ["direct", "two-level"])
def test_equilibrium_does_not_depend_on_the_start(energy, solved, linear):
    x, random = energy.elastic.cloud.x, np.random.default_rng(1)
    wave = 0.05 * np.sin(4 * x @ random.normal(size=(3, 3)))
    start = x + wave + 0.05 * energy.elastic.cloud.spacing * random.normal(size=(2, *x.shape))
    again = equilibrate(energy.frames(np.arange(2)), start, options=NewtonOptions(linear=linear))
    assert again.converged, again.sentence
    assert distance(again.y, solved.y[:2]) < 1e-5


@pytest.mark.parametrize("size", [1e-6, 0.05])
def test_unloaded_body_returns_to_rest_from_a_rough_start(energy, size):
    x, still = energy.elastic.cloud.x, energy.frames(np.array([2]))
    start = x + size * energy.elastic.cloud.spacing * np.random.default_rng(0).normal(size=(1, *x.shape))
    result = equilibrate(still, start, options=NewtonOptions(linear="two-level"))
    assert distance(result.y, x) < 1e-6
    assert result.converged, result.sentence


def test_batch_is_frame_by_frame(energy, solved):
    for t in range(3):
        alone = equilibrate(energy.frames(np.array([t])), sim_cases.at_rest(energy.elastic.cloud, 1))
        assert alone.iterations[0] == solved.iterations[t]
        assert distance(alone.y[0], solved.y[t]) < 1e-9


def test_two_runs_agree_to_the_bit(energy):
    start = sim_cases.at_rest(energy.elastic.cloud, 3)
    for linear in ("direct", "two-level"):
        options = NewtonOptions(linear=linear)
        first, second = (equilibrate(energy, start, options=options) for _ in range(2))
        assert (first.y == second.y).all()
        assert (first.residual == second.residual).all()


def test_unloaded_frame_stays_at_rest_without_a_step(solved):
    assert solved.iterations[2] == 0
    assert solved.status[2] is Status.CONVERGED
    assert (solved.y[2] == sim_cases.cloud().x).all()


def test_start_at_the_solution_takes_no_step_and_is_left_untouched(energy, solved):
    start = solved.y.copy()
    again = equilibrate(energy, start)
    assert (again.iterations == 0).all()
    assert (start == solved.y).all()


def test_fixed_points_stay_where_they_were(energy):
    start = sim_cases.at_rest(energy.elastic.cloud, 3) + 1e-3
    y = equilibrate(energy, start).y
    assert (y[:, energy.fixed] == energy.elastic.cloud.x[energy.fixed]).all()


def test_no_point_is_turned_inside_out_under_a_heavy_load():
    energy = sim_cases.clamped(sim_cases.elastic(), np.array([[-0.4, 0.1, 0.0], [0.3, 0.0, -0.3]]))
    result = equilibrate(energy, sim_cases.at_rest(energy.elastic.cloud, 2))
    assert result.converged, result.sentence
    assert (energy.value(result.y)[1] > 0).all()


def pulled_block(stress: np.ndarray, F: np.ndarray) -> tuple[Energy, np.ndarray]:
    """A free homogeneous block under the tractions of a uniform stress, its pose set by handles at F x."""
    cloud = sim_cases.cloud("poisson")
    ends = np.argsort(cloud.x @ [1.0, 0.3, 0.1])[[0, 1, 2, -3, -2, -1]]
    handles = Handles(points=ends, targets=(cloud.x[ends] @ F.T)[None], alpha=np.full(len(ends), 0.1))
    force = AppliedForce(force=(cloud.area @ stress.T)[None])
    energy = Energy.of(Elastic.neo_hookean(cloud, Lame(mu=1.3, lam=2.1)), [force, handles])
    return energy, (cloud.x @ F.T)[None]


@pytest.mark.parametrize("stress", [-0.3, 0.6])
def test_uniaxial_tension_is_its_closed_form(stress):
    a, b = fem_scenes.uniaxial_stretch(stress, 1.3, 2.1)
    energy, exact = pulled_block(np.diag([stress, 0, 0]), np.diag([a, b, b]))
    result = equilibrate(energy, sim_cases.at_rest(energy.elastic.cloud, 1))
    assert result.converged
    assert distance(result.y, exact) < 1e-4


def test_turned_and_sheared_patch_is_found_from_a_rough_start():
    F = clouds.rotation(0.6) @ np.array([[1.2, 0.2, 0.0], [0.0, 0.9, 0.1], [0.1, 0.0, 1.05]])
    J, H = np.linalg.det(F), np.linalg.inv(F).T
    energy, exact = pulled_block(1.3 * (F - H) + 2.1 * (J - 1) * J * H, F)
    rough = exact + 0.1 * energy.elastic.cloud.spacing * np.random.default_rng(0).normal(size=exact.shape)
    result = equilibrate(energy, rough)
    assert result.converged
    assert distance(result.y, exact) < 1e-4


def test_previous_solution_of_a_near_load_saves_steps(energy, solved):
    near = sim_cases.clamped(energy.elastic, 1.05 * LOADS)
    cold = equilibrate(near, sim_cases.at_rest(energy.elastic.cloud, 3))
    warm = equilibrate(near, solved.y)
    assert warm.iterations.sum() < cold.iterations.sum()
    assert distance(warm.y, cold.y) < 1e-5


def test_iteration_limit_is_a_status_with_a_sentence(energy):
    result = equilibrate(energy, sim_cases.at_rest(energy.elastic.cloud, 3), options=NewtonOptions(iterations=1))
    assert result.status == (Status.ITERATIONS, Status.ITERATIONS, Status.CONVERGED)
    assert not result.converged
    assert result.sentence.startswith("2 of 3 frames did not converge; frame 0 stopped at the iteration limit")
    assert np.isfinite(result.y).all()
    start = energy.value(sim_cases.at_rest(energy.elastic.cloud, 3))[0]
    assert (energy.value(result.y)[0][:2] < start[:2]).all()  # the one step that it took is kept
    with pytest.raises(NotConverged, match="2 of 3 frames did not converge") as raised:
        result.require_converged()
    assert raised.value.equilibrium is result


def test_converged_solution_passes_on_request(solved):
    assert solved.require_converged() is solved
    assert solved.sentence == f"all 3 frames converged in at most {solved.iterations.max()} steps"


def test_start_inside_out_is_a_status_of_its_frame(energy):
    start = sim_cases.at_rest(energy.elastic.cloud, 3)
    start[1, :, 1] *= -1
    result = equilibrate(energy, start)
    assert result.status == (Status.CONVERGED, Status.INVERTED, Status.CONVERGED)
    assert "frame 1 stopped because the start state is inside out" in result.sentence


@dataclass(frozen=True)
class Lying:
    """A load whose gradient has the wrong sign."""

    force: AppliedForce

    def value(self, y):
        return -self.force.value(y)

    def gradient(self, y):
        return self.force.gradient(y)

    def tangent(self, y, project=None):
        return None

    def frames(self, index):
        return Lying(self.force.frames(index))


def test_direction_that_never_lowers_the_energy_is_a_status(energy):
    wrong = Energy.of(energy.elastic, [Lying(energy.terms[0])], energy.fixed)
    result = equilibrate(wrong, sim_cases.at_rest(energy.elastic.cloud, 3))
    assert result.status[:2] == (Status.LINE_SEARCH, Status.LINE_SEARCH)
    assert "no step along the Newton direction lowered the energy" in result.sentence


def test_progress_hears_of_every_step(energy):
    heard = []
    start = sim_cases.at_rest(energy.elastic.cloud, 3)
    result = equilibrate(energy, start, progress=lambda step, residual: heard.append((step, residual.max())))
    assert [step for step, _ in heard] == list(range(result.iterations.max() + 1))
    assert heard[-1][1] == result.residual.max()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda y: y[:, :5], r"start must have shape \(any, 200, 3\); got \(1, 5, 3\)|start must have shape"),
        (lambda y: y * np.nan, r"start must be finite"),
        (lambda y: y[0], r"start must have shape"),
    ],
)
def test_bad_start_ends_in_a_sentence(energy, change, sentence):
    with pytest.raises(ValueError, match=sentence):
        equilibrate(energy.frames(np.array([0])), change(sim_cases.at_rest(energy.elastic.cloud, 1)))


@pytest.mark.parametrize("options", [{"tolerance": 0.0}, {"tolerance": 1.0}, {"iterations": 0}])
def test_impossible_options_end_in_a_sentence(options):
    with pytest.raises(ValueError, match=f"{next(iter(options))} must"):
        NewtonOptions(**options)


def test_object_that_nothing_holds_is_named():
    with pytest.raises(ValueError, match=r"fixed must hold every connected part .* move rigidly; got 1 free part"):
        Energy.of(sim_cases.elastic())


def test_loose_part_is_named_by_its_points():
    x = clouds.block((4, 4, 4), (0.3, 0.3, 0.3))
    cloud = RestCloud.build(np.concatenate([x, x + np.array([5.0, 0, 0])]))
    with pytest.raises(ValueError, match=r"got 1 free part\(s\): points 64, 65, 66, 67, 68 and 59 more"):
        Energy.of(Elastic.neo_hookean(cloud, Lame(mu=1.0, lam=1.0)), [], cloud.x[:, 0] < 1e-9)


def test_object_without_free_points_is_named():
    with pytest.raises(ValueError, match=r"fixed must leave some points free to move"):
        Energy.of(sim_cases.elastic(), [], np.ones(sim_cases.cloud().count, bool))
