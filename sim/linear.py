"""Linear solves with the Hessian, all frames at once: conjugate gradients with a choice of preconditioner."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from sim.cloud import RestCloud
from sim.elastic import Elastic
from sim.energy import Tangent
from sim.multifrontal import Cholesky, Dissection
from sim.pattern import Pattern
from sim.runtime import serial_blas

ROOM = 200_000  # points of all frames together, up to which the factors are held: about 5 kB a point, 10 in double
_THREADS = 2
_DIGITS = 1e-3  # of a solution, that single precision may get wrong


class Preconditioner(Protocol):
    """An approximate inverse of a tangent, symmetric and positive definite in every frame."""

    @property
    def positive(self) -> np.ndarray:
        """The frames (T,) where it is that: one made at a state that is not stable may be indefinite."""

    def __call__(self, r: np.ndarray) -> np.ndarray:
        """z ~ H^-1 r, (T, N, 3)."""

    def frames(self, index: np.ndarray) -> "Preconditioner":
        """The preconditioner of the chosen frames."""


@dataclass(frozen=True, kw_only=True)
class Solve:
    """A batched solve: x (T, N, 3), iterations, converged and curved (a direction with p.Hp <= 0), (T,) each."""

    x: np.ndarray
    iterations: np.ndarray
    converged: np.ndarray
    curved: np.ndarray


def conjugate_gradients(
    product: Callable[[np.ndarray], np.ndarray],
    right: np.ndarray,
    precondition: Callable[[np.ndarray], np.ndarray],
    *,
    tolerance: float | np.ndarray = 1e-8,
    limit: int = 400,
) -> Solve:
    """Solve H x = right (T, N, 3) to |residual| <= tolerance |right| in every frame.

    A frame stops when it converges or when it meets a direction of negative curvature, where x keeps its last value
    (for the first direction, the preconditioned right side).
    """
    tolerance = np.broadcast_to(tolerance, len(right))
    x, r = np.zeros_like(right), right.copy()
    z = precondition(r)
    p, rz = z.copy(), _dots(r, z)
    goal = tolerance * np.sqrt(_dots(right, right))
    iterations, curved = np.zeros(len(right), int), np.zeros(len(right), bool)
    converged = np.sqrt(_dots(r, r)) <= goal
    for step in range(limit):
        active = ~(converged | curved)
        if not active.any():
            break
        if step:
            z = precondition(r)
            following = _dots(r, z)
            p = z + (following / np.where(rz > 0, rz, 1.0))[:, None, None] * p
            rz = following
        q = product(p)
        curvature = _dots(p, q)
        bent = active & ((curvature <= 0) | (rz <= 0))
        if step == 0:
            x[bent] = z[bent]
        curved |= bent
        a = np.where(active & ~bent, rz / np.where(curvature > 0, curvature, 1.0), 0.0)
        x += a[:, None, None] * p
        r -= a[:, None, None] * q
        iterations += active
        converged |= np.sqrt(_dots(r, r)) <= goal
    return Solve(x=x, iterations=iterations, converged=converged, curved=curved)


def _dots(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("tna,tna->t", a, b)


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout:
    """How blocks on a pattern of points x (N, 3) become a scalar compressed-column matrix, and how it is factorised."""

    pattern: Pattern
    x: np.ndarray

    @classmethod
    def of(cls, elastic: Elastic) -> "Layout":
        """The layout of an elastic energy's Hessian; terms of forces and contact share its pattern."""
        return _layout(elastic.pattern, elastic.cloud)

    @cached_property
    def template(self) -> tuple[sp.csc_matrix, np.ndarray]:
        """A matrix of the right shape and the place of each of its entries among the blocks' numbers."""
        M, N = len(self.pattern.indices), len(self.pattern.indptr) - 1
        numbers = np.arange(1, 9 * M + 1, dtype=float).reshape(M, 3, 3)
        matrix = sp.bsr_matrix((numbers, self.pattern.indices, self.pattern.indptr), shape=(3 * N, 3 * N)).tocsc()
        matrix.sort_indices()
        return matrix, matrix.data.astype(np.int64) - 1

    @cached_property
    def dissection(self) -> Dissection:
        """The order of elimination."""
        return Dissection.of(self.pattern, self.x)

    def matrix(self, blocks: np.ndarray) -> sp.csc_matrix:
        """The (3N, 3N) matrix of blocks (M, 3, 3)."""
        template, place = self.template
        return sp.csc_matrix((blocks.ravel()[place], template.indices, template.indptr), shape=template.shape)

    def factor(self, blocks: np.ndarray) -> Cholesky | SuperLU:
        """The factors of blocks (M, 3, 3), symmetric but not necessarily positive."""
        return self.cholesky(blocks) or self.indefinite(blocks)

    def cholesky(self, blocks: np.ndarray) -> Cholesky | None:
        """The factor of blocks (M, 3, 3), or None where they are not positive definite."""
        try:
            return self.dissection.factor(blocks)
        except np.linalg.LinAlgError:
            return None

    def roughly(self, blocks: np.ndarray) -> Cholesky | None:
        """The same in single precision, to about four digits, in half the memory and less time, where that shows that
        they are."""
        return self.cholesky(blocks.astype(np.float32)) or self.cholesky(blocks)

    def indefinite(self, blocks: np.ndarray) -> SuperLU:
        """The factors of blocks (M, 3, 3), symmetric but not positive.

        To be dropped in the thread that made them: SciPy never frees the memory of one that dies in another.
        """
        options = {"SymmetricMode": True}
        return splu(self.matrix(blocks), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


@lru_cache(maxsize=2)  # another material keeps both
def _layout(pattern: Pattern, cloud: RestCloud) -> Layout:
    return Layout(pattern=pattern, x=cloud.x)


@dataclass(frozen=True, kw_only=True, eq=False)
class DirectFactors:
    """One sparse factorisation per frame: the inverse of its own tangent, a strong preconditioner nearby."""

    factors: tuple[Cholesky | SuperLU | None, ...]  # None where it is still to be made

    @classmethod
    def none(cls, count: int) -> "DirectFactors":
        """Of so many frames, none made yet."""
        return cls(factors=(None,) * count)

    @classmethod
    def of(cls, tangent: Tangent, layout: Layout, *, exact: bool = False) -> "DirectFactors":
        """Factorise every frame; in single precision unless they have to be exact."""
        _ = layout.dissection  # made once, not in every thread
        make = layout.cholesky if exact else layout.roughly
        with serial_blas(), ThreadPoolExecutor(_THREADS) as pool:
            factors = (
                factor or layout.indefinite(b)
                for blocks in map(tangent.assembled, _chunks(tangent))
                for factor, b in zip(pool.map(make, blocks), blocks, strict=True)
            )
            return cls(factors=tuple(factors))

    @property
    def positive(self) -> np.ndarray:
        """The frames (T,) whose tangent was positive definite."""
        return np.array([isinstance(f, Cholesky) for f in self.factors], bool)

    def renewed(self, frames: np.ndarray, fresh: "DirectFactors") -> "DirectFactors":
        """Those of some frames replaced."""
        factors = list(self.factors)
        for t, factor in zip(frames, fresh.factors, strict=True):
            factors[t] = factor
        return DirectFactors(factors=tuple(factors))

    def __call__(self, r: np.ndarray) -> np.ndarray:
        """H^-1 r, (T, N, 3)."""
        with serial_blas():
            return np.stack([f.solve(v.ravel()).reshape(v.shape) for f, v in zip(self.factors, r, strict=True)])

    def frames(self, index: np.ndarray) -> "DirectFactors":
        """The factors of the chosen frames."""
        return DirectFactors(factors=tuple(self.factors[i] for i in index))


def solve_directly(tangent: Tangent, layout: Layout, right: np.ndarray) -> np.ndarray:
    """H^-1 of several right sides (T, K, N, 3) of every frame, to three digits: each is factorised, used and freed in
    one thread.

    In single precision, as long as a mean of them shows that these digits are there; else in double.
    """
    _ = layout.dissection, layout.template  # made once, not in every thread

    def solve(blocks: np.ndarray, v: np.ndarray) -> np.ndarray:
        columns = np.asfortranarray(v.reshape(len(v), -1).T)
        return _solved(layout, blocks, columns).T.reshape(v.shape)

    with serial_blas(), ThreadPoolExecutor(_THREADS) as pool:
        return np.concatenate([list(pool.map(solve, tangent.assembled(f), right[f])) for f in _chunks(tangent)])


def _solved(layout: Layout, blocks: np.ndarray, columns: np.ndarray) -> np.ndarray:
    factor = layout.roughly(blocks)
    if factor is None:
        return layout.indefinite(blocks).solve(columns)
    size = np.abs(columns).max(axis=0)  # of right sides that single precision may not hold
    columns = columns / np.where(size > 0, size, 1.0)
    found = factor.solve(columns)
    weights = 1 / np.maximum(np.linalg.norm(found, axis=0), 1e-300)
    one = found @ weights
    error = factor.solve(columns @ weights - layout.matrix(blocks) @ one)
    if not np.linalg.norm(error) <= _DIGITS * np.linalg.norm(one):
        found = layout.factor(blocks).solve(columns)
    return found * size


def _chunks(tangent: Tangent, size: int = 8) -> Iterator[slice]:
    """The frames, a few at a time: the assembled blocks of all would take gigabytes."""
    return (slice(first, min(first + size, len(tangent.y))) for first in range(0, len(tangent.y), size))
