"""A two-level preconditioner: Chebyshev smoothing plus the rigid motions of aggregates shared by all frames."""

from dataclasses import dataclass, replace

import numpy as np
import taichi as ti
from scipy.linalg.lapack import dtrtri
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from sim.blocks import apply_blocks, invert_blocks
from sim.cloud import RestCloud
from sim.dtypes import Indices1, Matrices2, Matrices4, Vectors2, contiguous, mat3
from sim.energy import Tangent
from sim.pattern import Pattern
from sim.runtime import serial_blas

_SMOOTHED = 20.0  # Chebyshev damps eigenvalues down to the largest over this; the coarse level has the rest
_MARGIN = 1.3  # ten power steps fall short of the largest eigenvalue by up to a quarter


@ti.func
def _cross_matrix(a):
    return mat3([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


@ti.kernel
def _coarse_blocks(
    blocks: Matrices2, arms: Vectors2, start: Indices1, pair: Indices1, left: Indices1, right: Indices1, out: Matrices4
):
    for t, q in ti.ndrange(out.shape[0], out.shape[1]):
        tt, tr, rt, rr = mat3(0.0), mat3(0.0), mat3(0.0), mat3(0.0)
        for e in range(start[q], start[q + 1]):
            H = blocks[t, pair[e]]
            A, B = _cross_matrix(arms[t, left[e]]), -_cross_matrix(arms[t, right[e]])
            tt += H
            tr += H @ B
            rt += A @ H
            rr += A @ H @ B
        out[t, q, 0, 0] = tt
        out[t, q, 0, 1] = tr
        out[t, q, 1, 0] = rt
        out[t, q, 1, 1] = rr


@dataclass(frozen=True, kw_only=True, eq=False)
class Aggregates:
    """A partition of the free points into connected patches, and the gathering lists of the coarse matrix."""

    label: np.ndarray  # (N,) aggregate of each point
    count: int
    free: np.ndarray  # (N,) bool
    pairs: np.ndarray  # (Q, 2) coarse block row and column
    start: np.ndarray  # (Q + 1,) int32
    pair: np.ndarray  # fine pair of each contribution
    left: np.ndarray
    right: np.ndarray

    @classmethod
    def of(cls, cloud: RestCloud, pattern: Pattern, fixed: np.ndarray) -> "Aggregates":
        """About 1.5 sqrt(N) patches grown from seeds spread by farthest-point sampling, along the neighbour graph."""
        label, count = _patches(cloud, max(2, round(1.5 * cloud.count**0.5)))
        rows = pattern.rows
        inner = np.flatnonzero(~fixed[rows] & ~fixed[pattern.indices])
        key = label[rows[inner]].astype(np.int64) * count + label[pattern.indices[inner]]
        order = np.argsort(key, kind="stable")
        unique, first = np.unique(key[order], return_index=True)
        pair = inner[order]
        return cls(
            label=label, count=count, free=~fixed, pairs=np.stack([unique // count, unique % count], axis=1),
            start=np.append(first, len(key)).astype(np.int32), pair=pair.astype(np.int32),
            left=rows[pair].astype(np.int32), right=pattern.indices[pair],
        )  # fmt: skip

    def arms(self, y: np.ndarray) -> np.ndarray:
        """Positions relative to the aggregate's centre, (T, N, 3)."""
        members = np.maximum(np.bincount(self.label, minlength=self.count), 1)
        centre = self.sums(y) / members[:, None]
        return contiguous(y - centre[:, self.label])

    def sums(self, v: np.ndarray) -> np.ndarray:
        """Sums of v (T, N, 3) over each aggregate, (T, A, 3)."""
        gather = csr_matrix((np.ones(len(self.label)), (self.label, np.arange(len(self.label)))))
        return (gather @ v.transpose(1, 0, 2).reshape(len(self.label), -1)).reshape(-1, len(v), 3).transpose(1, 0, 2)


def _patches(cloud: RestCloud, wanted: int) -> tuple[np.ndarray, int]:
    seeds = [int(np.flatnonzero(cloud.island == island)[0]) for island in np.unique(cloud.island)]
    distance = np.min([((cloud.x - cloud.x[s]) ** 2).sum(axis=1) for s in seeds], axis=0)
    while len(seeds) < wanted:
        seeds.append(int(distance.argmax()))
        distance = np.minimum(distance, ((cloud.x - cloud.x[seeds[-1]]) ** 2).sum(axis=1))
    N, k = cloud.neighbours.shape
    lengths = np.linalg.norm(cloud.arms, axis=2).ravel()
    graph = csr_matrix((lengths, (np.repeat(np.arange(N), k), cloud.neighbours.ravel())), (N, N))
    _, _, source = dijkstra(graph, directed=False, indices=seeds, min_only=True, return_predecessors=True)
    return np.searchsorted(np.sort(seeds), source), len(seeds)


@dataclass(frozen=True, kw_only=True, eq=False)
class TwoLevel:
    """z = smoothed r, corrected by the aggregates' rigid motions, smoothed again: symmetric, one per frame."""

    tangent: Tangent
    aggregates: Aggregates
    inverse_diagonal: np.ndarray  # (T, N, 3, 3)
    largest: np.ndarray  # (T,) largest eigenvalue of D^-1 H
    arms: np.ndarray  # (T, N, 3)
    coarse_inverse: np.ndarray  # (T, 6 A, 6 A)

    @classmethod
    def of(cls, tangent: Tangent, aggregates: Aggregates, chunk: int = 4) -> "TwoLevel":
        """Build the preconditioner of a tangent, assembling a few frames at a time."""
        pattern = tangent.energy.elastic.pattern
        diagonal = np.flatnonzero(pattern.rows == pattern.indices)
        arms = aggregates.arms(tangent.y)
        inverse, coarse = [], []
        for first in range(0, len(tangent.y), chunk):
            some = slice(first, min(first + chunk, len(tangent.y)))
            blocks = tangent.assembled(some)
            inverse.append(invert_blocks(blocks[:, diagonal]))
            matrices = _coarse_matrices(blocks, contiguous(arms[some]), aggregates)
            with serial_blas():
                coarse += [_stable_inverse(c) for c in matrices]
        inverse_diagonal = np.concatenate(inverse)
        largest = _largest_eigenvalue(tangent, inverse_diagonal)
        return cls(
            tangent=tangent, aggregates=aggregates, inverse_diagonal=inverse_diagonal, largest=largest, arms=arms,
            coarse_inverse=np.stack(coarse),
        )  # fmt: skip

    def frames(self, index: np.ndarray, tangent: Tangent) -> "TwoLevel":
        """Of the chosen frames, at a tangent of theirs: the same one, or another, see `moved`."""
        return replace(
            self, tangent=tangent, inverse_diagonal=self.inverse_diagonal[index], largest=self.largest[index],
            arms=self.arms[index], coarse_inverse=self.coarse_inverse[index],
        )  # fmt: skip

    @property
    def positive(self) -> np.ndarray:
        """Every frame (T,): what is not is made so."""
        return np.ones(len(self.largest), bool)

    def moved(self, tangent: Tangent) -> "TwoLevel":
        """For a tangent of the same frames not far away: only the largest eigenvalue is found anew."""
        return replace(self, tangent=tangent, largest=_largest_eigenvalue(tangent, self.inverse_diagonal))

    def __call__(self, r: np.ndarray) -> np.ndarray:
        """z ~ H^-1 r, (T, N, 3)."""
        z = self._smooth(r)
        z = z + self._coarse(r - self.tangent.product(z))
        return z + self._smooth(r - self.tangent.product(z))

    def _coarse(self, r: np.ndarray) -> np.ndarray:
        a = self.aggregates
        force, torque = a.sums(r), a.sums(np.cross(self.arms, r))
        right = np.concatenate([force, torque], axis=2).reshape(len(r), -1)
        motion = np.einsum("tij,tj->ti", self.coarse_inverse, right).reshape(len(r), a.count, 6)[:, a.label]
        moved = motion[..., :3] + np.cross(motion[..., 3:], self.arms)
        return np.where(a.free[:, None], moved, 0.0)

    def _smooth(self, r: np.ndarray, degree: int = 3) -> np.ndarray:
        """Chebyshev iteration on D^-1 H from zero."""
        high = (_MARGIN * self.largest)[:, None, None]
        low = high / _SMOOTHED
        centre, half = (high + low) / 2, (high - low) / 2
        ratio = half / centre
        step = apply_blocks(self.inverse_diagonal, r) / centre
        x, r = step, r
        for _ in range(degree - 1):
            r = r - self.tangent.product(step)
            following = 1 / (2 * centre / half - ratio)
            correction = apply_blocks(self.inverse_diagonal, r)
            step = following * ratio * step + 2 * following / half * correction
            x, ratio = x + step, following
        return x


def _coarse_matrices(blocks: np.ndarray, arms: np.ndarray, a: Aggregates) -> np.ndarray:
    parts = np.empty((len(blocks), len(a.pairs), 2, 2, 3, 3))
    _coarse_blocks(blocks, arms, a.start, a.pair, a.left, a.right, parts)
    dense = np.zeros((len(blocks), a.count, 6, a.count, 6))
    dense[:, a.pairs[:, 0], :, a.pairs[:, 1]] = parts.transpose(1, 0, 2, 4, 3, 5).reshape(len(a.pairs), -1, 6, 6)
    return dense.reshape(len(blocks), 6 * a.count, 6 * a.count)


def _stable_inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric matrix made positive definite: empty motions get weight one, negative ones their size."""
    diagonal = np.diagonal(matrix)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scaled = matrix * scale[:, None] * scale + np.diag(np.where(diagonal > 0, 1e-9, 1.0))
    try:
        upper, _ = dtrtri(np.linalg.cholesky(scaled).T)
        return (upper @ upper.T) * scale[:, None] * scale
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(scaled)
        values = np.maximum(np.abs(values), 1e-9)
        return ((vectors / values) @ vectors.T) * scale[:, None] * scale


def _largest_eigenvalue(tangent: Tangent, inverse_diagonal: np.ndarray, steps: int = 10) -> np.ndarray:
    v = tangent.energy.free(np.random.default_rng(0).standard_normal(tangent.y.shape))
    size = np.ones(len(v))
    for _ in range(steps):
        v = apply_blocks(inverse_diagonal, tangent.product(v))
        size = np.sqrt((v**2).sum(axis=(1, 2)))
        v /= size[:, None, None]
    return size
