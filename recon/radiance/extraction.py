"""From a trained field to points in correspondence over time (paper, "Point Cloud Extraction")."""

from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import binary_erosion, binary_fill_holes, gaussian_filter
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from recon.radiance.device import array, tensor
from recon.radiance.fields import Dynamic
from recon.radiance.marching import Occupancy
from recon.radiance.rendering import along, camera_rays
from recon.radiance.training import Trained
from recon.views import Views
from sim.checks import require

_CHUNK = 1 << 14  # rays at a time
_HALVINGS = 18  # of the interval in which the grid's spacing is sought
_REACH = 2.0  # spacings within which points hang together
_CLOSE = 0.5  # spacings: of points this near to each other one is enough
_LEAST = 500  # points that make an object


@dataclass(frozen=True, kw_only=True)
class ExtractOptions:
    """points: how many are wanted at most (paper: 9 to 15 thousand); opacity: of a sample, above which it is a point;
    whole: opacity of a ray that meets the object; steps: fixed-point steps that refine where a point goes."""

    points: int = 12_000
    opacity: float = 0.1
    whole: float = 0.9
    steps: int = 5

    def __post_init__(self) -> None:
        fits = self.points >= _LEAST and 0 < self.opacity < 1 and 0 < self.whole < 1 and self.steps >= 0
        require(fits, "extraction", f"have at least {_LEAST} points, opacities in 0 to 1, steps", self)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cloud4D:
    """points (T, N, 3) [m], each row the same piece of the object in all frames; colours (N, 3) 0 to 1; surface (N,)
    bool; normals (N, 3) outward in frame 0, zero inside; times (T,) [s]; spacing [m] between points."""

    points: np.ndarray
    colours: np.ndarray
    surface: np.ndarray
    normals: np.ndarray
    times: np.ndarray
    spacing: float


def extract(trained: Trained, views: Views, options: ExtractOptions | None = None) -> Cloud4D:
    """Points at or behind the surface that the cameras see in frame 0, thinned, cleaned, and carried to every frame.

    Raises ValueError when the field is nowhere opaque.
    """
    options = options or ExtractOptions()
    places, colours = _opaque(trained, views, options)
    require(len(places) >= _LEAST, "field", f"be opaque in at least {_LEAST} samples of the cameras' rays", len(places))
    points, colours, cube, spacing = _thinned(places, colours, options.points)
    kept = _hanging_together(points, spacing)
    surface, normals = np.zeros(len(points), bool), np.zeros_like(points)
    surface[kept], normals[kept] = _outside(points[kept], spacing)
    points = _on_the_skin(points, normals, places, cube)
    kept[kept] = _apart(points[kept], np.bincount(cube)[kept], _CLOSE * spacing)
    points, colours, surface, normals = (values[kept] for values in (points, colours, surface, normals))
    start = tensor(points.astype(np.float32))
    moved = [array(carried(trained.field, start, frame, options.steps)) for frame in range(len(views.times))]
    return Cloud4D(
        points=np.stack(moved).astype(np.float64), colours=colours, surface=surface, normals=normals,
        times=np.asarray(views.times), spacing=spacing,
    )  # fmt: skip


@torch.no_grad()
def carried(field: Dynamic, start: torch.Tensor, frame: int, steps: int = 5) -> torch.Tensor:
    """Where points (N, 3) of frame 0 are in a frame: x = y0 + b(y0), by w, then steps of `y <- x - b(y)`.

    The steps are kept where b agrees better with them than with w.
    """
    canonical = field.from_first(start)
    frames = torch.full((len(start),), frame, device=start.device)
    first = field.warped(canonical, frames)
    better = first
    for _ in range(steps):
        better = canonical - (field.bent(better, frames) - better)
    off, still = ((field.bent(y, frames) - canonical).norm(dim=1) for y in (better, first))
    return torch.where((off < still)[:, None], better, first)


