"""Viscosity of the material over a small step, as an energy that can be minimised with the others."""

from dataclasses import dataclass, replace

import numpy as np

from sim.elastic import Elastic
from sim.material import MaterialTangent


def turned_stiffness(elastic: Elastic, y: np.ndarray, factor: float = 1.0) -> MaterialTangent:
    """`factor` times K(y): every point's stiffness at rest, turned by the rotation R of its F = R U.

    `K(y) p = sum_i V_i G_i^T R_i A (R_i^T D_i p)`, A = d2 psi / dF2 at rest and D_i p the gradient of p. It is the
    tangent at F = R, because P(R F) = R P(F); positive semi-definite, and blind to the spin of what is not strained.
    """
    U, _, Vt = np.linalg.svd(elastic.cloud.deformation_gradient(y))
    U[..., 2] *= np.linalg.det(U @ Vt)[..., None]
    whole = elastic.material
    part = replace(whole, volume=factor * whole.volume, stiffness=factor * whole.stiffness)
    return MaterialTangent(
        material=part, F=U @ Vt, frames=np.zeros(0, np.int32), projected=np.zeros((0, len(elastic.m), 3, 3, 3, 3))
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Viscosity:
    """`E = 1/2 (y - origin) . K (y - origin)` over one frame."""

    K: MaterialTangent  # of one frame, positive semi-definite
    origin: np.ndarray  # (1, N, 3) [m]

    def value(self, y: np.ndarray) -> np.ndarray:
        """Energy (1,) [J]."""
        return 0.5 * (self.gradient(y) * (y - self.origin)).sum(axis=(1, 2))

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """K (y - origin), (1, N, 3) [N]."""
        return self.K.product(y - self.origin)

    def tangent(self, y: np.ndarray, project: np.ndarray | None = None) -> MaterialTangent:
        """K."""
        return self.K

    def frames(self, index: np.ndarray) -> "Viscosity":
        """Itself: there is one frame."""
        return self
