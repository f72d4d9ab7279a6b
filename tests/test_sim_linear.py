"""Linear solves against scipy, how iterations grow, and what is said about indefinite Hessians."""

from dataclasses import dataclass

import clouds
import numpy as np
import pytest
import scipy.sparse as sp
import sim_cases
from scipy.sparse.linalg import spsolve

from sim.direct import DirectFactors, Layout, solve_directly
from sim.elastic import Elastic
from sim.energy import Energy, Tangent
from sim.lame import Lame
from sim.linear import conjugate_gradients
from sim.solvers import LinearSolver
from sim.terms.handles import Handles
from sim.twolevel import TwoLevel

KINDS = ("two-level", "direct")


def twisted(x: np.ndarray) -> np.ndarray:
    """Turned by 100 degrees, stretched and twisted along the axis: far from rest yet convex, (N, 3) [m]."""
    middle = x - [0.0, *sim_cases.SIZE[1:] / 2]
    turns = np.array([clouds.rotation(0.3 * a, (1.0, 0.0, 0.0)) for a in x[:, 0]])
    return np.einsum("nab,nb->na", turns, middle * [1.1, 1.0, 1.0]) @ clouds.rotation(1.75).T


def held(elastic: Elastic, frames: int = 2, grip: float = 0.0) -> Tangent:
    """The tangent of a body clamped at x = 0 in twisted states, some points held by handles of stiffness grip."""
    x = elastic.cloud.x
    y = np.stack([twisted(x) * (1 + 0.05 * t) for t in range(frames)])
    ends = np.flatnonzero(x[:, 0] > x[:, 0].max() - 1e-9)
    handles = Handles(points=ends, targets=y[:, ends], alpha=np.full(len(ends), grip))
    return Energy.of(elastic, [handles], x[:, 0] < 1e-9).tangent(y)


def right_side(tangent: Tangent, seed: int = 0) -> np.ndarray:
    return tangent.energy.free(np.random.default_rng(seed).normal(size=tangent.y.shape))


def scipy_matrix(tangent: Tangent, frame: int) -> sp.csc_matrix:
    """The Hessian's free rows and columns, from products with unit vectors."""
    free = np.flatnonzero(np.repeat(~tangent.energy.fixed, 3))
    T, N = tangent.y.shape[:2]
    unit = np.zeros((T, N, 3))
    columns = []
    for place in free:
        unit.reshape(T, -1)[:, place] = 1.0
        columns.append(tangent.product(unit)[frame].ravel()[free])
        unit.reshape(T, -1)[:, place] = 0.0
    return sp.csc_matrix(np.stack(columns, axis=1))


@pytest.fixture(scope="module")
def tangent() -> Tangent:
    return held(sim_cases.elastic(), grip=0.7)


@pytest.fixture(scope="module")
def exact(tangent) -> np.ndarray:
    """scipy's solution of the right side, (T, N, 3)."""
    right, free = right_side(tangent), ~tangent.energy.fixed
    out = np.zeros_like(right)
    for t in range(len(right)):
        out[t, free] = spsolve(scipy_matrix(tangent, t), right[t, free].ravel()).reshape(-1, 3)
    return out


@pytest.mark.parametrize("kind", KINDS)
def test_solution_is_the_one_of_scipy(kind, tangent, exact):
    precondition = LinearSolver.of(tangent.energy, kind).preconditioner(tangent)
    solve = conjugate_gradients(tangent.product, right_side(tangent), precondition, tolerance=1e-12)
    assert solve.converged.all()
    assert not solve.curved.any()
    assert sim_cases.relative(solve.x, exact) < 1e-8


def test_direct_factors_are_the_inverse_for_one_and_for_many(tangent, exact, monkeypatch):
    layout, right, both = Layout.of(tangent.energy.elastic), right_side(tangent), np.stack([exact, 2 * exact], axis=1)
    factors = DirectFactors.of(tangent, layout)
    assert sim_cases.relative(factors(right), exact) < 1e-5
    assert sim_cases.relative(DirectFactors.of(tangent, layout, exact=True)(right), exact) < 1e-9
    many = np.stack([right, 2 * right], axis=1)
    assert sim_cases.relative(solve_directly(tangent, layout, many), both) < 1e-5
    monkeypatch.setattr("sim.direct._DIGITS", 0.0)  # none may be wrong: double precision
    assert sim_cases.relative(solve_directly(tangent, layout, many), both) < 1e-9
    assert (factors.frames(np.array([1]))(right[1:]) == factors(right)[1:]).all()


