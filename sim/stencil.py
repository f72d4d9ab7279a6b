"""The stencils of a cloud: gradients of a field at its points, their transpose, and the motions they do not see."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import taichi as ti

from sim.cloud import RestCloud
from sim.dtypes import (
    Indices1,
    Indices2,
    Matrices1,
    Matrices2,
    Scalars1,
    Scalars2,
    Vectors1,
    Vectors2,
    contiguous,
    mat3,
)
from sim.pattern import Pattern


@ti.func
def spread(p: ti.template(), t, i, neighbours: ti.template(), gradients: ti.template()):
    """sum_j (p_j - p_i) g_ij^T, the gradient of p at point i."""
    D = mat3(0.0)
    for k in range(neighbours.shape[1]):
        D += (p[t, neighbours[i, k]] - p[t, i]).outer_product(gradients[i, k])
    return D


@ti.kernel
def _strained(p: Vectors2, F: Matrices1, neighbours: Indices2, gradients: Vectors2, out: Matrices2):
    for k, i in ti.ndrange(p.shape[0], p.shape[1]):
        D = F[i].transpose() @ spread(p, k, i, neighbours, gradients)
        out[k, i] = (D + D.transpose()) / 2


@ti.kernel
def _stressed(F: Matrices1, size: Scalars1, S: Matrices2, out: Matrices2):
    for k, i in ti.ndrange(S.shape[0], S.shape[1]):
        out[k, i] = size[i] * (F[i] @ S[k, i])


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
        """The matrix of `s_i/2 sum_j w_ij |y_ij - F_i x_ij|^2` for s = c modulus V / h^2 and modulus (..., N) [Pa].

        Its entries on the pattern, (..., M) [N/m].
        """
        return np.ascontiguousarray((self._gathered @ (self.stabilisation_per_modulus * modulus).T).T)

    def strained(self, p: np.ndarray, F: np.ndarray) -> np.ndarray:
        """How the Green strain answers to changes p (K, N, 3) [m] of a pose, `sym F^T dp/dx`, at its F (N, 3, 3)."""
        out = np.empty((*p.shape, 3))
        _strained(contiguous(p), contiguous(F), self.cloud.neighbours, self.cloud.gradients, out)
        return out

    def pull(self, S: np.ndarray, F: np.ndarray, size: np.ndarray) -> np.ndarray:
        """The gradient (K, N, 3) [N] of second Piola-Kirchhoff stresses size S; S (K, N, 3, 3), size (N,) [Pa]."""
        Q = np.empty_like(S)
        _stressed(contiguous(F), self.cloud.volume * size, contiguous(S), Q)
        return self.divergence(np.zeros(Q.shape[:3]), Q, None)

    def bent(self, u: np.ndarray) -> np.ndarray:
        """What F does not see of a displacement u (T, N, 3), `sqrt(w_ij) (u_j - u_i - F_i x_ij)`, (T, N, k, 3) [m]."""
        flat = self._bends @ u.transpose(1, 0, 2).reshape(u.shape[1], -1)
        return flat.reshape(u.shape[1], -1, len(u), 3).transpose(2, 0, 1, 3)

    def spring_back(self, bent: np.ndarray, modulus: np.ndarray) -> np.ndarray:
        """The stabilisation's gradient (T, N, 3) [N] of stencils bent (T, N, k, 3), each on its own; modulus (N,) [Pa].

        Of a displacement it is the matrix of `stabilisation` times that displacement.
        """
        size = (self.stabilisation_per_modulus * modulus)[:, None, None, None]
        each = (size * bent.transpose(1, 2, 0, 3)).reshape(self._bends.shape[0], -1)
        return (self._bends.T @ each).reshape(-1, len(bent), 3).transpose(1, 0, 2)

    def bent_forces(self, bent: np.ndarray, modulus: np.ndarray) -> np.ndarray:
        """The terms of `spring_back`, of each stencil on its points, (T, N, k + 1, 3) [N]; modulus (..., N) [Pa]."""
        size = self.stabilisation_per_modulus * modulus
        return size[..., None, None] * (self._rows.swapaxes(1, 2) @ bent)

    def stress_forces(self, Q: np.ndarray) -> np.ndarray:
        """The terms of `sum_i (dF_i/dy)^T : Q_i` for Q (T, N, 3, 3) [J], likewise."""
        return self.gradients @ Q.swapaxes(2, 3)

    def gathered(self, each: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """`sum_i w_ki f_ij` at every point j: forces (N, k + 1, 3) [N] of stencils, weighted by (K, N); (K, N, 3)."""
        order, point, start = self._ends
        N = len(weights.T)
        flat = each.reshape(-1, 3)[order]
        parts = [sp.csr_matrix((flat[:, c], point, start), shape=(N, N)) @ weights.T for c in range(3)]
        return np.stack(parts, axis=2).transpose(1, 0, 2)

    @property
    def stabilisation_per_modulus(self) -> np.ndarray:
        """c V / h^2, (N,) [m]."""
        return self.cloud.options.stabilisation * self.cloud.volume / self.cloud.reach**2

    def residual_product(self, u: np.ndarray, w: np.ndarray) -> np.ndarray:
        """`sum_tj w_ij r_ij(u) . r_ij(w)`, (N,): the part of two displacements (T, N, 3) that no F sees."""
        return np.einsum("tnka,tnka->n", self.bent(u), self.bent(w))

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
    def _gathered(self) -> sp.csr_matrix:
        """From a stiffness of every stencil to entries on the pattern, (M, N)."""
        pattern = self.pattern
        data = self._residual[pattern.point, pattern.left, pattern.right]
        return sp.csr_matrix((data, pattern.point, pattern.start), shape=(len(pattern.indices), self.cloud.count))

    @cached_property
    def _bends(self) -> sp.csr_matrix:
        """From points to `bent`, (N k, N)."""
        N, k, slots = self._rows.shape
        points = np.concatenate([np.arange(N)[:, None], self.cloud.neighbours], axis=1)
        columns = np.repeat(points[:, None], k, axis=1).ravel()
        return sp.csr_matrix((self._rows.ravel(), columns, slots * np.arange(N * k + 1)), shape=(N * k, N))

    @cached_property
    def _ends(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The stencils' slots in the order of the points that they hold, whose each is, and where a point's begin."""
        N, slots = self.cloud.count, self.cloud.neighbours.shape[1] + 1
        held = np.concatenate([np.arange(N)[:, None], self.cloud.neighbours], axis=1).ravel()
        order = np.argsort(held, kind="stable")
        return order, order // slots, np.concatenate([[0], np.cumsum(np.bincount(held, minlength=N))])

    @cached_property
    def _own(self) -> np.ndarray:
        return contiguous(self.gradients[:, 0])

    @cached_property
    def _rows(self) -> np.ndarray:
        """What gives `bent` from the displacements of a stencil, (N, k, k + 1)."""
        cloud, k = self.cloud, self.cloud.neighbours.shape[1]
        seen = np.einsum("nkc,nsc->nks", cloud.arms, self.gradients)
        return np.sqrt(cloud.weights)[:, :, None] * (np.concatenate([-np.ones((k, 1)), np.eye(k)], axis=1) - seen)

    @cached_property
    def _residual(self) -> np.ndarray:
        """Their squares, (N, k + 1, k + 1)."""
        return self._rows.swapaxes(1, 2) @ self._rows
