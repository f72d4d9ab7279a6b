"""The air stream and the force it makes: a Gaussian of constant strength that the object itself can block."""

from dataclasses import dataclass

import numpy as np

from recon.rig.raster import Shade

BIAS = 0.008  # [m] surface this little behind other surface is still blown on
FAINT = 1e-5  # of the pressure on the axis, below which there is no stream
SPACING = 0.004  # [m] of the shadow's samples


@dataclass(frozen=True, kw_only=True, eq=False)
class Stream:
    """Where the nozzle is and how it blows at one moment."""

    position: np.ndarray  # (3,) [m]
    direction: np.ndarray  # (3,) unit vector
    force: float  # [N] on a flat wall
    footprint: float  # [m]


def stream_forces(
    stream: Stream, points: np.ndarray, area: np.ndarray, vertices: np.ndarray, triangles: np.ndarray
) -> np.ndarray:
    """Forces (M, 3) [N] at points (M, 3) [m] with outward area vectors (M, 3) [m2] on a closed mesh that casts shadows.

    `f = p0 exp(-r^2 / 2 sigma^2) max(0, -A.d) d * lit`, p0 = force / (2 pi sigma^2), r the distance from the axis.
    """
    d, arm = stream.direction, points - stream.position
    r2 = ((arm - (arm @ d)[:, None] * d) ** 2).sum(axis=1)
    facing = np.maximum(0.0, -area @ d) * (arm @ d > 0)
    profile = np.exp(-r2 / (2 * stream.footprint**2))
    size = stream.force / (2 * np.pi * stream.footprint**2) * profile * facing
    touched = (facing > 0) & (profile > FAINT)
    if touched.any():
        shade = Shade.cast(vertices, triangles, d, SPACING)
        size[touched] *= shade.lit(points[touched], BIAS)
    return np.where(touched, size, 0.0)[:, None] * d
