"""The elastic energy of a rest cloud: value, gradient and Hessian products over a batch of frames (paper E_NH)."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import taichi as ti

from sim import runtime
from sim.cloud import RestCloud
from sim.dtypes import (
    Indices1,
    Indices2,
    Matrices2,
    Matrices4,
    Scalars1,
    Scalars2,
    Vectors1,
    Vectors2,
    contiguous,
    mat3,
    vec3,
)
from sim.lame import Lame
from sim.laws.fields import MaterialFields
from sim.laws.neo_hookean import NeoHookean
from sim.pattern import Pattern


@ti.func
def _spread(p: ti.template(), t, i, neighbours: ti.template(), gradients: ti.template()):
    """sum_j (p_j - p_i) g_ij^T, the gradient of p at point i."""
    D = mat3(0.0)
    for k in range(neighbours.shape[1]):
        D += (p[t, neighbours[i, k]] - p[t, i]).outer_product(gradients[i, k])
    return D


@ti.kernel
def _stress(
    law: ti.template(), u: Vectors2, neighbours: Indices2, gradients: Vectors2, volume: Scalars1, m: Scalars2,
    F: Matrices2, Q: Matrices2,
):  # fmt: skip
    for t, i in ti.ndrange(u.shape[0], u.shape[1]):
        F[t, i] = ti.Matrix.identity(ti.f64, 3) + _spread(u, t, i, neighbours, gradients)
        Q[t, i] = volume[i] * law.piola(F[t, i], m, i)


@ti.kernel
def _tangent(
    law: ti.template(), p: Vectors2, F: Matrices2, neighbours: Indices2, gradients: Vectors2, volume: Scalars1,
    m: Scalars2, Q: Matrices2,
):  # fmt: skip
    for t, i in ti.ndrange(p.shape[0], p.shape[1]):
        Q[t, i] = volume[i] * law.dpiola(F[t, i], _spread(p, t, i, neighbours, gradients), m, i)


@ti.kernel
def _projected_tangent(
    p: Vectors2, H: Matrices4, frames: Indices1, neighbours: Indices2, gradients: Vectors2, Q: Matrices2
):
    for f, i in ti.ndrange(frames.shape[0], p.shape[1]):
        d, q = _spread(p, frames[f], i, neighbours, gradients), mat3(0.0)
        for r, c in ti.static(ti.ndrange(3, 3)):
            v = H[f, i, r, c] @ d[c, :]
            for e in ti.static(range(3)):
                q[r, e] += v[e]
        Q[frames[f], i] = q


@ti.kernel
def _gather(
    p: Vectors2, Q: Matrices2, own: Vectors1, gradients: Vectors2, start: Indices1, point: Indices1, slot: Indices1,
    indptr: Indices1, indices: Indices1, stiffness: Scalars1, out: Vectors2,
):  # fmt: skip
    for t, a in ti.ndrange(p.shape[0], p.shape[1]):
        total = Q[t, a] @ own[a]
        for e in range(start[a], start[a + 1]):
            total += Q[t, point[e]] @ gradients[point[e], slot[e]]
        for e in range(indptr[a], indptr[a + 1]):
            total += stiffness[e] * p[t, indices[e]]
        out[t, a] = total


@ti.kernel
def _energy_density(
    law: ti.template(), u: Vectors2, neighbours: Indices2, gradients: Vectors2, volume: Scalars1, m: Scalars2,
    indptr: Indices1, indices: Indices1, stiffness: Scalars1, energy: Scalars2, smallest: Scalars2,
):  # fmt: skip
    for t, i in ti.ndrange(u.shape[0], u.shape[1]):
        F = ti.Matrix.identity(ti.f64, 3) + _spread(u, t, i, neighbours, gradients)
        pull = vec3(0.0)
        for e in range(indptr[i], indptr[i + 1]):
            pull += stiffness[e] * u[t, indices[e]]
        energy[t, i] = volume[i] * law.psi(F, m, i) + 0.5 * u[t, i].dot(pull)
        smallest[t, i] = F.determinant()


@ti.kernel
def _full_tangent(law: ti.template(), F: Matrices2, volume: Scalars1, m: Scalars2, H: Matrices4):
    for t, i, c in ti.ndrange(F.shape[0], F.shape[1], 3):
        row = vec3(c == 0, c == 1, c == 2)
        for d in ti.static(range(3)):
            P = volume[i] * law.dpiola(F[t, i], row.outer_product(ti.Vector.unit(3, d, ti.f64)), m, i)
            for r, e in ti.static(ti.ndrange(3, 3)):
                H[t, i, r, c][e, d] = P[r, e]


@dataclass(frozen=True, kw_only=True, eq=False)
class Elastic:
    """`E = sum_i V_i psi(F_i) + s_i/2 sum_j w_ij |y_ij - F_i x_ij|^2` with s = c mu V / h^2.

    The second part holds the motions that F does not see. It vanishes for every affine motion and is quadratic in the
    displacement, so it is one constant sparse matrix. `law` is a class with psi, piola, dpiola; `m` (N, P) its
    parameters, the first of them a shear modulus [Pa].
    """

    cloud: RestCloud
    m: np.ndarray  # (N, P)
    pattern: Pattern
    law: Any = NeoHookean

    @classmethod
    def neo_hookean(cls, cloud: RestCloud, lame: Lame) -> "Elastic":
        """The paper's material on a cloud, with homogeneous or per-point parameters."""
        runtime.ensure()
        lame = lame.spread(cloud.count)
        return cls(cloud=cloud, m=np.stack([lame.mu, lame.lam], axis=1), pattern=Pattern.of(cloud))

    def with_parameters(self, m: np.ndarray) -> "Elastic":
        """The same cloud and law with parameters m (N, P)."""
        other = replace(self, m=contiguous(m))
        for name in ("_residual", "stencil_gradients"):  # they belong to the cloud
            other.__dict__[name] = getattr(self, name)
        return other

    def value(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Energy (T,) [J] of each frame and its smallest J (T,); the energy is infinite where J <= 0."""
        u, cloud = contiguous(y - self.cloud.x), self.cloud
        energy, smallest = np.empty(u.shape[:2]), np.empty(u.shape[:2])
        _energy_density(
            self.law, u, cloud.neighbours, cloud.gradients, cloud.volume, self.m, self.pattern.indptr,
            self.pattern.indices, self.stiffness, energy, smallest,
        )  # fmt: skip
        return energy.sum(axis=1), smallest.min(axis=1)

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """dE/dy, (T, N, 3) [N]: minus the elastic force. Linear in the parameters m for the Neo-Hookean law."""
        return self._forces(y)[0]

    def tangent(self, y: np.ndarray, project: np.ndarray | None = None) -> "ElasticTangent":
        """The Hessian at y, exact or, in the frames where `project` (T,) is set, with negative eigenvalues removed."""
        F = self._forces(y)[1]
        frames = np.flatnonzero(project) if project is not None else np.zeros(0, int)
        H = np.zeros((len(frames), self.cloud.count, 3, 3, 3, 3))
        for n, t in enumerate(frames):
            full = self.law.projected(F[t], self.m).reshape(-1, 3, 3, 3, 3)
            H[n] = np.swapaxes(full, 2, 3) * self.cloud.volume[:, None, None, None, None]
        return ElasticTangent(elastic=self, F=F, frames=frames.astype(np.int32), projected=H)

    def parameter_gradient(self, y: np.ndarray, w: np.ndarray) -> np.ndarray:
        """w . d(dE/dy)/dm, (N, P) summed over frames, for directions w (T, N, 3): the material half of the adjoint.

        The law's part comes from Taichi's reverse mode over `MaterialFields`.
        """
        F, W = self.cloud.deformation_gradient(y), self.cloud.deformation_gradient(w + self.cloud.x) - np.eye(3)
        fields = MaterialFields.of(self.law)
        fields.load(F.reshape(-1, 3, 3), np.tile(self.m, (len(F), 1)))
        out = fields.parameter_gradient(W.reshape(-1, 3, 3)).reshape(*F.shape[:2], -1).sum(axis=0)
        out *= self.cloud.volume[:, None]
        out[:, 0] += self._stabilisation_per_modulus * self._residual_product(y - self.cloud.x, w)
        return out

    @cached_property
    def stiffness(self) -> np.ndarray:
        """The stabilisation matrix's entries (M,) [N/m] on the pattern."""
        return self.pattern.gather((self._stabilisation_per_modulus * self.m[:, 0])[:, None, None] * self._residual)

    @cached_property
    def stencil_gradients(self) -> np.ndarray:
        """Gradient vectors of a stencil, its own point first, (N, k + 1, 3)."""
        return np.concatenate([-self.cloud.gradients.sum(axis=1, keepdims=True), self.cloud.gradients], axis=1)

    @property
    def _stabilisation_per_modulus(self) -> np.ndarray:
        return self.cloud.options.stabilisation * self.cloud.volume / self.cloud.reach**2

    @cached_property
    def _residual(self) -> np.ndarray:
        """sum_j w_j r_j^T r_j, (N, k + 1, k + 1), with r_j the row giving y_ij - F_i x_ij from the stencil."""
        cloud, k = self.cloud, self.cloud.neighbours.shape[1]
        rows = np.concatenate([-np.ones((k, 1)), np.eye(k)], axis=1) - np.einsum(
            "nkc,nsc->nks", cloud.arms, self.stencil_gradients
        )
        return np.einsum("nk,nks,nkt->nst", cloud.weights, rows, rows)

    def _residual_product(self, u: np.ndarray, w: np.ndarray) -> np.ndarray:
        stencil = np.concatenate([np.arange(self.cloud.count)[:, None], self.cloud.neighbours], axis=1)
        pairs = zip(u, w, strict=True)
        return sum(np.einsum("nsa,nst,nta->n", a[stencil], self._residual, b[stencil]) for a, b in pairs)

    def _forces(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u, cloud = contiguous(y - self.cloud.x), self.cloud
        F, Q = np.empty((*u.shape, 3)), np.empty((*u.shape, 3))
        _stress(self.law, u, cloud.neighbours, cloud.gradients, cloud.volume, self.m, F, Q)
        return self._gathered(u, Q), F

    def _gathered(self, p: np.ndarray, Q: np.ndarray) -> np.ndarray:
        out, cloud = np.empty_like(p), self.cloud
        own = contiguous(self.stencil_gradients[:, 0])
        incident = (cloud.incident_start, cloud.incident_point, cloud.incident_slot)
        _gather(p, Q, own, cloud.gradients, *incident, self.pattern.indptr, self.pattern.indices, self.stiffness, out)
        return out


@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticTangent:
    """The elastic Hessian at one state of a batch, never assembled unless asked."""

    elastic: Elastic
    F: np.ndarray  # (T, N, 3, 3)
    frames: np.ndarray  # (S,) int32, frames with a projected tangent
    projected: np.ndarray  # (S, N, 3, 3, 3, 3) volume-weighted blocks H[r, c][e, d] = dP_re / dF_cd

    def product(self, p: np.ndarray) -> np.ndarray:
        """H p, (T, N, 3)."""
        e, cloud, p = self.elastic, self.elastic.cloud, contiguous(p)
        Q = np.empty((*p.shape, 3))
        _tangent(e.law, p, self.F, cloud.neighbours, cloud.gradients, cloud.volume, e.m, Q)
        if len(self.frames):
            _projected_tangent(p, self.projected, self.frames, cloud.neighbours, cloud.gradients, Q)
        return e._gathered(p, Q)

    def assembled(self, frames: slice) -> np.ndarray:
        """The Hessian's blocks (T', M, 3, 3) on the pattern, for a slice of the frames."""
        e, F = self.elastic, contiguous(self.F[frames])
        H = np.empty((*F.shape[:2], 3, 3, 3, 3))
        _full_tangent(e.law, F, e.cloud.volume, e.m, H)
        inside = np.isin(self.frames, np.arange(len(self.F))[frames])
        H[self.frames[inside] - (frames.start or 0)] = self.projected[inside]
        return e.pattern.assemble(H, e.stencil_gradients) + e.stiffness[:, None, None] * np.eye(3)
