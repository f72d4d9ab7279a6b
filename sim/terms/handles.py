"""Strings and other handles: points softly held where they were observed (paper E_A)."""

from dataclasses import dataclass, replace

import numpy as np

from sim.terms.base import PointBlocks, mixed, per_frame


@dataclass(frozen=True, kw_only=True, eq=False)
class Handles:
    """`E = sum_q alpha_q |y_q - x*_q|^2` over the handled points; alpha is zero where a handle was not seen."""

    points: np.ndarray  # (Q,) indices
    targets: np.ndarray  # (T, Q, 3) or (1, Q, 3) [m]
    alpha: np.ndarray  # (T, Q), (1, Q) or (Q,) [N/m]

    def __post_init__(self) -> None:
        object.__setattr__(self, "alpha", np.atleast_2d(self.alpha))

    @classmethod
    def relative(
        cls,
        points: np.ndarray,
        targets: np.ndarray,
        *,
        mu: float,
        spacing: float,
        seen: np.ndarray | None = None,
        factor: float = 1e2,
    ) -> "Handles":
        """Handles with alpha = factor mu spacing: relative to the material, so that fits compare between objects.

        seen (T, Q) bool: where a handle's position is known; default everywhere.
        """
        seen = np.ones((1, len(points)), bool) if seen is None else seen
        return cls(points=points, targets=targets, alpha=factor * mu * spacing * seen)

    def value(self, y: np.ndarray) -> np.ndarray:
        """Energy (T,) [J]."""
        return (self.alpha * ((y[:, self.points] - self.targets) ** 2).sum(axis=2)).sum(axis=1)

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """2 alpha (y - x*) at the handles, (T, N, 3) [N]."""
        out = np.zeros_like(y)
        out[:, self.points] = 2 * self.alpha[..., None] * (y[:, self.points] - self.targets)
        return out

    def tangent(self, y: np.ndarray, project: np.ndarray | None = None) -> PointBlocks:
        """2 alpha I at the handles."""
        blocks = np.zeros((*y.shape, 3))
        blocks[:, self.points] = 2 * self.alpha[..., None, None] * np.eye(3)
        return PointBlocks(blocks=blocks)

    def frames(self, index: np.ndarray) -> "Handles":
        """The targets of the chosen frames."""
        return replace(self, targets=per_frame(self.targets, index), alpha=per_frame(self.alpha, index))

    def between(self, frame: int, share: float) -> "Handles":
        """The handles the `share` of the way from `frame` to the next: the energy is interpolated.

        With one alpha the target moves on a straight line; a handle that was not seen in a frame takes the other's.
        """
        alpha, pull = mixed(self.alpha, frame, share), self.alpha[..., None] * self.targets
        seen = np.where(alpha > 0, alpha, 1.0)[..., None]
        return replace(self, targets=mixed(pull, frame, share) / seen, alpha=alpha)
