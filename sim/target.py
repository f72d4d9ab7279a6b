"""What a material is fitted to: observed positions, and how far a simulation is from them."""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """Observed positions in correspondence: only rows where `seen` is set enter the loss."""

    y: np.ndarray  # (T, N, 3) [m]
    seen: np.ndarray  # (T, N) bool
    sigma: float | None = None  # noise per coordinate [m]; None: estimated with the fit

    def residual(self, y: np.ndarray) -> np.ndarray:
        """Observed minus simulated, (T, N, 3), zero where nothing was seen."""
        return np.where(self.seen[..., None], self.y - y, 0.0)

    def differing(self, u: np.ndarray) -> np.ndarray:
        """A motion (T, N, 3) without its mean over the frames in which a point was seen; zero where it was not."""
        seen = self.seen[..., None]
        u = np.where(seen, u, 0.0)
        return np.where(seen, u - u.sum(axis=0) / np.maximum(seen.sum(axis=0), 1), 0.0)

    def loss(self, y: np.ndarray) -> tuple[float, np.ndarray]:
        """sum |y - x*|^2 over the seen points, and its derivative: the paper's L."""
        r = self.residual(y)
        return float((r**2).sum()), -2 * r

    def frames(self, index: np.ndarray) -> "Target":
        """The chosen frames."""
        return replace(self, y=self.y[index], seen=self.seen[index])

    @property
    def count(self) -> int:
        """The number of observed coordinates."""
        return 3 * int(self.seen.sum())

    def rms(self, y: np.ndarray) -> float:
        """Root mean square residual per coordinate [m]."""
        return float(np.sqrt((self.residual(y) ** 2).sum() / self.count))
