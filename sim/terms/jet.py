"""The air jet of a nozzle as forces on a surface (paper "Dataset": compressed air from a tracked nozzle)."""

from dataclasses import dataclass, replace

import numpy as np

from sim.checks import as_array, require
from sim.occlusion import reached

_FAINT = 1e-3  # of the highest pressure: less tells nothing of an area
_KEPT = 3e-3  # of the most that any point is told, which its area counts for as it is, and
_ACROSS = 0.01  # of all that it is told itself: across jets that lie nearly in one plane their forces tell little of it
_WIDE = 20.0  # squared distance from the axis, in squared footprints, beyond which a jet is nothing (e^-10)


@dataclass(frozen=True, kw_only=True, eq=False)
class Jet:
    """An air jet over time, a Gaussian of width `footprint` around its axis."""

    position: np.ndarray  # (T, 3) [m] of the nozzle
    direction: np.ndarray  # (T, 3), unit vectors, the way the air goes
    force: np.ndarray  # (T,) [N] on a flat wall across the axis
    footprint: float  # [m]

    def frames(self, index: np.ndarray) -> "Jet":
        """The chosen frames."""
        chosen = {name: getattr(self, name)[index] for name in ("position", "direction", "force")}
        return replace(self, **chosen)


@dataclass(frozen=True, kw_only=True)
class DistanceLaw:
    """Pressure (s / core)^-exponent beyond the distance `core` [m] from the nozzle, constant before it, none behind it.

    A free round jet has exponent 2 and keeps its speed for about six nozzle diameters.
    """

    core: float  # [m]
    exponent: float = 2.0

    def __post_init__(self) -> None:
        require(self.core > 0, "core", "be positive", self.core)
        require(self.exponent >= 0, "exponent", "not be negative", self.exponent)

    def factor(self, along: np.ndarray) -> np.ndarray:
        """Pressure relative to that at the nozzle at distances `along` the axis [m]."""
        return np.where(along > 0, (np.maximum(along, self.core) / self.core) ** -self.exponent, 0.0)


def jet_forces(
    jet: Jet, y: np.ndarray, area: np.ndarray, *, law: DistanceLaw | None = None, spacing: float | None = None
) -> np.ndarray:
    """Forces (T, N, 3) [N] of a jet on points y (N, 3) or (T, N, 3) [m] with outward area vectors [m2] of either shape.

    `f_i = p0 exp(-r_i^2 / 2 sigma^2) max(0, -A_i . d) d` with `p0 = force / (2 pi sigma^2)`, r the distance from the
    axis; without a law the distance along it does not matter. With the points' spacing [m] only surface counts that
    the nozzle can reach (`sim.occlusion.reached`); without it surface behind other surface is blown on as well.
    A dead load takes the rest shape (`RestCloud.x`, `.area`), a follower load the deformed one (`sim.follower`).
    Raises ValueError for a footprint that is not positive and for shapes that do not fit.
    """
    y, area = (_batched(name, value, len(jet.force)) for name, value in (("y", y), ("area", area)))
    position, d, along, across, pressure = _blowing(jet, y)
    if law is not None:
        pressure = pressure * law.factor(along)
    blown = pressure * np.maximum(0.0, -(area * d).sum(axis=2))
    if spacing is not None:
        asked = (across < _WIDE * jet.footprint**2) & (blown > 0)
        blown = blown * _reached(position[:, 0], d[:, 0], y, area, spacing, asked)
    return blown[..., None] * d


def pressures(jet: Jet, x: np.ndarray) -> np.ndarray:
    """Pressure (T, N) [Pa] of a jet on points x (N, 3) or (T, N, 3) [m], `p0 exp(-r_i^2 / 2 sigma^2)`.

    Raises ValueError for a footprint that is not positive and for shapes that do not fit.
    """
    return _blowing(jet, _batched("x", x, len(jet.force)))[4]


def reblown(jet: Jet, other: Jet, x: np.ndarray, area: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """The given forces (T, N, 3) [N] of a jet on points x (N, 3) [m], as another jet would make them.

    What areas (N, 3) [m2] do not explain of them stays, but for what the other jet blows less where the jet blew:
    `f' = b(other) + (f - b(jet)) min(1, p(other) / p(jet))`.
    """
    before, blown = pressures(jet, x), jet_forces(jet, x, area)
    less = np.minimum(pressures(other, x) / np.maximum(before, 1e-300), 1.0)
    stays = np.where(blown.any(axis=2) & (before > _FAINT * before.max(initial=0.0)), less, 1.0)
    return jet_forces(other, x, area) + (forces - blown) * stays[..., None]


def told_area(jet: Jet, x: np.ndarray, area: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Outward area vectors (N, 3) [m2] of points x (N, 3) [m] with which the jet's forces are the given (T, N, 3) [N].

    Least squares of `f . d = p max(0, -A . d)` over the frames that blow on a point, and as near to `area` (N, 3) as
    they let it: where no jet came, and across all that came, nothing changes, and little across nearly all.
    """
    pressure, d = pressures(jet, x), np.asarray(jet.direction, float)[:, None]
    given, facing = (forces * d).sum(axis=2), -(area * d).sum(axis=2)
    blown = pressure * ((given > 0) | (facing > 0)) * (pressure > _FAINT * pressure.max())
    known = np.einsum("tn,ta,tb->nab", blown**2, d[:, 0], d[:, 0])
    right, all_of = np.einsum("tn,ta->na", blown * (blown * facing - given), d[:, 0]), (blown**2).sum(axis=0)
    least = np.maximum(_KEPT * float(all_of.max()) + _ACROSS * all_of, 1e-300)
    return area + np.linalg.solve(known + least[:, None, None] * np.eye(3), right[..., None])[..., 0]


def _blowing(jet: Jet, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """Nozzle and direction (T, 1, 3) of a jet; distance along, squared across its axis, pressure on it, all (T, N)."""
    require(jet.footprint > 0, "footprint", "be positive", jet.footprint)
    force = as_array("force", jet.force, (None,))
    position = as_array("position", jet.position, (len(force), 3))[:, None]
    d = as_array("direction", jet.direction, (len(force), 3))[:, None]
    arm = y - position
    along = (arm * d).sum(axis=2)
    across = ((arm - along[..., None] * d) ** 2).sum(axis=2)
    pressure = force[:, None] / (2 * np.pi * jet.footprint**2) * np.exp(-across / (2 * jet.footprint**2))
    return position, d, along, across, pressure


def _reached(
    position: np.ndarray, d: np.ndarray, y: np.ndarray, area: np.ndarray, spacing: float, asked: np.ndarray
) -> np.ndarray:
    """How far (T, N) each frame's nozzle reaches the points; 0 for those not asked (T, N) bool."""
    shape = (len(position), *y.shape[1:])
    y, area = np.broadcast_to(y, shape), np.broadcast_to(area, shape)
    frames = zip(position, d, y, area, asked, strict=True)
    return np.array([reached(p, e, x, a, spacing, asked=wanted) for p, e, x, a, wanted in frames])


def _batched(name: str, value: np.ndarray, frames: int) -> np.ndarray:
    value = np.asarray(value, float)
    fits = value.shape[-1:] == (3,) and (value.ndim == 2 or (value.ndim == 3 and len(value) in (1, frames)))
    require(fits, name, f"have shape (N, 3) or ({frames}, N, 3)", value.shape)
    return value if value.ndim == 3 else value[None]
