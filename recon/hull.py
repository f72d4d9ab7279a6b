"""The visual hull: the part of space that the mattes of all cameras allow."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.ndimage import binary_fill_holes, label

from recon.cameras import Camera
from sim.checks import as_array, require

SHRINKS = 4  # times that the box is drawn closer round what is left
COARSE = 32  # cells along the box while it is drawn closer
FEWEST = 3  # cameras that must allow a voxel, and that no miss is granted against


@dataclass(frozen=True, kw_only=True)
class HullOptions:
    """cells: cubes along the longest side; grow [px]: how far outlines may be off, rounding included.

    misses: cameras that may disagree.
    """

    cells: int = 64
    grow: float = 2.0
    misses: int = 1

    def __post_init__(self) -> None:
        fits = self.cells >= 2 and self.grow >= 0 and self.misses >= 0
        require(fits, "cells, grow and misses", "be at least 2, 0 and 0", (self.cells, self.grow, self.misses))


@dataclass(frozen=True, kw_only=True, eq=False)
class Hull:
    """Cubes of space: occupied (X, Y, Z) bool; origin (3,) [m], the first one's lowest corner; spacing [m], a side."""

    occupied: np.ndarray
    origin: np.ndarray
    spacing: float

    @property
    def points(self) -> np.ndarray:
        """Centres of the occupied cubes, (N, 3) [m]."""
        return self.origin + self.spacing * (np.argwhere(self.occupied) + 0.5)

    @property
    def surface(self) -> np.ndarray:
        """Centres of the occupied cubes with an empty neighbour, (N, 3) [m]."""
        whole = np.pad(self.occupied, 1)
        inner = np.ones_like(self.occupied)
        for axis in range(3):
            for step in (-1, 1):
                inner &= np.roll(whole, step, axis)[1:-1, 1:-1, 1:-1]
        return self.origin + self.spacing * (np.argwhere(self.occupied & ~inner) + 0.5)

    @property
    def volume(self) -> float:
        """[m3]."""
        return float(self.occupied.sum()) * self.spacing**3

    def without_specks(self, share: float = 0.1) -> "Hull":
        """The parts that have at least this share of the largest one's cubes: mattes may agree by chance elsewhere."""
        parts, _ = label(self.occupied, np.ones((3, 3, 3)))
        count = np.bincount(parts.ravel())
        count[0] = 0
        return replace(self, occupied=(count >= max(1.0, share * count.max()))[parts])

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Which points (..., 3) [m] lie in an occupied cube, (...) bool."""
        cell = np.floor((np.asarray(points, float) - self.origin) / self.spacing)
        within = ((cell >= 0) & (cell < self.occupied.shape)).all(axis=-1)
        i, j, k = np.moveaxis(np.where(within[..., None], cell, 0).astype(int), -1, 0)
        return within & self.occupied[i, j, k]


def visual_hull(
    cameras: Sequence[Camera],
    mattes: Sequence[np.ndarray],
    options: HullOptions | None = None,
    bounds: np.ndarray | None = None,
    *,
    unclear: Sequence[np.ndarray | None] | None = None,
) -> Hull:
    """Carve a grid by mattes (height, width), nonzero on the object, as large as their cameras' pictures.

    Holes in a matte are filled and it grows by `grow` pixels and by half a cube's diagonal, so that no cube that the
    object touches is lost; a cube stays when at most `misses` of the cameras that see it disagree (none with three
    cameras or fewer). A camera whose matte the picture's edge does not cut says that nothing is beside its picture.
    bounds (2, 3) [m]: the box to carve in; found from the mattes when not given. unclear: for each camera None or
    its pixels (height, width) that say nothing, such as those where something may stand before the object.
    Raises ValueError for mattes that do not fit, fewer than two that show something, or that have nothing in common.
    """
    options = options or HullOptions()
    require(len(cameras) == len(mattes) >= 2, "mattes", "belong to at least two cameras, one each", len(mattes))
    unclear = unclear or [None] * len(cameras)
    for camera, matte, mask in zip(cameras, mattes, unclear, strict=True):
        wanted = f"be {camera.size[0]} x {camera.size[1]} pixels"
        for what, picture in (("matte", matte), ("unclear", matte if mask is None else mask)):
            require(np.shape(picture) == camera.size[::-1], f"{camera.name} {what}", wanted, np.shape(picture)[::-1])
    showing = sum(bool(np.any(matte)) for matte in mattes)
    misses = min(options.misses, max(0, len(cameras) - FEWEST))
    require(
        showing >= max(2, len(cameras) - misses), "mattes", "show the object", f"{showing} of {len(mattes)} that do"
    )
    away = [_Away.of(matte, mask) for matte, mask in zip(mattes, unclear, strict=True)]
    if bounds is None:
        box = _first_box(cameras, mattes)
        for _ in range(SHRINKS):
            before, box = box, _closer(_carved(cameras, away, box, COARSE, options.grow, misses), box)
            if np.ptp(box, axis=0).max() > 0.9 * np.ptp(before, axis=0).max():
                break
    else:
        box = as_array("bounds", bounds, (2, 3))
        require(bool((box[0] < box[1]).all()), "bounds", "rise from the first row to the second", box.tolist())
    return _carved(cameras, away, box, options.cells, options.grow, misses)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Away:
    """distance (height, width) [px] from the matte without its holes, NaN where the camera says nothing.

    whole: the picture's edge does not cut the matte, nor hides what the camera does not tell that it does.
    """

    distance: np.ndarray
    whole: bool

    @classmethod
    def of(cls, matte: np.ndarray, unclear: np.ndarray | None) -> "_Away":
        filled = binary_fill_holes(np.asarray(matte) > 0)
        distance = cv2.distanceTransform((~filled).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        hidden = np.zeros_like(filled) if unclear is None else np.asarray(unclear) > 0
        parts, _ = label(filled | hidden)
        edge = np.concatenate([parts[0], parts[-1], parts[:, 0], parts[:, -1]])
        cut = np.isin(edge[edge > 0], parts[filled]).any()
        return cls(distance=np.where(hidden, np.nan, distance), whole=bool(filled.any() and not cut))


def _carved(
    cameras: Sequence[Camera], away: Sequence[_Away], box: np.ndarray, cells: int, grow: float, misses: int
) -> Hull:
    """The grid over the box after every camera had its say; cubes that are out are not projected again."""
    spacing = float((box[1] - box[0]).max() / cells)
    shape = np.maximum(1, np.ceil((box[1] - box[0]) / spacing - 1e-9)).astype(int)
    index = np.indices(shape).reshape(3, -1).T
    centres = box[0] + spacing * (index + 0.5)
    against, favour = np.zeros(len(index), int), np.zeros(len(index), int)
    alive = np.arange(len(index))
    for camera, matte in zip(cameras, away, strict=True):
        seen, inside = _vote(camera, matte, centres[alive], grow, spacing)
        against[alive] += seen & ~inside
        favour[alive] += inside
        alive = alive[against[alive] <= misses]
    alive = alive[favour[alive] >= min(FEWEST, len(cameras) - misses)]
    occupied = np.zeros(len(index), bool)
    occupied[alive] = True
    require(len(alive) > 0, "mattes", "have a part of space in common", "none")
    return Hull(occupied=occupied.reshape(shape), origin=box[0].copy(), spacing=spacing)


def _vote(
    camera: Camera, matte: _Away, centres: np.ndarray, grow: float, spacing: float
) -> tuple[np.ndarray, np.ndarray]:
    """Whether the camera says something of each cube, and whether its matte is near enough to touch the cube."""
    pixels, depth = camera.project(centres)
    place = np.round(np.clip(np.where(np.isfinite(pixels), pixels, -1), -1, max(camera.size))).astype(int)
    shown = (place >= 0).all(axis=1) & (place < camera.size).all(axis=1)
    distance = np.full(len(centres), np.inf if matte.whole else np.nan)
    distance[shown] = matte.distance[place[shown, 1], place[shown, 0]]
    reach = grow + spacing * np.sqrt(3) / 2 * max(camera.K[0, 0], camera.K[1, 1]) / np.where(shown, depth, 1.0)
    return ~np.isnan(distance), distance <= reach


def _first_box(cameras: Sequence[Camera], mattes: Sequence[np.ndarray]) -> np.ndarray:
    """A cube about the point nearest to the rays through all mattes' middles, as large as the largest matte there."""
    spans = [(c, np.argwhere(np.asarray(m) > 0)[:, ::-1]) for c, m in zip(cameras, mattes, strict=True) if np.any(m)]
    rays = np.stack([camera.rays((p.min(axis=0) + p.max(axis=0)) / 2) for camera, p in spans])
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    centres = np.stack([camera.centre for camera, _ in spans])
    middle = np.linalg.lstsq(across.sum(axis=0), np.einsum("nij,nj->i", across, centres), rcond=None)[0]
    halves = [
        np.linalg.norm(np.ptp(p, axis=0) + 2) / 2 * np.linalg.norm(middle - camera.centre) / camera.K[0, 0]
        for camera, p in spans
    ]
    half = 1.5 * max(halves)
    return np.stack([middle - half, middle + half])


def _closer(hull: Hull, box: np.ndarray) -> np.ndarray:
    """The box of what is left, one cube wider on each side, inside the box before."""
    points = hull.points
    margin = 1.5 * hull.spacing
    return np.stack([np.maximum(points.min(axis=0) - margin, box[0]), np.minimum(points.max(axis=0) + margin, box[1])])
