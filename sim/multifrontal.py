"""Sparse Cholesky for many matrices on one pattern: dense fronts along a nested dissection of the points.

Each separator's unknowns are eliminated in one dense block, of several matrices at once, so that nearly all work is
matrix products, which two threads do side by side: LAPACK's own steps would keep Python's lock. SuperLU forgets that
the matrix is symmetric (docs/benchmarks.md compares). No library with a free licence and wheels does better: CHOLMOD's
dense blocks are under the GPL.
"""

from dataclasses import dataclass

import numpy as np

from sim.dissection import Dissection, Front, Runs

_SMALL = 48  # unknowns of a block that is factorised at once, a larger one by halves
_WIDE = 128  # unknowns of a band of rows: of a product with its own transpose only bands below the diagonal are made


@dataclass(frozen=True, kw_only=True, eq=False)
class Cholesky:
    """L L^T of several matrices, or of one, by the numbers of their parts (`Dissection.parts`)."""

    dissection: Dissection
    rows: np.ndarray  # (F, size), or (size,)

    @classmethod
    def of(cls, dissection: Dissection, blocks: np.ndarray) -> "Cholesky":
        """Factorise matrices of blocks (F, M, 3, 3), or one (M, 3, 3), in their precision.

        Raises LinAlgError where one is not positive definite.
        """
        rows = np.empty((*blocks.shape[:-3], dissection.size), blocks.dtype)
        blocks = blocks.reshape(-1, *blocks.shape[-3:])
        rests: dict[int, np.ndarray] = {}
        for k, (front, part) in enumerate(zip(dissection.fronts, dissection.parts(np.atleast_2d(rows)), strict=True)):
            rests[k] = _eliminated(front, blocks, rests, *part)
        return cls(dissection=dissection, rows=rows)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """H^-1 right for right (F, 3 N, K) or (F, 3 N); of one matrix without F."""
        order, fronts = self.dissection.order, self.dissection.fronts
        parts = self.dissection.parts(np.atleast_2d(self.rows))
        F, N = self.rows.size // self.dissection.size, len(order)
        points = np.ascontiguousarray(right.reshape(F, N, 3, -1)[:, order], self.rows.dtype)
        K, x, points = points.shape[3], points.reshape(F, 3 * N, -1), points.reshape(F, N, -1)  # the same numbers
        for front, (inverse, low) in zip(fronts, parts, strict=True):
            own = inverse @ x[:, front.own]
            x[:, front.own] = own
            points[:, front.above] -= (low @ own).reshape(F, -1, 3 * K)
        for front, (inverse, low) in zip(reversed(fronts), reversed(parts), strict=True):
            own = x[:, front.own] - _turned(low) @ points[:, front.above].reshape(F, -1, K)
            x[:, front.own] = _turned(inverse) @ own
        result = np.empty((F, N, 3, K), right.dtype)
        result[:, order] = x.reshape(result.shape)
        return result.reshape(right.shape)


def _eliminated(
    front: Front, blocks: np.ndarray, rests: dict[int, np.ndarray], inverse: np.ndarray, low: np.ndarray
) -> np.ndarray:
    """Fill in the parts of a front, and return what it takes from those above it, of which the lower triangle counts;
    the rests of its children are used up."""
    own, points = inverse.shape[1], front.last - front.first
    panel = np.zeros((len(blocks), points + len(front.above), 3, points, 3), blocks.dtype)
    panel[:, front.row, :, front.column] = blocks[:, front.pair].swapaxes(0, 1)
    panel = panel.reshape(len(blocks), -1, own)
    for child, within, beyond in front.children:
        _add_lower(panel, rests[child], within, np.subtract)
        _add(panel[:, own:], rests[child], beyond, within, np.subtract)
    _invert(panel[:, :own], inverse)
    np.matmul(panel[:, own:], _turned(inverse), out=low)
    rest = _squared(low)
    for child, _, beyond in front.children:
        _add_lower(rest, rests.pop(child), beyond, np.add)
    return rest


def _invert(block: np.ndarray, out: np.ndarray) -> None:
    """The inverse of the Cholesky factor of blocks (F, n, n), of which the lower triangle counts.

    By halves, since nearly all is then matrix products, which LAPACK's own way is not for so few unknowns.
    """
    n = block.shape[1]
    if n <= _SMALL:
        out[:] = np.linalg.inv(np.linalg.cholesky(block))
        return
    first, last = slice(n // 2), slice(n // 2, n)
    head, tail = out[:, first, first], out[:, last, last]
    _invert(block[:, first, first], head)
    low = block[:, last, first] @ _turned(head)
    _invert(block[:, last, last] - low @ _turned(low), tail)
    out[:, last, first] = tail @ -(low @ head)
    out[:, first, last] = 0.0


def _squared(low: np.ndarray) -> np.ndarray:
    """low low^T on and below the diagonal; above it zero or the same."""
    count = low.shape[1]
    out = np.empty((len(low), count, count), low.dtype)
    for begin in range(0, count, _WIDE):
        end = min(begin + _WIDE, count)
        np.matmul(low[:, begin:end], _turned(low)[:, :, :end], out=out[:, begin:end, :end])
        out[:, begin:end, end:] = 0.0
    return out


def _turned(blocks: np.ndarray) -> np.ndarray:
    return blocks.swapaxes(1, 2)


def _add(whole: np.ndarray, rest: np.ndarray, down: Runs, across: Runs, add: np.ufunc) -> None:
    """Add rows and columns of a child's rest, or subtract them."""
    for rows, to_rows in down:
        for columns, to_columns in across:
            part = whole[:, to_rows, to_columns]
            add(part, rest[:, rows, columns], out=part)


def _add_lower(whole: np.ndarray, rest: np.ndarray, runs: Runs, add: np.ufunc) -> None:
    """The same with what lies on or below the diagonal of a child's rest."""
    for i, run in enumerate(runs):
        _add(whole, rest, (run,), runs[: i + 1], add)
