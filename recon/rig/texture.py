"""Solid textures: the colour of the plush at any rest position, so that it sticks to the body however it moves."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

Array = np.ndarray
SIDE = 64  # of the periodic lattice of random numbers
FLEECE = ((0.0065, 0.30), (0.0028, 0.30), (0.0150, 0.18))  # [m] and strength of the mottles


TURN = Rotation.from_rotvec([0.7, -0.4, 0.9]).as_matrix()  # the lattice shows least where it is askew


@lru_cache(maxsize=1)
def _lattice() -> Array:
    return np.random.default_rng(164).uniform(-1, 1, (SIDE, SIDE, SIDE)).astype(np.float32)


def noise(p: Array, size: float, seed: int = 0) -> Array:
    """Smooth random values in -1..1 at points (M, 3) [m], that change over about `size` [m]."""
    at = (p @ TURN / size + [17.3 * seed + 0.37, 5.1 * seed, 9.7 * seed]).astype(np.float32)
    low = np.floor(at)
    share = at - low
    share *= share * (3 - 2 * share)
    low = low.astype(np.int64)
    x, y, z = (np.stack([low[:, i] % SIDE, (low[:, i] + 1) % SIDE]) for i in range(3))
    values = _lattice().ravel()
    out = np.zeros(len(p), np.float32)
    for i in (0, 1):
        for j in (0, 1):
            row = (x[i] * SIDE + y[j]) * SIDE
            plane = np.abs(1 - i - share[:, 0]) * np.abs(1 - j - share[:, 1])
            out += plane * ((1 - share[:, 2]) * values[row + z[0]] + share[:, 2] * values[row + z[1]])
    return out


def colour_of(shape: str, p: Array) -> Array:
    """Reflectance (M, 3) in 0..1, linear RGB, at rest positions (M, 3) [m] of one of the shapes."""
    base = PAINT[shape](p)
    relief = np.ones(len(p), np.float32)
    for i, (size, strength) in enumerate(FLEECE):
        relief += strength * noise(p, size, seed=i + 1)
    tint = 1 + 0.10 * noise(p, 0.009, seed=7)[:, None] * np.array([1.0, -0.4, -0.8], np.float32)
    return np.clip(base * tint * np.clip(relief, 0.25, 1.7)[:, None], 0.012, 0.92).astype(np.float32)


def _mix(base: Array, colour: tuple, share: Array) -> Array:
    return base + share[:, None] * (np.array(colour, np.float32) - base)


def _inside(distance: Array, soft: float) -> Array:
    """1 where a distance is negative, 0 beyond, over `soft` [m]."""
    return np.clip(0.5 - distance / soft, 0, 1).astype(np.float32)


def _ball(p: Array, centre: tuple, radii: tuple) -> Array:
    """About the distance [m] to an ellipsoid."""
    return (np.linalg.norm((p - centre) / radii, axis=1) - 1) * min(radii)


def _spots(p: Array, size: float, seed: int, most: float) -> Array:
    return _inside(most - 0.75 * noise(p, size, seed) - 0.35 * noise(p, 0.4 * size, seed + 30), 0.10)


def _seam(distance: Array) -> Array:
    """A stitched line: darker within a millimetre of a surface at the distance [m]."""
    return 0.45 * np.exp(-((distance / 0.0011) ** 2)).astype(np.float32)


def _eye(base: Array, p: Array, centre: tuple, radius: float, glint: tuple) -> Array:
    eye = _mix(base, (0.010, 0.008, 0.008), _inside(_ball(p, centre, (radius,) * 3), 0.0008))
    return _mix(eye, (0.9, 0.9, 0.9), _inside(_ball(p, tuple(np.add(centre, glint)), (0.0028,) * 3), 0.0008))


def _plush(p: Array) -> Array:
    base = np.tile(np.array([0.52, 0.30, 0.14], np.float32), (len(p), 1))
    base = _mix(base, (0.42, 0.21, 0.09), 0.7 * _spots(p, 0.022, 11, 0.25))
    base = _mix(base, (0.78, 0.66, 0.47), _inside(_ball(p, (0, -0.060, 0.090), (0.048, 0.045, 0.058)), 0.003))
    base = _mix(base, (0.80, 0.69, 0.52), _inside(_ball(p, (0, -0.066, 0.180), (0.034, 0.034, 0.024)), 0.003))
    for s in (-1, 1):
        base = _mix(
            base, (0.72, 0.33, 0.33), _inside(_ball(p, (s * 0.056, -0.026, 0.272), (0.014, 0.016, 0.040)), 0.003)
        )
        base = _mix(
            base, (0.75, 0.60, 0.40), _inside(_ball(p, (s * 0.052, -0.108, 0.024), (0.022, 0.014, 0.020)), 0.003)
        )
        base = _eye(base, p, (s * 0.030, -0.055, 0.206), 0.0085, (0.0, -0.006, 0.0045))
    base = _mix(base, (0.08, 0.03, 0.03), _inside(_ball(p, (0, -0.066, 0.187), (0.009, 0.012, 0.006)), 0.001))
    mouth = np.abs(p[:, 2] - 0.172 - 9 * (np.abs(p[:, 0]) - 0.010) ** 2)
    base = base * (1 - _seam(mouth) * ((np.abs(p[:, 0]) < 0.021) & (p[:, 1] < -0.045)))[:, None]
    return base * (1 - _seam(p[:, 0]) * (p[:, 1] > -0.01))[:, None]


def _dinosaur(p: Array) -> Array:
    base = np.tile(np.array([0.17, 0.42, 0.20], np.float32), (len(p), 1))
    base = _mix(base, (0.08, 0.24, 0.14), 0.85 * _spots(p, 0.020, 12, 0.15))
    base = _mix(base, (0.65, 0.62, 0.25), 0.9 * _spots(p, 0.013, 13, 0.45))
    belly = _ball(p, (-0.005, 0, 0.075), (0.085, 0.040, 0.028))
    base = _mix(base, (0.70, 0.66, 0.40), _inside(belly, 0.004))
    ring = np.sin(2 * np.pi * p[:, 2] / 0.026 + 2 * noise(p, 0.03, 3))
    neck = _inside(0.17 - p[:, 2], 0.004) * _inside(p[:, 2] - 0.262, 0.004)
    base = _mix(base, (0.60, 0.26, 0.10), 0.75 * neck * _inside(-ring * 0.01, 0.006))
    feet = _inside(p[:, 2] - 0.016, 0.002)
    base = _mix(base, (0.62, 0.55, 0.36), feet)
    for s in (-1, 1):
        base = _eye(base, p, (0.138, s * 0.0245, 0.294), 0.0065, (0.002, s * 0.005, 0.0025))
    return base * (1 - _seam(p[:, 1]) * (p[:, 2] > 0.09))[:, None]


def _pillow(p: Array) -> Array:
    base = np.tile(np.array([0.62, 0.58, 0.50], np.float32), (len(p), 1))
    across, up = p[:, 0] + 0.006 * noise(p, 0.05, 4), p[:, 2] + 0.006 * noise(p, 0.05, 5)
    base = _mix(base, (0.10, 0.22, 0.45), 0.85 * _inside(np.abs((across / 0.052) % 1 - 0.5) - 0.16, 0.04))
    base = _mix(base, (0.62, 0.16, 0.10), 0.75 * _inside(np.abs((up / 0.046) % 1 - 0.5) - 0.10, 0.04))
    base = _mix(base, (0.75, 0.60, 0.16), 0.8 * _spots(p, 0.018, 14, 0.40))
    return base * (1 - 1.2 * _seam(p[:, 1] / 2))[:, None]


def _leaf(p: Array) -> Array:
    base = np.tile(np.array([0.22, 0.44, 0.09], np.float32), (len(p), 1))
    base = _mix(base, (0.55, 0.50, 0.10), 0.8 * _inside(0.20 - noise(p, 0.035, 6), 0.25))
    base = _mix(base, (0.50, 0.18, 0.06), 0.8 * _spots(p, 0.014, 15, 0.40))
    side = np.abs(p[:, 0])
    vein = np.abs(((p[:, 2] - 0.62 * side) / 0.034) % 1 - 0.5) * 0.034
    base = _mix(base, (0.72, 0.72, 0.36), 0.8 * np.exp(-((vein / 0.0016) ** 2)) * (p[:, 2] > 0.06))
    base = _mix(base, (0.74, 0.72, 0.40), np.exp(-((side / 0.0035) ** 2)))
    return _mix(base, (0.30, 0.18, 0.07), _inside(p[:, 2] - 0.052, 0.006))


PAINT: dict[str, Callable[[Array], Array]] = {"plush": _plush, "dinosaur": _dinosaur, "pillow": _pillow, "leaf": _leaf}
