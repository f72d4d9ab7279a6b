"""Viscosity of the material over a small step, as an energy that can be minimised with the others."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sim.elastic import Elastic, ElasticTangent


def turned_stiffness(elastic: Elastic, y: np.ndarray) -> ElasticTangent:
    """K(y): the stiffness at rest of every point, turned with it by the rotation of its F (polar decomposition).

    `K(y) p = sum_i V_i G_i^T R_i A (R_i^T D_i p)` with A = d2 psi / dF2 at rest: the tangent at F = R, because P(R F) =
    R P(F). Positive semi-definite, and blind to the spin of a part that is turned but not strained.
    """
    U, _, Vt = np.linalg.svd(elastic.cloud.deformation_gradient(y))
    U[..., 2] *= np.linalg.det(U @ Vt)[..., None]
    return replace(elastic.tangent(y), F=U @ Vt)


@dataclass(frozen=True, kw_only=True, eq=False)
class Viscosity:
    """`E = rate/2 (y - origin) . K (y - origin)` over one frame, with the gradient rate K (y - origin)."""

    K: ElasticTangent  # of one frame
    origin: np.ndarray  # (1, N, 3) [m]
    rate: float

    def value(self, y: np.ndarray) -> np.ndarray:
        """Energy (1,) [J]."""
        return 0.5 * (self.gradient(y) * (y - self.origin)).sum(axis=(1, 2))

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """rate K (y - origin), (1, N, 3) [N]."""
        return self.rate * self.K.product(y - self.origin)

    def tangent(self, y: np.ndarray, project: np.ndarray | None = None) -> "ViscousTangent":
        """rate K, which has no negative part."""
        return ViscousTangent(K=self.K, rate=self.rate)

    def frames(self, index: np.ndarray) -> "Viscosity":
        """Itself: there is one frame."""
        return self


@dataclass(frozen=True, kw_only=True, eq=False)
class ViscousTangent:
    """rate K, whose pairs are assembled when a preconditioner asks for them."""

    K: ElasticTangent
    rate: float

    @property
    def blocks(self) -> np.ndarray:
        """Zeros (1, N, 3, 3): single points are among the pairs."""
        return np.zeros_like(self.K.F)

    @cached_property
    def pairs(self) -> np.ndarray:
        """rate K on the elastic pattern, (M, 3, 3) [N/m]."""
        return self.rate * self.K.assembled(slice(0, 1))[0]

    def product(self, p: np.ndarray) -> np.ndarray:
        """rate K p, (1, N, 3)."""
        return self.rate * self.K.product(p)
