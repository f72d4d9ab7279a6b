"""What a body of the rig is made of: outlines as smooth functions, negative inside, and everything else about it.

Metres; z up from the ground z = 0; the front, where the nozzle is, looks towards -y.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Array = np.ndarray
# A frame, the place [m] through which the jet's axis passes in it, and the way from there back to the nozzle.
Station = tuple[int, tuple[float, float, float], tuple[float, float, float]]
Outline = Callable[[Array], Array]  # (M, 3) -> (M,), about the distance to the surface near it


@dataclass(frozen=True, kw_only=True, eq=False)
class Pull:
    """A line knotted to the surface at `knot`, pulled towards `anchor` with up to `force` newtons."""

    knot: tuple[float, float, float]
    anchor: tuple[float, float, float]
    force: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Soft:
    """A body before it is meshed."""

    outline: Outline
    lines: tuple[Array, Array, Array]  # planes of the lattice along x, y, z [m]
    mu: Callable[[Array], Array]  # (M, 3) -> (M,) [Pa]
    poisson: Callable[[Array], Array]
    density: float  # [kg/m3]
    held: float  # points below this height are taped to the ground [m]
    pulls: tuple[Pull, ...]
    jet: float  # [N]
    path: tuple[Station, ...]
    tips: tuple[tuple[float, float, float], ...] = ()  # where the outline ends too sharply for the lattice to find it
    bend: Callable[[Array], Array] = lambda p: p  # lattice points (M, 3) to where they are needed
    footprint: float = 0.028  # [m] of the jet


def ellipsoid(centre: tuple, radii: tuple, *, tilt: float = 0.0) -> Outline:
    """An ellipsoid, turned by `tilt` [rad] about y."""
    c, s = np.cos(tilt), np.sin(tilt)
    turn, r = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]), np.array(radii)

    def outline(p: Array) -> Array:
        q = (p - centre) @ turn.T
        near, far = np.linalg.norm(q / r, axis=1), np.linalg.norm(q / r**2, axis=1)
        return near * (near - 1) / np.maximum(far, 1e-9)

    return outline


def limb(start: tuple, end: tuple, thick: float, thin: float) -> Outline:
    """A rod with round ends whose radius goes from `thick` to `thin`."""
    a, b = np.array(start), np.array(end)

    def outline(p: Array) -> Array:
        along = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        return np.linalg.norm(p - a - along[:, None] * (b - a), axis=1) - (thick + along * (thin - thick))

    return outline


def joined(parts: list[Outline], *, seam: float = 0.012) -> Outline:
    """The union with rounded seams, standing on the ground."""

    def outline(p: Array) -> Array:
        d = np.stack([part(p) for part in parts])
        least = d.min(axis=0)
        union = least - seam * np.log(np.exp(-(d - least) / seam).sum(axis=0)) * 0.5
        return np.maximum(union, -p[:, 2])

    return outline


def lines(start: float, *stretches: tuple[float, float]) -> Array:
    """Planes from `start` through stretches (end, spacing), the spacings rounded to fit."""
    out = [start]
    for end, spacing in stretches:
        out.extend(np.linspace(out[-1], end, max(1, round(abs(end - out[-1]) / spacing)) + 1)[1:])
    return np.array(out)


def step(x: Array, at: float, width: float) -> Array:
    """0 below, 1 above, over a few `width`."""
    return 1 / (1 + np.exp(-np.clip((x - at) / width, -50, 50)))


def mixed(*shares: tuple[float, Array]) -> Array:
    """exp of the sum of log ratios times shares: a material that is blended in its logarithm."""
    return np.exp(sum(np.log(ratio) * share for ratio, share in shares))
