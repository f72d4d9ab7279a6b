"""Lame parameters and their conversions; they travel by name because libraries disagree on the order."""

from dataclasses import dataclass

import numpy as np

from sim.checks import as_array, require


@dataclass(frozen=True, kw_only=True)
class Lame:
    """Per-point Lame parameters in Pa, shape (N,) each: mu the shear modulus, lam the first parameter."""

    mu: np.ndarray  # (N,) [Pa]
    lam: np.ndarray  # (N,) [Pa]

    def __post_init__(self) -> None:
        mu = as_array("mu", np.atleast_1d(self.mu), (None,))
        lam = as_array("lam", np.atleast_1d(self.lam), (len(mu),))
        require(bool((mu > 0).all()), "mu", "be positive", mu.min() if len(mu) else "nothing")
        require(bool((lam > 0).all()), "lam", "be positive", lam.min() if len(lam) else "nothing")
        object.__setattr__(self, "mu", mu)
        object.__setattr__(self, "lam", lam)

    @classmethod
    def from_young(cls, young: float | np.ndarray, poisson: float | np.ndarray) -> "Lame":
        """mu = E / 2(1 + nu), lam = E nu / (1 + nu)(1 - 2 nu), for E > 0 [Pa] and 0 < nu < 1/2."""
        young, poisson = np.broadcast_arrays(np.atleast_1d(young).astype(float), np.atleast_1d(poisson).astype(float))
        require(bool(((poisson > 0) & (poisson < 0.5)).all()), "poisson", "lie between 0 and 0.5", poisson[:3])
        return cls(mu=young / (2 * (1 + poisson)), lam=young * poisson / ((1 + poisson) * (1 - 2 * poisson)))

    def spread(self, count: int) -> "Lame":
        """The same parameters on `count` points when they are homogeneous; themselves when already per point."""
        if len(self.mu) == count:
            return self
        require(len(self.mu) == 1, "mu", f"hold one value or one per point, {count}", len(self.mu))
        return Lame(mu=np.full(count, self.mu.item()), lam=np.full(count, self.lam.item()))

    @property
    def poisson(self) -> np.ndarray:
        """nu = lam / 2(lam + mu), shape (N,)."""
        return self.lam / (2 * (self.lam + self.mu))

    @property
    def young(self) -> np.ndarray:
        """E = 2 mu (1 + nu) [Pa], shape (N,)."""
        return 2 * self.mu * (1 + self.poisson)
