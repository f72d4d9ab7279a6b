"""A law summed over the stencils of a cloud: value, gradient and Hessian of any energy of the deformation gradient."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import taichi as ti

from sim.dtypes import Indices1, Indices2, Matrices2, Matrices4, Scalars2, Vectors2, contiguous, mat3, vec3
from sim.stencil import Stencil, spread


@ti.func
def _row(m: ti.template(), t, i, count):
    """Where frame t keeps the parameters of point i: in block t of m, or in the only one."""
    return ti.min(t * count + i, m.shape[0] - count + i)


@ti.func
def _amount(volume: ti.template(), t, i):
    """The volume that point i has in frame t."""
    return volume[ti.min(t, volume.shape[0] - 1), i]


@ti.kernel
def _stress(
    law: ti.template(), u: Vectors2, neighbours: Indices2, gradients: Vectors2, volume: Scalars2, m: Scalars2,
    F: Matrices2, Q: Matrices2,
):  # fmt: skip
    for t, i in ti.ndrange(u.shape[0], u.shape[1]):
        F[t, i] = ti.Matrix.identity(ti.f64, 3) + spread(u, t, i, neighbours, gradients)
        Q[t, i] = _amount(volume, t, i) * law.piola(F[t, i], m, _row(m, t, i, u.shape[1]))


@ti.kernel
def _tangent(
    law: ti.template(), p: Vectors2, F: Matrices2, neighbours: Indices2, gradients: Vectors2, volume: Scalars2,
    m: Scalars2, Q: Matrices2,
):  # fmt: skip
    for t, i in ti.ndrange(p.shape[0], p.shape[1]):
        W = spread(p, t, i, neighbours, gradients)
        Q[t, i] = _amount(volume, t, i) * law.dpiola(F[t, i], W, m, _row(m, t, i, p.shape[1]))


@ti.kernel
def _projected_tangent(
    p: Vectors2, H: Matrices4, frames: Indices1, neighbours: Indices2, gradients: Vectors2, Q: Matrices2
):
    for f, i in ti.ndrange(frames.shape[0], p.shape[1]):
        d, q = spread(p, frames[f], i, neighbours, gradients), mat3(0.0)
        for r, c in ti.static(ti.ndrange(3, 3)):
            v = H[f, i, r, c] @ d[c, :]
            for e in ti.static(range(3)):
                q[r, e] += v[e]
        Q[frames[f], i] = q


@ti.kernel
def _energy_density(
    law: ti.template(), u: Vectors2, neighbours: Indices2, gradients: Vectors2, volume: Scalars2, m: Scalars2,
    indptr: Indices1, indices: Indices1, stiffness: Scalars2, energy: Scalars2, smallest: Scalars2,
):  # fmt: skip
    for t, i in ti.ndrange(u.shape[0], u.shape[1]):
        F = ti.Matrix.identity(ti.f64, 3) + spread(u, t, i, neighbours, gradients)
        pull, f = vec3(0.0), ti.min(t, stiffness.shape[0] - 1)
        for e in range(indptr[i], indptr[i + 1]):
            pull += stiffness[f, e] * u[t, indices[e]]
        psi = law.psi(F, m, _row(m, t, i, u.shape[1]))
        energy[t, i] = _amount(volume, t, i) * psi + 0.5 * u[t, i].dot(pull)
        smallest[t, i] = F.determinant()


@ti.kernel
def _full_tangent(law: ti.template(), F: Matrices2, volume: Scalars2, m: Scalars2, H: Matrices4):
    for t, i, c in ti.ndrange(F.shape[0], F.shape[1], 3):
        row, j = vec3(c == 0, c == 1, c == 2), _row(m, t, i, F.shape[1])
        for d in ti.static(range(3)):
            W = row.outer_product(ti.Vector.unit(3, d, ti.f64))
            P = _amount(volume, t, i) * law.dpiola(F[t, i], W, m, j)
            for r, e in ti.static(ti.ndrange(3, 3)):
                H[t, i, r, c][e, d] = P[r, e]


@dataclass(frozen=True, kw_only=True, eq=False)
class Material:
    """`E = sum_i V_i psi(F_i; m_i) + 1/2 u.K u`, where volumes, parameters and K may differ from frame to frame.

    `law` is a class with psi, piola, dpiola. An array of one row holds for every frame.
    """

    stencil: Stencil
    law: Any
    m: np.ndarray  # (1 or T, N, P)
    volume: np.ndarray  # (1 or T, N) [m3]
    stiffness: np.ndarray | None = None  # (1 or T, M) [N/m], K's entries on the pattern; None for no K

    def frames(self, index: np.ndarray | slice) -> "Material":
        """The material of the chosen frames."""
        m, volume = _chosen(self.m, index), _chosen(self.volume, index)
        stiffness = None if self.stiffness is None else _chosen(self.stiffness, index)
        return replace(self, m=m, volume=volume, stiffness=stiffness)

    def density(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Each point's energy (T, N) [J] and J (T, N)."""
        u, cloud = self._displacement(y), self.stencil.cloud
        energy, J = np.empty(u.shape[:2]), np.empty(u.shape[:2])
        K = self.stencil.sparse(self.stiffness)
        _energy_density(self.law, u, cloud.neighbours, cloud.gradients, self.volume, self._rows, *K, energy, J)
        return energy, J

    def forces(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """dE/dy (T, N, 3) [N] and F (T, N, 3, 3)."""
        u = self._displacement(y)
        F, Q = self._stressed(u)
        return self.stencil.divergence(u, Q, self.stiffness), F

    def stress_forces(self, y: np.ndarray) -> np.ndarray:
        """What the law in each stencil does to its points, (T, N, k + 1, 3) [N], without K."""
        return self.stencil.stress_forces(self._stressed(self._displacement(y))[1])

    def _stressed(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        cloud = self.stencil.cloud
        F, Q = np.empty((*u.shape, 3)), np.empty((*u.shape, 3))
        _stress(self.law, u, cloud.neighbours, cloud.gradients, self.volume, self._rows, F, Q)
        return F, Q

    def product(self, F: np.ndarray, p: np.ndarray, frames: np.ndarray, projected: np.ndarray) -> np.ndarray:
        """H p (T, N, 3) at F (T, N, 3, 3), with the tangents `projected` in `frames`."""
        p, cloud = contiguous(p), self.stencil.cloud
        Q = np.empty((*p.shape, 3))
        _tangent(self.law, p, F, cloud.neighbours, cloud.gradients, self.volume, self._rows, Q)
        if len(frames):
            _projected_tangent(p, projected, frames, cloud.neighbours, cloud.gradients, Q)
        return self.stencil.divergence(p, Q, self.stiffness)

    def tangents(self, F: np.ndarray) -> np.ndarray:
        """Volume-weighted H[r, c][e, d] = dP_re / dF_cd, (T, N, 3, 3, 3, 3) [J], at F (T, N, 3, 3)."""
        H = np.empty((*F.shape[:2], 3, 3, 3, 3))
        _full_tangent(self.law, contiguous(F), self.volume, self._rows, H)
        return H

    @cached_property
    def _rows(self) -> np.ndarray:
        return self.m.reshape(-1, self.m.shape[2])

    def _displacement(self, y: np.ndarray) -> np.ndarray:
        return contiguous(y - self.stencil.cloud.x)


@dataclass(frozen=True, kw_only=True, eq=False)
class MaterialTangent:
    """The Hessian of a material at one state of a batch, never assembled unless asked."""

    material: Material
    F: np.ndarray  # (T, N, 3, 3)
    frames: np.ndarray  # (S,) int32, frames with a projected tangent
    projected: np.ndarray  # (S, N, 3, 3, 3, 3) volume-weighted blocks H[r, c][e, d] = dP_re / dF_cd

    def product(self, p: np.ndarray) -> np.ndarray:
        """H p, (T, N, 3)."""
        return self.material.product(self.F, p, self.frames, self.projected)

    def assembled(self, frames: slice) -> np.ndarray:
        """The Hessian's blocks (T', M, 3, 3) on the pattern, for a slice of the frames."""
        part, stencil = self.material.frames(frames), self.material.stencil
        H = part.tangents(self.F[frames])
        inside = np.isin(self.frames, np.arange(len(self.F))[frames])
        H[self.frames[inside] - (frames.start or 0)] = self.projected[inside]
        out = stencil.pattern.assemble(H, stencil.gradients)
        return out if part.stiffness is None else out + part.stiffness[:, :, None, None] * np.eye(3)

    @cached_property
    def blocks(self) -> np.ndarray:
        """The part of the Hessian that couples no two points, (T, N, 3, 3)."""
        pattern, frames = self.material.stencil.pattern, range(0, len(self.F), 8)
        diagonal = np.flatnonzero(pattern.rows == pattern.indices)
        return np.concatenate([self.assembled(slice(t, t + 8))[:, diagonal] for t in frames])


def _chosen(array: np.ndarray, index: np.ndarray | slice) -> np.ndarray:
    """The frames `index` of an array, of which one row holds for every frame."""
    return array if len(array) == 1 else contiguous(array[index])
