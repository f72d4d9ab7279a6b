"""The elastic energy of a rest cloud: value, gradient and Hessian products over a batch of frames (paper E_NH)."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from sim import runtime
from sim.cloud import RestCloud
from sim.dtypes import contiguous
from sim.lame import Lame
from sim.laws.fields import MaterialFields
from sim.laws.neo_hookean import NeoHookean
from sim.material import Material, MaterialTangent
from sim.pattern import Pattern
from sim.stencil import Stencil


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
        other.__dict__["stencil"] = self.stencil  # it belongs to the cloud
        return other

    def value(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Energy (T,) [J] of each frame and its smallest J (T,); the energy is infinite where J <= 0."""
        energy, J = self.material.density(y)
        return energy.sum(axis=1), J.min(axis=1)

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """dE/dy, (T, N, 3) [N]: minus the elastic force. Linear in the parameters m for the Neo-Hookean law."""
        return self.material.forces(y)[0]

    def each(self, y: np.ndarray) -> np.ndarray:
        """The gradient's terms, of every stencil on its own points, (T, N, k + 1, 3) [N]."""
        held = self.stencil.bent_forces(self.stencil.bent(y - self.cloud.x), self.m[:, 0])
        return self.material.stress_forces(y) + held

    def tangent(self, y: np.ndarray, project: np.ndarray | None = None) -> "ElasticTangent":
        """The Hessian at y, exact or, in the frames where `project` (T,) is set, with negative eigenvalues removed."""
        F = self.material.forces(y)[1]
        frames = np.flatnonzero(project) if project is not None else np.zeros(0, int)
        H = np.zeros((len(frames), self.cloud.count, 3, 3, 3, 3))
        for n, t in enumerate(frames):
            full = self.law.projected(F[t], self.m).reshape(-1, 3, 3, 3, 3)
            H[n] = np.swapaxes(full, 2, 3) * self.cloud.volume[:, None, None, None, None]
        frames = frames.astype(np.int32)
        return ElasticTangent(elastic=self, material=self.material, F=F, frames=frames, projected=H)

    def parameter_gradient(self, y: np.ndarray, w: np.ndarray) -> np.ndarray:
        """w . d(dE/dy)/dm, (N, P) summed over frames, for directions w (T, N, 3): the material half of the adjoint.

        The law's part comes from Taichi's reverse mode over `MaterialFields`.
        """
        F, W = self.cloud.deformation_gradient(y), self.cloud.deformation_gradient(w + self.cloud.x) - np.eye(3)
        fields = MaterialFields.of(self.law)
        fields.load(F.reshape(-1, 3, 3), np.tile(self.m, (len(F), 1)))
        out = fields.parameter_gradient(W.reshape(-1, 3, 3)).reshape(*F.shape[:2], -1).sum(axis=0)
        out *= self.cloud.volume[:, None]
        out[:, 0] += self.stencil.stabilisation_per_modulus * self.stencil.residual_product(y - self.cloud.x, w)
        return out

    @cached_property
    def stencil(self) -> Stencil:
        """The cloud's stencils."""
        return Stencil(cloud=self.cloud, pattern=self.pattern)

    @cached_property
    def stiffness(self) -> np.ndarray:
        """The stabilisation matrix's entries (M,) [N/m] on the pattern."""
        return self.stencil.stabilisation(self.m[:, 0])

    @property
    def stencil_gradients(self) -> np.ndarray:
        """Gradient vectors of a stencil, its own point first, (N, k + 1, 3)."""
        return self.stencil.gradients

    @cached_property
    def material(self) -> Material:
        """The law on the cloud, with the stabilisation."""
        m, volume, stiffness = self.m[None], self.cloud.volume[None], self.stiffness[None]
        return Material(stencil=self.stencil, law=self.law, m=m, volume=volume, stiffness=stiffness)


@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticTangent(MaterialTangent):
    """The elastic Hessian at one state of a batch."""

    elastic: Elastic
