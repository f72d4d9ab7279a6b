"""From where, and in how large a window, a cloud of points is looked at."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.checks import as_array, require

LENS_DEG = 14.0
ELEVATION_DEG = 16.0
TURN_DEG = -30.0  # from the view that shows the widest side, so that depth is seen
MARGIN, TITLE, BAR = 64, 96, 170  # pixels around the object, above it, right of it


@dataclass(frozen=True, kw_only=True)
class Viewpoint:
    """A view of known scale: `pixels` per metre at `focus`, in a window of `size` pixels."""

    focus: np.ndarray  # (3,) [m]
    toward: np.ndarray  # (3,) unit vector from the focus to the eye
    up: np.ndarray  # (3,) unit vector that stays vertical
    pixels: float  # [1/m]
    size: tuple[int, int]  # width, height [pixels]

    @property
    def distance(self) -> float:
        """How far the eye is from the focus [m]."""
        return self.size[1] / self.pixels / (2 * np.tan(np.deg2rad(LENS_DEG / 2)))

    def axes(self) -> np.ndarray:
        """Unit vectors (3, 3): rows right, up in the picture, towards the eye."""
        right = _unit(np.cross(self.up, self.toward))
        return np.stack([right, np.cross(self.toward, right), self.toward])

    def to_pixels(self, x: np.ndarray) -> np.ndarray:
        """Where points (N, 3) near the focus appear, (N, 2), counted from the lower left corner."""
        return (x - self.focus) @ self.axes()[:2].T * self.pixels + np.array(self.size) / 2

    def turned(self, angle: float, about: np.ndarray) -> "Viewpoint":
        """The view after a walk by angle [rad] round the vertical through the point `about` (3,)."""
        focus = about + _rotate(self.focus - about, self.up, angle)
        return replace(self, focus=focus, toward=_rotate(self.toward, self.up, angle))


def look_at(x: np.ndarray, *, up: Sequence[float] = (0.0, 0.0, 1.0), pad: float = 0.0,
            room: tuple[int, int] = (1040, 780), around: bool = False, like: np.ndarray | None = None) -> Viewpoint:
    """A view of x (N, 3) [m], a little from above, its widest horizontal side across the picture.

    up: the direction that stays vertical, usually against gravity. pad [m]: radius of the spheres drawn at x.
    room: most pixels for the object. around: leave room for a full turn. like (M, 3): look
    from where these points would be looked at. The window fits object, title and colour bar.
    Raises ValueError when x is not (N, 3) and finite, is empty, or up is zero.
    """
    x, up = as_array("x", x, (None, 3)), as_array("up", up, (3,))
    require(len(x) > 0, "x", "hold at least one point", x.shape)
    require(bool(np.linalg.norm(up) > 0), "up", "not be zero", up)
    up = _unit(up)
    toward = direction(x if like is None else like, up)
    right = _unit(np.cross(up, toward))
    axes = np.stack([right, np.cross(toward, right), toward])
    low, high = _extent(x, axes, up, around)
    wide, tall = np.maximum(high - low + 2 * pad, 1e-9)[:2]
    pixels = min(room[0] / wide, room[1] / tall)
    size = (_even(max(wide * pixels + 2 * MARGIN + BAR, 720)), _even(max(tall * pixels + MARGIN + TITLE, 480)))
    pixels /= 1 + pixels * (high - low)[2] * np.tan(np.deg2rad(LENS_DEG / 2)) / size[1]  # near parts look larger
    shift = np.array([BAR / 2, (TITLE - MARGIN) / 2, 0.0]) / pixels
    return Viewpoint(focus=axes.T @ ((low + high) / 2 + shift), toward=toward, up=up, pixels=float(pixels), size=size)


def direction(x: np.ndarray, up: np.ndarray) -> np.ndarray:
    """The unit vector from x (N, 3) to the eye: across its thin horizontal axis, turned, raised."""
    flat = x - x.mean(axis=0)
    flat = flat - np.outer(flat @ up, up)
    values, vectors = np.linalg.eigh(flat.T @ flat + 1e-12 * np.eye(3) + 1e6 * (flat**2).sum() * np.outer(up, up))
    round_enough = values[0] > 0.8 * values[1]
    thin = _flat_axis(up) if round_enough else vectors[:, 0]
    front = _rotate(thin * (1.0 if thin @ np.array([0.31, -0.95, 0.05]) >= 0 else -1.0), up, np.deg2rad(TURN_DEG))
    return _unit(np.cos(np.deg2rad(ELEVATION_DEG)) * front + np.sin(np.deg2rad(ELEVATION_DEG)) * up)


def _flat_axis(up: np.ndarray) -> np.ndarray:
    axis = np.array([0.0, -1.0, 0.0]) if abs(up[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    return _unit(axis - (axis @ up) * up)


def _extent(x: np.ndarray, axes: np.ndarray, up: np.ndarray, around: bool) -> tuple[np.ndarray, np.ndarray]:
    seen = x @ axes.T
    if not around:
        return seen.min(axis=0), seen.max(axis=0)
    middle = (x.min(axis=0) + x.max(axis=0)) / 2
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    seen = np.concatenate([(middle + _rotate(x - middle, up, angle)) @ axes.T for angle in angles])
    return seen.min(axis=0), seen.max(axis=0)


def _rotate(v: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues' rotation of v (..., 3) about a unit axis by angle [rad]."""
    along = (v @ axis)[..., None] * axis
    return along + np.cos(angle) * (v - along) + np.sin(angle) * np.cross(axis, v)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)


def _even(pixels: float) -> int:
    """The next multiple of 16: what video codecs want."""
    return int(-(-pixels // 16) * 16)
