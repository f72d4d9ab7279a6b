"""Derivatives of the equilibrium in the material: adjoint and forward, against finite differences and each other."""

import numpy as np
import pytest
import sim_cases

from sim.adjoint import gradient_check, implicit_gradient, truncated_gradient
from sim.elastic import Elastic
from sim.energy import Energy
from sim.newton import NewtonOptions, equilibrate
from sim.sensitivity import sensitivities
from sim.solvers import LinearSolver

LOADS = np.array([[0.0, 0.01, -0.03], [0.08, -0.02, 0.01]])  # [N]
TIGHT = NewtonOptions(tolerance=1e-11)


@pytest.fixture(scope="module")
def energy() -> Energy:
    return sim_cases.clamped(sim_cases.elastic(), LOADS)


@pytest.fixture(scope="module")
def state(energy) -> np.ndarray:
    return equilibrate(energy, sim_cases.at_rest(energy.elastic.cloud, 2), options=TIGHT).y


def loss(y: np.ndarray) -> tuple[float, np.ndarray]:
    """A loss without symmetry, different in every coordinate and not quadratic, and its derivative."""
    a = np.random.default_rng(3).uniform(0.5, 1.5, y.shape)
    return float((a * np.sin(2 * y) + y**2).sum()), 2 * a * np.cos(2 * y) + 2 * y


def solved_loss(energy: Energy, m: np.ndarray, start: np.ndarray) -> float:
    return loss(equilibrate(energy.with_elastic(energy.elastic.with_parameters(m)), start, options=TIGHT).y)[0]


def difference(energy: Energy, start: np.ndarray, change: np.ndarray, step: float) -> float:
    """The loss's slope along a change of log m, by fourth-order central differences."""
    m = energy.elastic.m

    def value(h: float) -> float:
        return solved_loss(energy, m * np.exp(h * change), start)

    return (8 * (value(step) - value(-step)) - (value(2 * step) - value(-2 * step))) / (12 * step)


@pytest.mark.parametrize("linear", ["direct", "two-level"])
def test_adjoint_is_the_finite_difference_along_a_random_change(energy, state, linear):
    change = np.random.default_rng(0).normal(size=energy.elastic.m.shape)
    got = implicit_gradient(energy, state, loss(state)[1], solver=LinearSolver.of(energy, linear))
    wanted = difference(energy, state, change, 3e-3)
    assert abs((got * energy.elastic.m * change).sum() / wanted - 1) < 1e-6


@pytest.mark.parametrize("column", [0, 1])
def test_adjoint_is_the_finite_difference_at_the_points_that_matter_most(energy, state, column):
    got = implicit_gradient(energy, state, loss(state)[1]) * energy.elastic.m
    for point in np.argsort(np.abs(got[:, column]))[[-1, -20]]:
        change = np.zeros_like(got)
        change[point, column] = 1.0
        assert abs(got[point, column] / difference(energy, state, change, 2e-2) - 1) < 1e-5


def test_loss_follows_the_adjoint_to_second_order(energy, state):
    m = energy.elastic.m
    change = 0.3 * m * np.random.default_rng(1).normal(size=m.shape)
    slope = (implicit_gradient(energy, state, loss(state)[1]) * change).sum()
    assert sim_cases.taylor_rate(lambda n: solved_loss(energy, n, state), slope, m, change, step=1e-1) > 1.9


def test_adjoint_needs_the_exact_hessian_not_the_projected_one(energy, state):
    slope, m = energy.free(-loss(state)[1]), energy.elastic.m
    projected = energy.tangent(state, np.ones(2, bool))
    w = LinearSolver.of(energy, "direct").preconditioner(projected)(slope)
    wrong = energy.elastic.parameter_gradient(state, w) * m
    right = implicit_gradient(energy, state, loss(state)[1]) * m
    assert sim_cases.relative(wrong, right) > 1e-4


def test_adjoint_adds_up_over_frames(energy, state):
    slope = loss(state)[1]
    parts = sum(
        implicit_gradient(energy.frames(np.array([t])), state[t : t + 1], slope[t : t + 1]) for t in range(2)
    )
    assert sim_cases.relative(implicit_gradient(energy, state, slope), parts) < 1e-8


