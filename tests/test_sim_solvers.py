"""Factors that are kept from solve to solve: the same equilibria, and made anew only where they are worn."""

import numpy as np
import pytest
import sim_cases

from sim.direct import DirectFactors
from sim.energy import Energy
from sim.linear import conjugate_gradients
from sim.newton import NewtonOptions, equilibrate
from sim.solvers import KeptSolver, LinearSolver

LOADS = np.array([[0.0, 0.0, 0.0], [0.0, 0.008, -0.02], [0.05, -0.01, 0.006], [0.0, 0.0, -0.01]])  # [N], about 1 Pa
FRAMES = len(LOADS)
TIGHT = NewtonOptions(tolerance=1e-9)


@pytest.fixture(scope="module")
def energy() -> Energy:
    return sim_cases.clamped(sim_cases.elastic(), LOADS)


@pytest.fixture
def made(monkeypatch) -> list[int]:
    """How many frames were factorised, each time that any were."""
    counts, of = [], DirectFactors.of

    def counted(tangent, layout, **options):
        counts.append(len(tangent.y))
        return of(tangent, layout, **options)

    monkeypatch.setattr(DirectFactors, "of", counted)
    return counts


def softer(energy: Energy, share: float) -> Energy:
    return energy.with_elastic(energy.elastic.with_parameters(share * energy.elastic.m))


def test_equilibria_are_those_of_fresh_factors_which_are_made_once(energy, made):
    """While the body gets softer by a third, and then as stiff as it was; the frame at rest never needs one."""
    rest = sim_cases.at_rest(energy.elastic.cloud, FRAMES)
    solver, y = KeptSolver.of(energy, FRAMES), equilibrate(energy, rest).require_converged().y
    made.clear()
    for share in (0.95, 0.8, 0.7, 0.9, 1.0):
        problem = softer(energy, share)
        y = equilibrate(problem, y, options=TIGHT, solver=solver).require_converged().y
        kept = len(made)
        fresh = equilibrate(problem, y, options=TIGHT, solver=LinearSolver.of(energy, "two-level"))
        again = equilibrate(problem, rest, options=TIGHT)
        del made[kept:]
        assert np.abs(y - again.require_converged().y).max() < 1e-6 * energy.elastic.cloud.spacing
        assert (fresh.iterations == 0).all()  # it was there already
    assert made == [FRAMES - 1]


def test_only_worn_factors_are_made_anew(energy, made):
    y = equilibrate(energy, sim_cases.at_rest(energy.elastic.cloud, FRAMES)).require_converged().y
    made.clear()
    solver = KeptSolver.of(energy, FRAMES)
    y = equilibrate(softer(energy, 0.95), y, options=TIGHT, solver=solver).require_converged().y
    before = solver.held.rows.copy()
    solver.spent(np.arange(FRAMES), np.array([0, 3, 100, 3]))
    equilibrate(softer(energy, 0.9), y, options=TIGHT, solver=solver).require_converged()
    assert made == [FRAMES - 1, 1]
    assert (before[1:] == solver.held.rows[1:]).all(axis=1).tolist() == [True, False, True]


def test_factors_of_quite_another_material_are_given_up_soon(energy, made, monkeypatch):
    """One end becomes a hundred times as stiff: conjugate gradients with the old factors would take over a hundred."""
    steps = []

    def counted(*given, **more):
        steps.append(conjugate_gradients(*given, **more))
        return steps[-1]

    monkeypatch.setattr("sim.newton.conjugate_gradients", counted)
    share = np.where(energy.elastic.cloud.x[:, :1] > np.median(energy.elastic.cloud.x[:, 0]), 100.0, 1.0)
    other, rest = softer(energy, share), sim_cases.at_rest(energy.elastic.cloud, FRAMES)
    solver = KeptSolver.of(energy, FRAMES)
    equilibrate(energy, rest, options=TIGHT, solver=solver).require_converged()
    expected = equilibrate(other, rest, options=TIGHT).require_converged().y
    made.clear()
    steps.clear()
    found = equilibrate(other, rest, options=TIGHT, solver=solver).require_converged()
    assert np.abs(found.y - expected).max() < 1e-6 * energy.elastic.cloud.spacing
    assert made[0] == FRAMES - 1 and max(s.iterations.max() for s in steps) == 25
    assert all(s.converged.all() for s in steps[1:])
    monkeypatch.setattr("sim.solvers._PATIENT", 400)
    again = KeptSolver.of(energy, FRAMES)
    equilibrate(energy, rest, options=TIGHT, solver=again)
    steps.clear()
    equilibrate(other, rest, options=TIGHT, solver=again)
    assert steps[0].iterations.max() > 100


def test_factors_that_have_no_room_are_not_kept(energy, monkeypatch):
    monkeypatch.setattr("sim.solvers.ROOM", FRAMES * energy.elastic.cloud.count)
    assert isinstance(KeptSolver.of(energy, FRAMES), KeptSolver)
    assert isinstance(KeptSolver.of(energy, FRAMES + 1), LinearSolver)
    assert isinstance(KeptSolver.of(energy, FRAMES, "two-level"), LinearSolver)


def test_a_solver_keeps_the_factors_of_its_own_frames_only(energy):
    solver = KeptSolver.of(energy, FRAMES + 1)
    with pytest.raises(ValueError, match=f"frames must be the {FRAMES + 1} of the solver; got {FRAMES}"):
        equilibrate(energy, sim_cases.at_rest(energy.elastic.cloud, FRAMES), solver=solver)
