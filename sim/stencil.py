"""The stencils of a cloud: gradients of a field at its points, their transpose, and the motions they do not see."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import taichi as ti

from sim.cloud import RestCloud
from sim.dtypes import Indices1, Matrices2, Scalars2, Vectors1, Vectors2, contiguous, mat3
from sim.pattern import Pattern


@ti.func
def spread(p: ti.template(), t, i, neighbours: ti.template(), gradients: ti.template()):
    """sum_j (p_j - p_i) g_ij^T, the gradient of p at point i."""
    D = mat3(0.0)
    for k in range(neighbours.shape[1]):
        D += (p[t, neighbours[i, k]] - p[t, i]).outer_product(gradients[i, k])
    return D


@ti.kernel
def _gather(
    p: Vectors2, Q: Matrices2, own: Vectors1, gradients: Vectors2, start: Indices1, point: Indices1, slot: Indices1,
    indptr: Indices1, indices: Indices1, stiffness: Scalars2, out: Vectors2,
):  # fmt: skip
    for t, a in ti.ndrange(p.shape[0], p.shape[1]):
        total, f = Q[t, a] @ own[a], ti.min(t, stiffness.shape[0] - 1)
        for e in range(start[a], start[a + 1]):
            total += Q[t, point[e]] @ gradients[point[e], slot[e]]
        for e in range(indptr[a], indptr[a + 1]):
            total += stiffness[f, e] * p[t, indices[e]]
        out[t, a] = total


@dataclass(frozen=True, kw_only=True, eq=False)
class Stencil:
    """Each point of a cloud (slot 0) with its neighbours (slots 1..k), and what follows from their geometry."""

    cloud: RestCloud
    pattern: Pattern

    @cached_property
    def gradients(self) -> np.ndarray:
        """Gradient vectors of a stencil, its own point first, (N, k + 1, 3)."""
        return np.concatenate([-self.cloud.gradients.sum(axis=1, keepdims=True), self.cloud.gradients], axis=1)

    def stabilisation(self, modulus: np.ndarray) -> np.ndarray:
        """The matrix of `s_i/2 sum_j w_ij |y_ij - F_i x_ij|^2` for s = c modulus V / h^2, (M,) [N/m] on the pattern."""
        return self.pattern.gather((self.stabilisation_per_modulus * modulus)[:, None, None] * self._residual)

    @property
    def stabilisation_per_modulus(self) -> np.ndarray:
        """c V / h^2, (N,) [m]."""
        return self.cloud.options.stabilisation * self.cloud.volume / self.cloud.reach**2

    def residual_product(self, u: np.ndarray, w: np.ndarray) -> np.ndarray:
        """`sum_tj w_ij r_ij(u) . r_ij(w)`, (N,): the part of two displacements (T, N, 3) that no F sees."""
        points = np.concatenate([np.arange(self.cloud.count)[:, None], self.cloud.neighbours], axis=1)
        pairs = zip(u, w, strict=True)
        return sum(np.einsum("nsa,nst,nta->n", a[points], self._residual, b[points]) for a, b in pairs)

    def divergence(self, p: np.ndarray, Q: np.ndarray, stiffness: np.ndarray | None) -> np.ndarray:
        """`sum_i (dF_i/dy)^T : Q_i + K p`, (T, N, 3), gathered in a fixed order; K on the pattern, (1 or T, M)."""
        out, cloud = np.empty_like(p), self.cloud
        incident = (cloud.incident_start, cloud.incident_point, cloud.incident_slot)
        _gather(p, Q, self._own, cloud.gradients, *incident, *self.sparse(stiffness), out)
        return out

    def sparse(self, stiffness: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Row starts, columns and entries (1 or T, M) of a matrix on the pattern; empty rows for None."""
        if stiffness is None:
            return np.zeros_like(self.pattern.indptr), self.pattern.indices, np.zeros((1, 1))
        return self.pattern.indptr, self.pattern.indices, stiffness

    @cached_property
    def _own(self) -> np.ndarray:
        return contiguous(self.gradients[:, 0])

    @cached_property
    def _residual(self) -> np.ndarray:
        """sum_j w_j r_j^T r_j, (N, k + 1, k + 1), with r_j the row giving y_ij - F_i x_ij from the stencil."""
        cloud, k = self.cloud, self.cloud.neighbours.shape[1]
        rows = np.concatenate([-np.ones((k, 1)), np.eye(k)], axis=1) - np.einsum(
            "nkc,nsc->nks", cloud.arms, self.gradients
        )
        return np.einsum("nk,nks,nkt->nst", cloud.weights, rows, rows)
