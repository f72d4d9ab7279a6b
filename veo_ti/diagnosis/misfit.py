"""How much more is left than noise leaves."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Misfit:
    """Energy, its mean and standard deviation under "noise only", in units in which a white mode has energy one."""

    energy: float
    mean: float
    sd: float

    @classmethod
    def of(cls, u: np.ndarray, C: np.ndarray) -> "Misfit":
        """From modes^T Sigma^-1 z and its covariance."""
        scale = 1 / np.maximum(np.diagonal(C).max(), 1e-300)
        return cls(float(scale * u @ u), float(scale * np.trace(C)), float(scale * np.sqrt(2 * (C**2).sum())))

    @property
    def z(self) -> float:
        """Standard deviations above the expectation."""
        return (self.energy - self.mean) / self.sd

    @property
    def excess(self) -> float:
        """Energy beyond the expectation."""
        return max(self.energy - self.mean, 0.0)