@pytest.mark.filterwarnings("error")
def test_direct_solves_know_right_sides_of_any_size(tangent, exact):
    """In single precision the smallest would be nothing and the largest infinite; one of several may be nothing."""
    sizes = np.array([1e-70, 0.0, 1.0, 1e70])[:, None, None]
    found = solve_directly(tangent, Layout.of(tangent.energy.elastic), sizes * right_side(tangent)[:, None])
    assert not found[:, 1].any()
    for k in (0, 2, 3):
        assert sim_cases.relative(found[:, k] / sizes[k], exact) < 1e-5


@dataclass(frozen=True)
class Given:
    """What direct solves ask of a tangent, for given blocks (T, M, 3, 3)."""

    blocks: np.ndarray

    @property
    def y(self) -> np.ndarray:
        return self.blocks

    def assembled(self, frames: slice) -> np.ndarray:
        return self.blocks[frames]


@pytest.mark.parametrize("left", [1e-3, 1e-6, 1e-9])
def test_direct_solves_keep_three_digits_next_to_where_the_body_buckles(left, tangent):
    """Most of the lowest stiffness is taken away: single precision then has no digit left."""
    layout = Layout.of(tangent.energy.elastic)
    blocks = tangent.assembled(slice(0, 1))
    lowest = np.linalg.eigvalsh(layout.matrix(blocks[0]).toarray())[0]
    blocks[0, layout.pattern.rows == layout.pattern.indices] -= (1 - left) * lowest * np.eye(3)
    right = right_side(tangent)[:1]
    found = solve_directly(Given(blocks), layout, np.stack([right, right_side(tangent, 1)[:1]], axis=1))
    exact = spsolve(layout.matrix(blocks[0]), right.ravel()).reshape(right.shape)
    assert sim_cases.relative(found[:, 0], exact) < 1e-3


def test_direct_solves_give_their_memory_back(tangent):
    resource = pytest.importorskip("resource")
    layout, right = Layout.of(tangent.energy.elastic), right_side(tangent)[:, None]

    def peak() -> float:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # [MB] on Linux

    size = DirectFactors.of(tangent, layout).rows.nbytes / 2**20  # [MB]
    for _ in range(5):
        solve_directly(tangent, layout, right)
    before = peak()
    for _ in range(50):
        solve_directly(tangent, layout, right)
    assert peak() - before < 10 * size


@pytest.mark.parametrize("kind", KINDS)
def test_preconditioner_is_symmetric_and_positive(kind, tangent):
    precondition = LinearSolver.of(tangent.energy, kind).preconditioner(tangent)
    a, b = right_side(tangent, 1), right_side(tangent, 2)
    ab, ba, aa = (np.einsum("tna,tna->t", p, precondition(q)) for p, q in ((a, b), (b, a), (a, a)))
    # Factors are in single precision; the coarse inverse is rounded in nearly empty motions.
    assert ab == pytest.approx(ba, rel={"direct": 1e-5, "two-level": 1e-7}[kind])
    assert (aa > 0).all()


def test_frames_are_solved_as_if_alone(tangent):
    right, energy, solver = right_side(tangent), tangent.energy, LinearSolver.of(tangent.energy, "two-level")
    both = conjugate_gradients(tangent.product, right, solver.preconditioner(tangent))
    part = energy.frames(np.array([1])).tangent(tangent.y[1:])
    alone = conjugate_gradients(part.product, right[1:], solver.preconditioner(part))
    assert alone.iterations[0] == both.iterations[1]
    assert sim_cases.relative(both.x[1:], alone.x) < 1e-6  # within the tolerance of both


@pytest.mark.parametrize("kind", KINDS)
def test_frames_that_have_stopped_are_left_out(kind, tangent):
    right, swept, goals = right_side(tangent), [], np.array([1e-9, 1e-2])
    elsewhere = LinearSolver.of(tangent.energy, kind).preconditioner(tangent.energy.tangent(1.02 * tangent.y))
    precondition = elsewhere.frames(np.arange(2), tangent)

    def part(frames):
        swept.append(frames.tolist())
        some = tangent.energy.frames(frames).tangent(tangent.y[frames])
        return some.product, precondition.frames(frames, some)

    fewer = conjugate_gradients(tangent.product, right, precondition, tolerance=goals, part=part)
    every = conjugate_gradients(tangent.product, right, precondition, tolerance=goals)
    assert swept == [[0]] and fewer.converged.all() and (fewer.iterations == every.iterations).all()
    assert sim_cases.relative(fewer.x, every.x) < 1e-12


