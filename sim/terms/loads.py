"""Loads that do work on the points: applied forces and gravity (paper E_W, with the sign that makes f a force)."""

from dataclasses import dataclass, replace

import numpy as np

from sim.terms.base import mixed, per_frame


@dataclass(frozen=True, kw_only=True, eq=False)
class AppliedForce:
    """`E = - sum_i f_i . y_i`. The paper prints a plus; with it, f would be the force the object exerts."""

    force: np.ndarray  # (T, N, 3) or (1, N, 3) [N]

    def value(self, y: np.ndarray) -> np.ndarray:
        """-sum f . y, (T,) [J]."""
        return -(self.force * y).sum(axis=(1, 2))

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """-f, (T, N, 3) [N]."""
        return np.broadcast_to(-self.force, y.shape)

    def tangent(self, y: np.ndarray, project: np.ndarray | None = None) -> None:
        """None: a dead load has no stiffness."""

    def frames(self, index: np.ndarray) -> "AppliedForce":
        """The loads of the chosen frames."""
        return replace(self, force=per_frame(self.force, index))

    def between(self, frame: int, share: float) -> "AppliedForce":
        """The load the `share` of the way from `frame` to the next."""
        return replace(self, force=mixed(self.force, frame, share))


def gravity_change(mass: np.ndarray, change: np.ndarray) -> AppliedForce:
    """The load of a gravity that differs from the reference pose's by `change` (T, 3) [m/s2]; mass (N,) [kg].

    The reference pose already carries gravity, so by default only a change of it is a load (paper: "P_0, where it is
    subject to no external forces besides gravity").
    """
    return AppliedForce(force=mass[None, :, None] * np.atleast_2d(change)[:, None, :])
