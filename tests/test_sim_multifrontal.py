"""The multifrontal Cholesky factor against SciPy's solver, on clouds of every form, and what it refuses."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import linprog
from scipy.sparse.linalg import spsolve

from sim.cloud import RestCloud
from sim.direct import Layout
from sim.dissection import Dissection, _cover
from sim.pattern import Pattern

RNG = np.random.default_rng(0)
CLOUDS = {
    "few": RNG.uniform(size=(20, 3)),
    "ball": RNG.normal(size=(700, 3)),
    "rod": RNG.uniform(size=(500, 3)) * [30.0, 1.0, 1.0],
    "sheet": RNG.uniform(size=(600, 3)) * [10.0, 10.0, 0.4],
    "two apart": np.concatenate([RNG.uniform(size=(200, 3)), RNG.uniform(size=(150, 3)) + 9.0]),
    "lattice": np.stack(np.meshgrid(*[np.arange(8.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3),
}


def pattern_of(x: np.ndarray) -> Pattern:
    return Pattern.of(RestCloud.build(x, volume=np.ones(len(x)), surface=np.ones(len(x), bool)))


def positive(pattern: Pattern, seed: int = 0) -> np.ndarray:
    """Blocks (M, 3, 3) of a symmetric positive definite matrix: off the diagonal at random, on it large enough."""
    rng, rows = np.random.default_rng(seed), pattern.rows
    N = len(pattern.indptr) - 1
    blocks = rng.normal(size=(len(rows), 3, 3))
    place = sp.csr_matrix((np.arange(1, len(rows) + 1), pattern.indices, pattern.indptr), shape=(N, N))
    mirror = np.asarray(place.T.tocsr()[rows, pattern.indices]).ravel() - 1
    blocks = blocks + blocks[mirror].transpose(0, 2, 1)
    weight = np.abs(blocks).sum(axis=(1, 2))
    diagonal = rows == pattern.indices
    blocks[diagonal] += np.add.reduceat(weight, pattern.indptr[:-1])[:, None, None] * np.eye(3)
    return blocks


@pytest.mark.parametrize("name", CLOUDS)
def test_solution_is_the_one_of_scipy_for_any_form(name):
    x = CLOUDS[name]
    layout = Layout(pattern=pattern_of(x), x=x)
    blocks = positive(layout.pattern)
    right = RNG.normal(size=(3 * len(x), 4))
    found = layout.cholesky(blocks).solve(right)
    assert np.abs(found - spsolve(layout.matrix(blocks), right)).max() < 1e-12 * np.abs(found).max()
    one = layout.cholesky(blocks).solve(right[:, 0])
    assert one.shape == (3 * len(x),)
    assert np.abs(one - found[:, 0]).max() < 1e-13 * np.abs(found).max()


@pytest.mark.parametrize("name", CLOUDS)
def test_every_point_is_eliminated_once_and_reaches_only_later_ones(name):
    x = CLOUDS[name]
    dissection = Dissection.of(pattern_of(x), x)
    assert sorted(dissection.order) == list(range(len(x)))
    assert [f.first for f in dissection.fronts[1:]] == [f.last for f in dissection.fronts[:-1]]
    assert all((f.above >= f.last).all() for f in dissection.fronts)


@pytest.mark.parametrize("name", ["ball", "sheet", "lattice"])
def test_the_dense_fronts_hold_little_more_than_minimum_degree_would(name):
    x = CLOUDS[name]
    layout = Layout(pattern=pattern_of(x), x=x)
    least = layout.indefinite(positive(layout.pattern)).L.nnz
    filled = sum(9 * (f.last - f.first) * ((f.last - f.first) / 2 + len(f.above)) for f in layout.dissection.fronts)
    assert filled < 1.7 * least, f"{filled / least:.2f} times as many"


@pytest.mark.parametrize(("rows", "columns", "share"), [(1, 1, 1.0), (8, 5, 0.0), (30, 40, 0.05), (60, 25, 0.2)])
def test_a_cover_holds_every_edge_and_is_as_small_as_linear_programming_finds(rows, columns, share):
    edges = sp.csr_matrix((np.random.default_rng(rows).uniform(size=(rows, columns)) < share).astype(float))
    some = _cover(edges)
    i, j = edges.nonzero()
    assert (some[0][i] | some[1][j]).all()
    least = 0.0
    if len(i):
        ends = np.concatenate([np.eye(rows)[i], np.eye(columns)[j]], axis=1)
        least = linprog(np.ones(rows + columns), A_ub=-ends, b_ub=-np.ones(len(i))).fun
    assert sum(side.sum() for side in some) == pytest.approx(least)


def test_a_matrix_with_a_negative_direction_is_refused():
    x = CLOUDS["ball"]
    layout = Layout(pattern=pattern_of(x), x=x)
    blocks = positive(layout.pattern)
    diagonal = np.flatnonzero(layout.pattern.rows == layout.pattern.indices)
    blocks[diagonal[300]] *= -1
    assert layout.cholesky(blocks) is None
    right = RNG.normal(size=3 * len(x))
    found = layout.indefinite(blocks).solve(right)
    assert np.abs(found - spsolve(layout.matrix(blocks), right)).max() < 1e-10 * np.abs(found).max()


def test_a_factor_is_the_same_every_time():
    x = CLOUDS["sheet"]
    layout = Layout(pattern=pattern_of(x), x=x)
    blocks, right = positive(layout.pattern), RNG.normal(size=(3 * len(x), 2))
    assert (layout.cholesky(blocks).solve(right) == layout.cholesky(blocks).solve(right)).all()