def test_solver_is_chosen_by_size_and_by_how_many_frames_there_are(tangent, monkeypatch):
    energy, large = tangent.energy, held(sim_cases.elastic("poisson", count=1000), frames=1)
    assert isinstance(LinearSolver.of(energy).preconditioner(tangent), DirectFactors)
    assert isinstance(LinearSolver.of(large.energy).preconditioner(large), TwoLevel)
    monkeypatch.setattr("sim.solvers.ROOM", tangent.y.shape[1])  # of one frame; there are two
    assert isinstance(LinearSolver.of(energy).preconditioner(tangent), TwoLevel)
    assert isinstance(LinearSolver.of(energy, "direct").preconditioner(tangent), DirectFactors)


def test_factors_serve_again_only_where_a_frame_is_near_its_solution(tangent):
    solver, right = LinearSolver.of(tangent.energy, "direct"), right_side(tangent)
    last = solver.preconditioner(tangent.energy.tangent(1.02 * tangent.y))
    before = last(right)
    following = solver.following(last, tangent.energy, tangent, np.array([1e-3, 0.5]))(right)
    assert (following[0] == before[0]).all()
    assert (following[1] == solver.preconditioner(tangent)(right)[1]).all()


def test_fixed_points_do_not_move(tangent):
    precondition = LinearSolver.of(tangent.energy, "two-level").preconditioner(tangent)
    solve = conjugate_gradients(tangent.product, right_side(tangent), precondition)
    assert (solve.x[:, tangent.energy.fixed] == 0).all()


def test_nothing_to_solve_takes_no_step(tangent):
    solve = conjugate_gradients(tangent.product, 0 * tangent.y, lambda r: r)
    assert solve.converged.all() and not solve.iterations.any() and not solve.x.any()


def iterations(count: int, contrast: float) -> int:
    """Steps of two-level conjugate gradients to 1e-8; one half of the body is `contrast` times stiffer."""
    cloud = sim_cases.cloud("poisson", count=count)
    mu = np.where(cloud.x[:, 0] < sim_cases.SIZE[0] / 2, 1.0, contrast)
    tangent = held(Elastic.neo_hookean(cloud, Lame(mu=mu, lam=2 * mu)), frames=1)
    precondition = LinearSolver.of(tangent.energy, "two-level").preconditioner(tangent)
    solve = conjugate_gradients(tangent.product, right_side(tangent), precondition)
    assert solve.converged.all()
    return int(solve.iterations[0])


def test_iterations_barely_grow_with_points_and_contrast():
    base = iterations(500, 1.0)
    grown = {(n, c): iterations(n, c) for n, c in ((500, 100.0), (4000, 1.0), (4000, 100.0))}
    assert max(grown.values()) <= 2 * base, f"{base} iterations at 500 points; {grown}"


@pytest.mark.parametrize("kind", KINDS)
def test_negative_curvature_is_reported_in_its_frame(kind):
    elastic = sim_cases.elastic()
    y = np.stack([elastic.cloud.x, elastic.cloud.x * [0.45, 1.0, 1.0]])  # the second wants to buckle
    tangent = Energy.of(elastic, [], elastic.cloud.x[:, 0] < 1e-9).tangent(y)
    values, vectors = np.linalg.eigh(scipy_matrix(tangent, 1).toarray())
    assert values[0] < -1e-3 * values[-1]
    right = np.zeros_like(y)
    right[:, ~tangent.energy.fixed] = vectors[:, 0].reshape(-1, 3)
    precondition = LinearSolver.of(tangent.energy, kind).preconditioner(tangent)
    solve = conjugate_gradients(tangent.product, right, precondition)
    assert solve.curved.tolist() == [False, True]
    assert solve.converged.tolist() == [True, False]


def test_projected_hessian_of_the_same_state_is_solved():
    elastic = sim_cases.elastic()
    y = (elastic.cloud.x * [0.45, 1.0, 1.0])[None]
    tangent = Energy.of(elastic, [], elastic.cloud.x[:, 0] < 1e-9).tangent(y, np.array([True]))
    precondition = LinearSolver.of(tangent.energy, "two-level").preconditioner(tangent)
    solve = conjugate_gradients(tangent.product, right_side(tangent), precondition)
    assert solve.converged.all()
    assert sim_cases.relative(tangent.product(solve.x), right_side(tangent)) < 1e-7
