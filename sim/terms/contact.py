"""Contact with a rigid shape, one-way: the shape goes where it is told (paper "Novel Interactions", E_c)."""

from dataclasses import dataclass, replace

import numpy as np

from sim.checks import as_array, require
from sim.terms.base import PointBlocks, per_frame
from sim.terms.shapes import Distance, Shape


def contact_alpha(mu: float, spacing: float, factor: float = 1e2) -> float:
    """Stiffness alpha = factor mu / spacing^2 [Pa/m2], relative to the material.

    A point pressed with p [Pa] then enters by about `spacing p / (2 factor mu)`.
    """
    numbers = (mu, spacing, factor)
    require(all(n > 0 for n in numbers), "mu, spacing and factor", "be positive", numbers)
    return factor * mu / spacing**2


@dataclass(frozen=True, kw_only=True, eq=False)
class Contact:
    """`E_c = sum_i V_i alpha d(y_i)^2` over the points inside the shape, d the signed distance.

    The shape stands at `position` turned by `rotation` (world = rotation @ own + position), each per frame or one row.
    """

    shape: Shape
    volume: np.ndarray  # (N,) [m3]
    alpha: float  # [Pa/m2]
    position: np.ndarray  # (T, 3) or (1, 3) [m]
    rotation: np.ndarray | None = None  # (T, 3, 3) or (1, 3, 3); None for none

    def __post_init__(self) -> None:
        require(self.alpha > 0, "alpha", "be positive", self.alpha)
        object.__setattr__(self, "position", as_array("position", np.atleast_2d(self.position), (None, 3)))
        turn = np.eye(3)[None] if self.rotation is None else np.asarray(self.rotation, float).reshape(-1, 3, 3)
        rigid = np.allclose(turn @ turn.swapaxes(1, 2), np.eye(3), atol=1e-6)
        require(rigid, "rotation", "be a rotation in every frame", "another matrix")
        object.__setattr__(self, "rotation", turn)

    def value(self, y: np.ndarray) -> np.ndarray:
        """sum V alpha d^2 over the points inside, (T,) [J]."""
        depth = np.minimum(self._distance(y).d, 0.0).reshape(y.shape[:2])
        return self.alpha * (self.volume * depth**2).sum(axis=1)

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """2 V alpha d n inside, (T, N, 3) [N]: minus the force on the object."""
        at = self._distance(y)
        push = (np.minimum(at.d, 0.0)[:, None] * at.normal).reshape(y.shape)
        return self._outward(2 * self.alpha * self.volume[:, None] * push)

    def tangent(self, y: np.ndarray, project: np.ndarray | None = None) -> PointBlocks:
        """The Hessian, exact or, in the frames where `project` (T,) is set, its positive part (see `Distance`)."""
        at, R = self._distance(y), self.rotation[:, None]
        exact = np.ones(len(y), bool) if project is None else ~project
        own = at.stiffness + np.repeat(exact, y.shape[1])[:, None, None] * at.bend
        blocks = np.where((at.d < 0)[:, None, None], own, 0.0).reshape(*y.shape, 3)
        turned = R @ blocks @ R.swapaxes(2, 3)
        return PointBlocks(blocks=2 * self.alpha * self.volume[:, None, None] * turned)

    def frames(self, index: np.ndarray) -> "Contact":
        """The shape's pose in the chosen frames."""
        position, rotation = per_frame(self.position, index), per_frame(self.rotation, index)
        return replace(self, position=position, rotation=rotation)

    def penetration(self, y: np.ndarray) -> np.ndarray:
        """Depth (T, N) [m] by which each point is inside the shape, zero outside."""
        return np.maximum(-self._distance(y).d, 0.0).reshape(y.shape[:2])

    def _distance(self, y: np.ndarray) -> Distance:
        own = np.einsum("tji,tnj->tni", np.broadcast_to(self.rotation, (len(y), 3, 3)), y - self.position[:, None])
        return self.shape.distance(own.reshape(-1, 3))

    def _outward(self, v: np.ndarray) -> np.ndarray:
        return np.einsum("tij,tnj->tni", np.broadcast_to(self.rotation, (len(v), 3, 3)), v)