@torch.no_grad()
def _opaque(trained: Trained, views: Views, options: ExtractOptions) -> tuple[np.ndarray, np.ndarray]:
    """Places (S, 3) and colours (S, 3) of samples at or behind the surface."""
    still = Occupancy(cells=trained.occupancy.cells[:1], origin=trained.occupancy.origin,
                      spacing=trained.occupancy.spacing)  # fmt: skip
    found = []
    for camera in views.cameras:
        start, direction = camera_rays(camera)
        for own, toward in zip(start.split(_CHUNK), direction.split(_CHUNK), strict=True):
            frames = torch.zeros(len(own), dtype=torch.long, device=own.device)
            seen, samples, thickness = along(trained.field, still, own, toward, frames)
            if not len(samples.depth):
                continue
            passed = torch.cumsum(seen.weight, dim=0)
            first = samples.rays[:, 0].long().clamp(max=len(passed) - 1)
            behind = passed - (passed[first] - seen.weight[first])[samples.ray] > 0.5
            solid = (1 - torch.exp(-thickness) > options.opacity) & (seen.opacity[samples.ray] > options.whole)
            found.append(samples.place[behind & solid])
    places = torch.cat(found) if found else tensor(np.zeros((0, 3), np.float32))
    colours = [trained.field.first(part)[1] for part in places.split(1 << 16)]
    return array(places.double()), array(torch.cat(colours).double()) if colours else np.zeros((0, 3))


def _thinned(places: np.ndarray, colours: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """One point, the mean, in each cube of the finest grid that leaves at most so many; and each place's cube (S,)."""
    low, high = 1e-3 * np.ptp(places, axis=0).max(), np.ptp(places, axis=0).max()
    for _ in range(_HALVINGS):
        spacing = (low + high) / 2
        low, high = (spacing, high) if len(np.unique(_numbered(places, spacing))) > most else (low, spacing)
    which = np.unique(_numbered(places, high), return_inverse=True)[1]
    count = np.bincount(which)[:, None]
    means = [np.stack([np.bincount(which, v[:, a]) for a in range(3)], axis=1) / count for v in (places, colours)]
    return means[0], means[1], which, float(high)


def _cells(places: np.ndarray, spacing: float) -> np.ndarray:
    return np.floor((places - places.min(axis=0)) / spacing).astype(np.int64)


def _numbered(places: np.ndarray, spacing: float) -> np.ndarray:
    """Each place's cube as one number, (S,): numbers sort many times faster than triples."""
    number = np.zeros(len(places), np.int64)
    for cell in _cells(places, spacing).T:
        number = number * (cell.max() + 1) + cell
    return number


def _on_the_skin(points: np.ndarray, normals: np.ndarray, places: np.ndarray, cube: np.ndarray) -> np.ndarray:
    """Points (N, 3), those with a normal (N, 3) moved outwards to a sample of their own cube (S,).

    The mean of a cube that the skin cuts lies inside the body: an object of such points would be too thin on all sides
    by half a spacing, and its skin too small for the air that blows on it.
    """
    own = np.flatnonzero(normals.any(axis=1)[cube])
    arm = places[own] - points[cube[own]]
    out = (arm * normals[cube[own]]).sum(axis=1)
    aside = np.linalg.norm(arm - out[:, None] * normals[cube[own]], axis=1)
    rising = own[np.argsort(out - aside, kind="stable")]
    points = points.copy()
    points[cube[rising]] = places[rising]  # of a cube's samples the last one stays
    return points


def _apart(points: np.ndarray, samples: np.ndarray, least: float) -> np.ndarray:
    """Which points (N,) bool to keep so that none is nearer than `least` to another: those of most samples first.

    A cube that holds a mere sliver of the body has its point next to that of the cube behind it, and two points that
    nearly touch make a stiff equation.
    """
    near, kept = cKDTree(points).query_ball_point(points, least), np.zeros(len(points), bool)
    for i in np.argsort(-samples, kind="stable"):
        kept[i] = not kept[near[i]].any()
    return kept


def _hanging_together(points: np.ndarray, spacing: float) -> np.ndarray:
    """Which points belong to the largest piece; specks that float in the field do not."""
    pairs = cKDTree(points).query_pairs(_REACH * spacing, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs), bool), pairs.T), shape=(len(points),) * 2)
    piece = connected_components(links, directed=False)[1]
    return piece == np.bincount(piece).argmax()


def _outside(points: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Which points lie next to empty space, and their outward normals: against the gradient of the smoothed filling."""
    cell = _cells(points, spacing) + 3
    filled = np.zeros(cell.max(axis=0) + 4, bool)
    filled[tuple(cell.T)] = True
    filled = binary_fill_holes(filled)
    shell = filled & ~binary_erosion(filled)
    smooth = gaussian_filter(filled.astype(float), 1.5)
    slope = np.stack([np.gradient(smooth, axis=a)[tuple(cell.T)] for a in range(3)], axis=1)
    surface = shell[tuple(cell.T)]
    size = np.linalg.norm(slope, axis=1, keepdims=True)
    return surface, np.where(surface[:, None] & (size > 0), -slope / np.maximum(size, 1e-300), 0.0)
