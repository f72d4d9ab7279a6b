"""Which parts of a surface the air of a nozzle can reach: those that no other part hides from it."""

import numpy as np
from scipy.spatial import cKDTree

from sim.checks import as_array, require

_REACH = 2.0  # spacings, the radius over which a point's area is spread across the air's way
_ABOVE = (0.5, 1.0)  # spacings over the hidden point's tangent plane: none below the first, all beyond the second
_GRAZING = 0.1  # cosine below which a surface turns out of the air's sight
_EDGE = (0.25, 0.75)  # covered share at which shade begins and is full: a half at the outline


def reached(
    position: np.ndarray,
    direction: np.ndarray,
    y: np.ndarray,
    area: np.ndarray,
    spacing: float,
    *,
    asked: np.ndarray | None = None,
) -> np.ndarray:
    """How far (N,), from 0 to 1, air from a nozzle at `position` (3,) [m] reaches points y (N, 3) [m] of a surface.

    `1 - smooth(sum_j max(0, -A_j . e_j) W(r_ij))` over the points j before point i: e_j the way from the nozzle to
    j, A_j its outward area vector (N, 3) [m2], r_ij how far j is from the line to i, W a kernel of unit integral
    and radius two spacings. Front faces cover a body's outline once, so the sum is the share of the air's way that
    is covered, a half at the outline, whatever the points' density. Points that look away, lie behind the nozzle's
    mouth or have no area get 0, those that look across fade below a cosine of 0.1. What rises less than half a
    spacing over a point's tangent plane hides nothing, so a convex body never hides what it shows.
    spacing [m]: between neighbouring points. asked: (N,) bool, the points whose answer matters, default all; the
    others get 0 but still hide.
    Raises ValueError for a spacing that is not positive and for shapes that do not fit.
    """
    require(spacing > 0, "spacing", "be positive", spacing)
    y = as_array("y", y, (None, 3))
    area = as_array("area", area, y.shape)
    arm = y - as_array("position", position, (3,))
    distance = np.maximum(np.linalg.norm(arm, axis=1), np.finfo(float).tiny)
    e = arm / distance[:, None]
    size = np.linalg.norm(area, axis=1)
    facing = -(area * e).sum(axis=1)
    ahead = (facing > 0) & (arm @ as_array("direction", direction, (3,)) > 0)
    seen, front = np.zeros(len(y)), np.flatnonzero(ahead)
    far = front if asked is None else np.flatnonzero(ahead & as_array("asked", asked, (len(y),), bool))
    if len(far) == 0:
        return seen
    reach = _REACH * spacing
    pair = _in_line(e[far], e[front], reach / max(distance[front].min(), spacing))
    i, j = far[pair["i"]], front[pair["j"]]
    off = pair["v"] * distance[j]
    hides = (off < reach) & (distance[j] < distance[i])
    i, j, off = i[hides], j[hides], off[hides]
    above = ((y[j] - y[i]) * area[i]).sum(axis=1) / (size[i] * spacing)
    kernel = 3 / (np.pi * reach**2) * (1 - (off / reach) ** 2) ** 2
    covered = np.bincount(i, facing[j] * kernel * _smooth(above, _ABOVE), minlength=len(y))
    seen[far] = np.clip(facing[far] / size[far] / _GRAZING, 0, 1) * (1 - _smooth(covered[far], _EDGE))
    return seen


def _in_line(some: np.ndarray, others: np.ndarray, apart: float) -> np.ndarray:
    """Pairs `i`, `j` of unit vectors (n, 3) and (m, 3) less than `apart` from each other, and how far as `v`."""
    return cKDTree(some).sparse_distance_matrix(cKDTree(others), min(apart, 2.0), output_type="ndarray")


def _smooth(value: np.ndarray, between: tuple[float, float]) -> np.ndarray:
    """0 up to the first bound, 1 from the second, and a smooth step in between."""
    share = np.clip((value - between[0]) / (between[1] - between[0]), 0, 1)
    return share**2 * (3 - 2 * share)
