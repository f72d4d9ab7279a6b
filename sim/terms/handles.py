"""Handles: points softly held where they were observed (paper E_A), and strings that only pull."""

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


@dataclass(frozen=True, kw_only=True, eq=False)
class Strings:
    """`E = sum_q alpha_q <|y_q - a| - l_q>^2`, <s> = max(s, 0): strings to one anchor that pull where they get longer
    than at rest, and never push."""

    points: np.ndarray  # (Q,) indices
    anchor: np.ndarray  # (3,) [m]
    length: np.ndarray  # (Q,) [m], at which each is just taut
    alpha: np.ndarray  # (Q,) [N/m]

    def value(self, y: np.ndarray) -> np.ndarray:
        """Energy (T,) [J]."""
        return (self.alpha * self._stretched(y)[2] ** 2).sum(axis=1)

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """2 alpha <s> d / |d| at the points, d from the anchor, (T, N, 3) [N]."""
        d, r, longer = self._stretched(y)
        out = np.zeros_like(y)
        out[:, self.points] = (2 * self.alpha * longer / r)[..., None] * d
        return out

    def tangent(self, y: np.ndarray, project: np.ndarray | None = None) -> PointBlocks:
        """2 alpha (n n^T + <s> / |d| (I - n n^T)) where one is taut: positive as it is."""
        d, r, longer = self._stretched(y)
        along = d[..., :, None] * d[..., None, :] / (r**2)[..., None, None]
        stiff = (longer > 0)[..., None, None] * along + (longer / r)[..., None, None] * (np.eye(3) - along)
        blocks = np.zeros((*y.shape, 3))
        blocks[:, self.points] = 2 * self.alpha[:, None, None] * stiff
        return PointBlocks(blocks=blocks)

    def frames(self, index: np.ndarray) -> "Strings":
        """The same in all."""
        return self

    def _stretched(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """From the anchor to each point (T, Q, 3), how far that is, and by how much more than its length, (T, Q)."""
        d = y[:, self.points] - self.anchor
        r = np.maximum(np.linalg.norm(d, axis=2), 1e-300)
        return d, r, np.maximum(r - self.length, 0.0)