def test_adjoint_sees_no_loss_at_fixed_points_and_leaves_it_untouched(energy, state):
    slope = np.zeros_like(state)
    slope[:, energy.fixed] = 1.0
    assert (implicit_gradient(energy, state, slope) == 0).all()
    assert (slope[:, energy.fixed] == 1.0).all()


def test_gradient_check_is_small_for_the_adjoint(energy, state):
    assert gradient_check(energy, state, loss) < 1e-6


def test_gradient_check_sees_a_wrong_derivative(energy, state):
    assert gradient_check(energy, state, lambda y: (loss(y)[0], 1.01 * loss(y)[1])) == pytest.approx(0.01, rel=1e-2)


def test_papers_truncated_sum_is_several_times_too_long(energy, state):
    slope = loss(state)[1]
    right = implicit_gradient(energy, state, slope)
    truncated = truncated_gradient(energy, sim_cases.at_rest(energy.elastic.cloud, 2), slope)
    ratio = np.linalg.norm(truncated) / np.linalg.norm(right)
    cosine = (truncated * right).sum() / np.linalg.norm(truncated) / np.linalg.norm(right)
    assert ratio > 2, f"the truncated sum has {ratio:.2f} times the norm of the adjoint, cosine {cosine:.3f}"


def test_one_step_from_the_solution_the_truncated_sum_is_the_adjoint(energy, state):
    m = energy.elastic.m
    moved = energy.with_elastic(energy.elastic.with_parameters(1.0001 * m))
    one = NewtonOptions(iterations=1, tolerance=1e-12)
    slope = loss(state)[1]
    got = truncated_gradient(moved, state, slope, options=one)
    assert sim_cases.relative(got, implicit_gradient(energy, state, slope)) < 1e-2


def directions(elastic: Elastic, count: int = 3) -> np.ndarray:
    return elastic.m * np.random.default_rng(2).normal(size=(count, *elastic.m.shape))


@pytest.mark.parametrize(("wrong", "close"), [(1e-3, 1e-4), (0.0, 1e-8)])  # in single precision, and in double
def test_forward_sensitivities_agree_with_the_adjoint(energy, state, wrong, close, monkeypatch):
    monkeypatch.setattr("sim.direct._DIGITS", wrong)
    slope, ways = loss(state)[1], directions(energy.elastic)
    forward = sum((S * s).sum(axis=(1, 2)) for S, s in zip(sensitivities(energy, state, ways), slope, strict=True))
    adjoint = (ways * implicit_gradient(energy, state, slope)).sum(axis=(1, 2))
    assert forward == pytest.approx(adjoint, rel=close)


def test_equilibrium_follows_its_sensitivity_to_second_order(energy, state):
    way = 0.3 * directions(energy.elastic, 1)[0]
    slope = np.stack([S[0] for S in sensitivities(energy, state, way[None])])

    def solve(m: np.ndarray) -> np.ndarray:
        return equilibrate(energy.with_elastic(energy.elastic.with_parameters(m)), state, options=TIGHT).y

    assert sim_cases.taylor_rate(solve, slope, energy.elastic.m, way, step=1e-1) > 1.9


def test_sensitivities_do_not_depend_on_how_many_frames_go_together(energy, state, monkeypatch):
    ways, twice = directions(energy.elastic), energy.frames(np.array([0, 1, 0, 1]))
    together = np.stack(list(sensitivities(twice, np.concatenate([state, state]), ways)))
    monkeypatch.setattr("sim.sensitivity._AT_ONCE", 1)  # by two, the least
    assert (np.stack(list(sensitivities(twice, np.concatenate([state, state]), ways))) == together).all()


def test_a_frame_at_rest_tells_nothing_of_a_stiffness_but_answers_to_a_force(energy, state):
    ways, x = directions(energy.elastic), energy.elastic.cloud.x
    both = np.stack([x, state[0]])
    found = np.stack(list(sensitivities(energy, both, ways)))
    assert (found[0] == 0).all()
    assert sim_cases.relative(found[1], next(sensitivities(energy, state, ways))) < 1e-12
    push = np.zeros((2, 1, len(x), 3))
    push[:, 0, -1] = 1e-3
    answer = list(sensitivities(energy, both, ways, more=push))
    assert np.abs(answer[0][len(ways)]).max() > 0
