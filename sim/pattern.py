"""Which pairs of points share a neighbourhood: the sparsity of the Hessian and how its entries are gathered."""

from dataclasses import dataclass

import numpy as np
import taichi as ti

from sim.cloud import RestCloud
from sim.dtypes import Indices1, Matrices2, Matrices4, Vectors2


@ti.kernel
def _assemble(
    H: Matrices4, gradients: Vectors2, start: Indices1, point: Indices1, left: Indices1, right: Indices1, out: Matrices2
):
    for t, e in ti.ndrange(out.shape[0], out.shape[1]):
        total = ti.Matrix.zero(ti.f64, 3, 3)
        for n in range(start[e], start[e + 1]):
            i = point[n]
            a, b = gradients[i, left[n]], gradients[i, right[n]]
            for r, c in ti.static(ti.ndrange(3, 3)):
                total[r, c] += a.dot(H[t, i, r, c] @ b)
        out[t, e] = total


@dataclass(frozen=True, kw_only=True, eq=False)
class Pattern:
    """Row-compressed pairs (a, b) and, for each, the stencils it is summed from: point and the slots of a and b in it.

    A stencil is a point (slot 0) and its neighbours (slots 1..k).
    """

    indptr: np.ndarray  # (N + 1,) int32
    indices: np.ndarray  # (M,) int32, sorted in each row
    start: np.ndarray  # (M + 1,) int32, where each pair's contributions begin
    point: np.ndarray  # (N (k + 1)^2,) int32
    left: np.ndarray  # slot of a
    right: np.ndarray  # slot of b

    @classmethod
    def of(cls, cloud: RestCloud) -> "Pattern":
        """The pattern of a cloud's stencils."""
        stencil = np.concatenate([np.arange(cloud.count)[:, None], cloud.neighbours], axis=1)
        N, m = stencil.shape
        key = (stencil[:, :, None].astype(np.int64) * N + stencil[:, None, :]).ravel()
        order = np.argsort(key, kind="stable")
        pairs, first = np.unique(key[order], return_index=True)
        indptr = np.concatenate([[0], np.cumsum(np.bincount(pairs // N, minlength=N))])
        return cls(
            indptr=indptr.astype(np.int32), indices=(pairs % N).astype(np.int32),
            start=np.append(first, len(key)).astype(np.int32), point=(order // (m * m)).astype(np.int32),
            left=(order // m % m).astype(np.int32), right=(order % m).astype(np.int32),
        )  # fmt: skip

    @property
    def rows(self) -> np.ndarray:
        """Row index of each pair, (M,)."""
        return np.repeat(np.arange(len(self.indptr) - 1), np.diff(self.indptr))

    def assemble(self, H: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """Blocks (T, M, 3, 3) of `sum_i G_ia^T H_i G_ib` for tangents H (T, N, 3, 3, 3, 3), gradients (N, k + 1, 3)."""
        out = np.empty((len(H), len(self.indices), 3, 3))
        _assemble(H, gradients, self.start, self.point, self.left, self.right, out)
        return out
