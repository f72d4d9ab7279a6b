"""Direct linear solves with the Hessian: every frame factorised, several frames at once on each of two threads."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from itertools import pairwise

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from sim.cloud import RestCloud
from sim.dissection import Dissection
from sim.elastic import Elastic
from sim.energy import Tangent
from sim.multifrontal import Cholesky
from sim.pattern import Pattern
from sim.runtime import serial_blas

ROOM = 200_000  # points of all frames together, up to which the factors are held: about 5 kB a point, 10 in double
_THREADS = 2
_TOGETHER = 4  # frames that a thread factorises at once: more are no faster, and the assembled blocks take much memory
_DIGITS = 1e-3  # of a solution, that single precision may get wrong


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
        """The factors of blocks (F, M, 3, 3), or of one frame's, in their precision; None where one is not positive
        definite."""
        try:
            return Cholesky.of(self.dissection, blocks)
        except np.linalg.LinAlgError:
            return None

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
    """One sparse factorisation per frame: the inverse of its own tangent, a strong preconditioner nearby.

    Those in one precision are rows of one array, so that frames next to one another are solved together.
    """

    dissection: Dissection
    rows: np.ndarray  # (R, size)
    index: np.ndarray  # (T,) the row of each frame
    other: dict[int, Cholesky | SuperLU | None]  # by row, what is not in it: None where it is still to be made

    @classmethod
    def none(cls, count: int, layout: Layout) -> "DirectFactors":
        """Of so many frames, none made yet."""
        rows = np.empty((count, layout.dissection.size), np.float32)
        return cls(dissection=layout.dissection, rows=rows, index=np.arange(count), other=dict.fromkeys(range(count)))

    @classmethod
    def of(cls, tangent: Tangent, layout: Layout, *, exact: bool = False) -> "DirectFactors":
        """Factorise every frame; in single precision, where that shows that four digits are, unless they have to be
        exact."""
        T, failed = len(tangent.y), []
        rows = np.empty((T, layout.dissection.size), np.float64 if exact else np.float32)

        def fill(frames: slice, blocks: np.ndarray) -> None:
            made = layout.cholesky(blocks.astype(rows.dtype))
            if made is not None:
                rows[frames] = made.rows
            elif len(blocks) == 1:
                failed.append(frames.start)
            else:
                for t, own in enumerate(blocks, start=frames.start):
                    fill(slice(t, t + 1), own[None])

        _side_by_side(tangent, fill)
        with serial_blas():
            other = {t: layout.factor(tangent.assembled(slice(t, t + 1))[0]) for t in sorted(failed)}
        return cls(dissection=layout.dissection, rows=rows, index=np.arange(T), other=other)

    @property
    def factors(self) -> tuple[Cholesky | SuperLU | None, ...]:
        """Each frame's own."""
        alone = (Cholesky(dissection=self.dissection, rows=self.rows[r]) for r in self.index)
        return tuple(self.other.get(r, own) for r, own in zip(self.index.tolist(), alone, strict=True))

    @property
    def positive(self) -> np.ndarray:
        """The frames (T,) whose tangent was positive definite."""
        missing = [row for row, own in self.other.items() if not isinstance(own, Cholesky)]
        return ~np.isin(self.index, missing)

    def renewed(self, frames: np.ndarray, fresh: "DirectFactors") -> "DirectFactors":
        """Those of some frames replaced, which are lost: the rows stay where they are."""
        if len(frames) == len(self.index):
            return fresh
        where, other = self.index[frames], dict(self.other)
        self.rows[where] = fresh.rows[fresh.index]
        for row, own in zip(where.tolist(), fresh.index.tolist(), strict=True):
            other.pop(row, None)
            if own in fresh.other:
                other[row] = fresh.other[own]
        return replace(self, other=other)

    def __call__(self, r: np.ndarray) -> np.ndarray:
        """H^-1 r, (T, N, 3)."""
        out = np.empty_like(r)

        def solve(frames: slice) -> None:
            row, right = int(self.index[frames.start]), r[frames]
            if row in self.other:
                out[frames] = self.other[row].solve(right.ravel()).reshape(right.shape)
            else:
                together = Cholesky(dissection=self.dissection, rows=self.rows[row : row + len(right)])
                out[frames] = together.solve(right.reshape(len(right), -1)).reshape(right.shape)

        runs = self._runs()
        with serial_blas():
            if 2 * len(runs) > len(r):  # nearly all alone: then it is Python's steps that take time
                list(map(solve, runs))
            else:
                list(_pool().map(solve, runs))
        return out

    def _runs(self) -> list[slice]:
        """The frames in parts whose rows follow one another, no longer than a thread's share."""
        T, cuts = len(self.index), [0]
        alone = np.isin(self.index, list(self.other))
        joined = (np.diff(self.index) == 1) & ~alone[1:] & ~alone[:-1]
        for t in range(1, T):
            if not joined[t - 1] or t - cuts[-1] == -(-T // _THREADS):
                cuts.append(t)
        return [slice(a, b) for a, b in pairwise([*cuts, T])]

    def frames(self, index: np.ndarray, tangent: Tangent | None = None) -> "DirectFactors":
        """The factors of the chosen frames, whose tangent they do not need."""
        return replace(self, index=self.index[index])


def solve_directly(tangent: Tangent, layout: Layout, right: np.ndarray) -> np.ndarray:
    """H^-1 of several right sides (T, K, N, 3) of every frame, to three digits: each is factorised, used and freed in
    one thread.

    In single precision, as long as a mean of them shows that these digits are there; else in double.
    """
    out = np.empty_like(right)

    def solve(frames: slice, blocks: np.ndarray) -> None:
        columns = right[frames].reshape(len(blocks), right.shape[1], -1).swapaxes(1, 2)
        out[frames] = _solved(layout, blocks, columns).swapaxes(1, 2).reshape(right[frames].shape)

    _side_by_side(tangent, solve)
    return out


def _solved(layout: Layout, blocks: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Of matrices of blocks (F, M, 3, 3) for right sides (F, 3 N, K)."""
    factor = layout.cholesky(blocks.astype(np.float32))
    if factor is None and len(blocks) > 1:
        return np.concatenate([_solved(layout, b[None], c[None]) for b, c in zip(blocks, columns, strict=True)])
    if factor is None:
        return layout.factor(blocks[0]).solve(columns[0])[None]
    size = np.abs(columns).max(axis=1, keepdims=True)  # of right sides that single precision may not hold
    columns = columns / np.where(size > 0, size, 1.0)
    found = factor.solve(columns)
    weights = 1 / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-300)
    one, right = ((part * weights).sum(axis=2) for part in (found, columns))
    left = np.stack([r - layout.matrix(b) @ x for r, b, x in zip(right, blocks, one, strict=True)])
    error = np.linalg.norm(factor.solve(left), axis=1)
    for f in np.flatnonzero(~(error <= _DIGITS * np.linalg.norm(one, axis=1))):
        found[f] = layout.factor(blocks[f]).solve(columns[f])
    return found * size


@cache  # to make threads takes a tenth of the time of a small solve
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_THREADS)


def _side_by_side(tangent: Tangent, work: Callable[[slice, np.ndarray], None]) -> None:
    """work(frames, blocks) for all frames, a few at a time: the assembled blocks of all would take gigabytes."""
    T, most = len(tangent.y), _THREADS * _TOGETHER
    with serial_blas():
        for first in range(0, T, most):
            end = min(first + most, T)
            blocks, cuts = tangent.assembled(slice(first, end)), np.linspace(0, end - first, _THREADS + 1).astype(int)
            parts = [slice(a, b) for a, b in pairwise(cuts.tolist()) if a < b]
            list(_pool().map(work, [slice(first + p.start, first + p.stop) for p in parts], [blocks[p] for p in parts]))
