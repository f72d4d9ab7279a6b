"""The stress a machine would show: the Neo-Hookean law with any causes beside it."""

from dataclasses import dataclass

import numpy as np

from veo_ti.coupons.curves import free_of_pressure, principal
from veo_ti.coupons.laws import Cause

_TABLE = 1500


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """`W = mu (1/2 (I1 - 3) + what the causes add)`, seen through what they do to the measurement."""

    causes: tuple[Cause, ...] = ()

    @property
    def width(self) -> np.ndarray:
        """Prior standard deviations of all parameters but mu, (d,)."""
        return np.concatenate([np.zeros(0), *(cause.width for cause in self.causes)])

    @property
    def positive(self) -> np.ndarray:
        """Which parameters physics wants above zero, (d,)."""
        return np.array([p.positive for cause in self.causes for p in cause.parameters], bool)

    @property
    def name(self) -> str:
        """The forms, for people."""
        return " + ".join(cause.form.replace("_", " ") for cause in self.causes) or "Neo-Hookean"

    def with_cause(self, cause: Cause) -> "Model":
        """One cause more."""
        return Model(causes=(*self.causes, cause))

    def split(self, theta: np.ndarray) -> list[np.ndarray]:
        """The parameters (d,) cause by cause."""
        parts, first = [], 0
        for cause in self.causes:
            parts.append(theta[first : first + len(cause.parameters)])
            first += len(cause.parameters)
        return parts

    def allows(self, theta: np.ndarray) -> bool:
        """Whether every law has a finite stress in reach, and no negative spring stands in series."""
        parts = zip(self.causes, self.split(theta), strict=True)
        return all(t[0] < c.limit and (c.name != "machine_compliance" or t[0] >= 0) for c, t in parts)

    def material(self, mode: str, stretch: np.ndarray, mu: float, theta: np.ndarray) -> np.ndarray:
        """The nominal stress of the specimen at its own stretch, (n,) [Pa]; infinite where a law has locked."""
        s = principal(mode, stretch)
        slope = s.copy()
        for cause, own in zip(self.causes, self.split(theta), strict=True):
            slope += cause.slope(s, own)
        with np.errstate(invalid="ignore"):  # locked: infinity less infinity
            stress = mu * free_of_pressure(s, slope)
        return np.where(np.isnan(stress), np.inf, stress)

    def stress(self, mode: str, stretch: np.ndarray, mu: float, theta: np.ndarray) -> np.ndarray:
        """The nominal stress shown by the machine at the stretch shown by it, (n,) [Pa]."""
        give, parts = 0.0, self.split(theta)
        for cause, own in zip(self.causes, parts, strict=True):
            stretch = cause.strained(mode, stretch, own)
            give = float(own[0]) if cause.name == "machine_compliance" else give
        stress = (
            self.material(mode, stretch, mu, theta) if give == 0 else self._in_series(mode, stretch, mu, theta, give)
        )
        for cause, own in zip(self.causes, parts, strict=True):
            stress = cause.shown(mode, stress, own)
        return stress

    def _in_series(self, mode: str, stretch: np.ndarray, mu: float, theta: np.ndarray, give: float) -> np.ndarray:
        """The specimen's stress where `s + give P(s)` is the stretch shown, from a table of s between its bounds."""
        s = np.linspace(min(1.0, float(stretch.min())), max(1.0, float(stretch.max())), _TABLE)
        stress = self.material(mode, s, mu, theta)
        s, stress = s[np.isfinite(stress)], stress[np.isfinite(stress)]
        return np.interp(stretch, s + give * stress, stress)
