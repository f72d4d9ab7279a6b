"""Energies of the deformation gradient that stand beside the base material: what a law adds, when and where."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from sim import runtime
from sim.checks import as_array, require
from sim.dtypes import contiguous
from sim.material import Material, MaterialTangent
from sim.stencil import Stencil
from sim.terms.base import mixed, per_frame
from sim.terms.loads import AppliedForce


@dataclass(frozen=True, kw_only=True, eq=False)
class ExtraLaw:
    """`E_t = sum_i w_ti V_i psi(F_ti; m_ti)` for a law of sim/laws, added to the base material.

    With the base's own law and a weight it changes the stiffness over time or place; `stabilised` then scales the
    base's stabilisation too (m[..., 0] being its shear modulus), so that a weight that is the same everywhere scales
    the whole elastic energy.
    """

    stencil: Stencil
    law: Any
    m: np.ndarray  # (N, P), or (1 or T, N, P) frame by frame
    weight: np.ndarray | None = None  # (1 or T, N); None for one
    stabilised: bool = False

    def __post_init__(self) -> None:
        runtime.ensure()
        N, P = self.stencil.cloud.count, len(self.law.parameters)
        m = np.asarray(self.m, float)
        m = as_array("m", m[None] if m.ndim == 2 else m, (None, N, P))
        weight = np.ones((1, N)) if self.weight is None else as_array("weight", self.weight, (None, N))
        frames = {len(m), len(weight)} - {1}
        require(len(frames) < 2, "m and weight", "have one row or equally many", sorted(frames))
        object.__setattr__(self, "m", contiguous(m))
        object.__setattr__(self, "weight", contiguous(weight))

    def value(self, y: np.ndarray) -> np.ndarray:
        """sum_i w V psi, (T,) [J]; infinite where the law is not defined, whatever the weight."""
        energy = self._material_for(y).density(y)[0]
        defined = np.isfinite(energy)
        return np.where(defined.all(axis=1), np.where(defined, energy, 0.0).sum(axis=1), np.inf)

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """`sum_i w_i V_i (dF_i/dy)^T : P_i`, (T, N, 3) [N]."""
        return self._material_for(y).forces(y)[0]

    def each(self, y: np.ndarray) -> np.ndarray:
        """The gradient's terms, of every stencil on its own points, (T, N, k + 1, 3) [N]."""
        forces = self._material_for(y).stress_forces(y)
        if not self.stabilised:
            return forces
        bent = self.stencil.bent(y - self.stencil.cloud.x)
        return forces + self.stencil.bent_forces(bent, self.weight * self.m[:, :, 0])

    def tangent(self, y: np.ndarray, project: np.ndarray | None = None) -> MaterialTangent:
        """The Hessian, exact or, in the frames where `project` (T,) is set, with each point's tangent clamped.

        The stabilisation stays as it is: with the base's it is positive for weights above -1.
        """
        material = self._material_for(y)
        F = material.forces(y)[1]
        frames = np.flatnonzero(project) if project is not None else np.zeros(0, int)
        H = np.zeros((0, self.stencil.cloud.count, 3, 3, 3, 3))
        if len(frames):
            H = _clamped(material.frames(frames).tangents(F[frames]))
        return MaterialTangent(material=material, F=F, frames=frames.astype(np.int32), projected=H)

    def frames(self, index: np.ndarray) -> "ExtraLaw":
        """The law with the parameters and weights of the chosen frames."""
        other = replace(self, m=per_frame(self.m, index), weight=per_frame(self.weight, index))
        other.__dict__["_material"] = self._material.frames(index)
        return other

    def between(self, frame: int, share: float) -> "ExtraLaw":
        """The law with parameters and weights the `share` of the way from `frame` to the next."""
        return replace(self, m=mixed(self.m, frame, share), weight=mixed(self.weight, frame, share))

    @cached_property
    def _material(self) -> Material:
        stiffness = self.stencil.stabilisation(self.weight * self.m[:, :, 0]) if self.stabilised else None
        volume = self.weight * self.stencil.cloud.volume
        return Material(stencil=self.stencil, law=self.law, m=self.m, volume=volume, stiffness=stiffness)

    def _material_for(self, y: np.ndarray) -> Material:
        rows = max(len(self.m), len(self.weight))
        require(rows in (1, len(y)), "y", f"have as many frames as m and weight have rows, {rows}", len(y))
        return self._material


@dataclass(frozen=True, kw_only=True, eq=False)
class Held(AppliedForce):
    """Given forces of stencils on their own points, (1 or T, N, k + 1, 3) [N]: minus terms of a gradient."""

    stencils: np.ndarray

    @classmethod
    def of(cls, stencil: Stencil, stencils: np.ndarray) -> "Held":
        """What they come to."""
        one = np.ones((1, stencil.cloud.count))
        return cls(stencils=stencils, force=np.concatenate([stencil.gathered(each, one) for each in stencils]))

    def each(self, y: np.ndarray) -> np.ndarray:
        """The gradient's terms."""
        return np.broadcast_to(-self.stencils, (len(y), *self.stencils.shape[1:]))

    def frames(self, index: np.ndarray) -> "Held":
        """The forces of the chosen frames."""
        return Held(force=per_frame(self.force, index), stencils=per_frame(self.stencils, index))


def _clamped(H: np.ndarray) -> np.ndarray:
    """Tangents (S, N, 3, 3, 3, 3) with their negative eigenvalues set to zero, in numpy's 9 x 9 decomposition."""
    rows = np.swapaxes(H, 3, 4).reshape(-1, 9, 9)  # H[r, c][e, d] to (r e), (c d)
    values, vectors = np.linalg.eigh((rows + rows.swapaxes(1, 2)) / 2)
    clamped = (vectors * np.maximum(values, 0.0)[:, None]) @ vectors.swapaxes(1, 2)
    return np.ascontiguousarray(np.swapaxes(clamped.reshape(*H.shape), 3, 4))
