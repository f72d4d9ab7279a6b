"""Bodies made of points from a box or a closed mesh, and markers that ride on them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from sim.checks import as_array, require, some
from veo_ti.shapes import Box, Mesh, box, closed_mesh

SWEEPS = 20  # of the relaxation; the spread of nearest distances no longer changes after about 15
CLOUD = 40  # probes per point while relaxing
PROBES = 200  # probes per point for volumes: a few per cent of noise on each
FEWEST = 32


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """Evenly but irregularly spread points of a solid; surface points lie exactly on its surface."""

    x: np.ndarray  # (N, 3) [m]
    volume: np.ndarray  # (N,) [m3], the part of the solid nearest to each point
    surface: np.ndarray  # (N,) bool
    normals: np.ndarray  # (N, 3), outward unit vectors on the surface, zero inside
    spacing: float  # [m], mean distance to the nearest other point


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkerTies:
    """Markers that ride on a body: position = weights @ y."""

    weights: csr_matrix  # (M, N), rows sum to 1
    offset: np.ndarray  # (M,) [m], distance from the nearest body point
    amplification: np.ndarray  # (M,), Euclidean norm of each row: how independent noise of y reaches the marker

    def positions(self, y: np.ndarray) -> np.ndarray:
        """Marker positions (M, 3) or (T, M, 3) [m] for body points y (N, 3) or (T, N, 3) [m]."""
        return np.stack([self.weights @ frame for frame in y]) if y.ndim == 3 else self.weights @ y


def sample_box(size: np.ndarray, count: int, *, corner: np.ndarray = (0.0, 0.0, 0.0), seed: int = 0) -> Body:
    """Fill a box of size (3,) [m] and lowest corner `corner` with `count` points, corners and edges included.

    Raises ValueError for a flat box or a count too small for two layers across the thinnest side.
    """
    return _sample(box(size, corner), count, seed)


def sample_mesh(path: str | Path, count: int, *, scale: float = 1.0, seed: int = 0) -> Body:
    """Fill the closed mesh in a file with `count` points; scale turns the file's lengths into metres.

    Raises ValueError for a mesh that is not closed or a count too small for its thickness.
    """
    return _sample(closed_mesh(path, scale), count, seed)


def _sample(shape: Box | Mesh, count: int, seed: int) -> Body:
    require(count >= FEWEST, "count", f"be at least {FEWEST}", count)
    rng = np.random.default_rng(seed)
    spacing, on_surface = _spacing(shape, count)
    creases = shape.creases(0.8 * spacing)  # closer than the rest, so that no free point slips in between
    enough = f"be larger for a shape this thin, about {round(sum(_split(shape, shape.volume / shape.area)))}"
    require(len(creases) < on_surface < count, "count", enough, count)
    cloud = shape.surface_cloud(CLOUD * on_surface, rng)
    away = cloud[_distance(cloud, creases) > 0.5 * spacing]
    free = rng.choice(away, on_surface - len(creases), replace=False)
    shell = np.concatenate([creases, _relaxed(free, creases, cloud, shape.onto_surface)])
    cloud = _filling(shape, CLOUD * count, rng)
    away = cloud[_distance(cloud, shell) > 0.5 * spacing]
    require(len(away) >= count - on_surface, "count", enough, count)
    free = rng.choice(away, count - on_surface, replace=False)
    x = np.concatenate([shell, _relaxed(free, shell, cloud, lambda points: _kept_inside(shape, points, away))])
    return _body(shape, x, on_surface, rng)


def _body(shape: Box | Mesh, x: np.ndarray, on_surface: int, rng: np.random.Generator) -> Body:
    tree = cKDTree(x)
    _, owner = tree.query(_filling(shape, PROBES * len(x), rng), workers=-1)
    share = np.maximum(np.bincount(owner, minlength=len(x)), 1)
    normals = np.zeros_like(x)
    normals[:on_surface] = shape.normals(x[:on_surface])
    return Body(
        x=x,
        volume=share * (shape.volume / share.sum()),
        surface=np.arange(len(x)) < on_surface,
        normals=normals,
        spacing=float(tree.query(x, k=2)[0][:, 1].mean()),
    )


def _spacing(shape: Box | Mesh, count: int) -> tuple[float, int]:
    """Spacing h [m] and number of surface points that make `count` points in all, by bisection on h."""
    low, high = 1e-3 * shape.volume ** (1 / 3) / count, 4 * shape.volume ** (1 / 3)
    for _ in range(80):
        middle = (low * high) ** 0.5
        low, high = (middle, high) if sum(_split(shape, middle)) > count else (low, middle)
    return high, round(_split(shape, high)[0])


def _split(shape: Box | Mesh, h: float) -> tuple[float, float]:
    """Points on the surface and inside at spacing h [m], by the densities of a relaxed packing.

    One point per 0.87 h^2 on the surface, one per 0.72 h^3 inside, where the surface points own a layer 0.4 h thick.
    """
    return shape.area / (0.87 * h**2), max(0.0, shape.volume - 0.4 * h * shape.area) / (0.72 * h**3)


def _filling(shape: Box | Mesh, count: int, rng: np.random.Generator) -> np.ndarray:
    """About `count` probes inside the shape, one at random in each cell of a lattice: even, yet without its order."""
    low, size = shape.low, shape.high - shape.low
    edge = (shape.volume / count) ** (1 / 3)
    cells = np.maximum(1, np.ceil(size / edge)).astype(int)
    lattice = np.stack(np.meshgrid(*(np.arange(n) for n in cells), indexing="ij"), axis=-1).reshape(-1, 3)
    probes = low + (lattice + rng.random(lattice.shape)) * size / cells
    return probes[shape.inside(probes)]


def _relaxed(free: np.ndarray, pinned: np.ndarray, cloud: np.ndarray, project: Callable) -> np.ndarray:
    """Lloyd's relaxation: each free point moves to the mean of the cloud's part nearest to it, projected back."""
    for _ in range(SWEEPS):
        _, owner = cKDTree(np.concatenate([free, pinned])).query(cloud, workers=-1)
        count = np.bincount(owner, minlength=len(free))[: len(free)]
        total = np.stack([np.bincount(owner, column, minlength=len(free))[: len(free)] for column in cloud.T], axis=1)
        free = project(np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], free))
    return free


def _distance(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    return cKDTree(others).query(points, workers=-1)[0] if len(others) else np.full(len(points), np.inf)


def _kept_inside(shape: Box | Mesh, points: np.ndarray, interior: np.ndarray) -> np.ndarray:
    """The points, those that left a hollow shape put back to the nearest of the interior ones."""
    out = np.flatnonzero(~shape.inside(points))
    points[out] = interior[cKDTree(interior).query(points[out])[1]]
    return points


def tie_markers(x: np.ndarray, markers: np.ndarray, *, neighbours: int = 24) -> MarkerTies:
    """Tie markers, on the body or at an offset from it, to nearby points so that they move with the body.

    Each row w of the weights solves min sum_i w_i^2 / phi_i with sum_i w_i = 1 and sum_i w_i x_i = marker: exact for
    every affine motion y = A x + b, so that an offset turns and stretches with the body's surface. The weights phi
    fall off around the body point nearest to the marker; the patch holds `neighbours` points and reaches at least 1.5
    offsets far, which bounds the amplification of noise.
    x: (N, 3) [m]; markers: (M, 3) [m]. Raises ValueError for a flat patch or a marker a body length away.
    """
    x, markers = as_array("x", x, (None, 3)), as_array("markers", markers, (None, 3))
    require(4 <= neighbours <= len(x), "neighbours", f"be between 4 and the {len(x)} points", neighbours)
    tree = cKDTree(x)
    offset, foot = tree.query(markers)
    size = float(np.ptp(x, axis=0).max())
    far = np.flatnonzero(offset > size)
    rule = f"lie within one body length, {size:.3g} m, of the body: same frame, same unit"
    require(len(far) == 0, "markers", rule, f"markers {some(far)} further away")
    weights = csr_matrix((len(markers), len(x))).tolil()
    for m, marker in enumerate(markers):
        radius = max(tree.query(x[foot[m]], k=neighbours)[0][-1], 1.5 * offset[m])
        patch = np.array(tree.query_ball_point(x[foot[m]], radius * (1 + 1e-9)))
        weights[m, patch] = _affine_weights(m, x[patch], marker, x[foot[m]], radius)
    weights = weights.tocsr()
    amplification = np.sqrt(np.asarray(weights.multiply(weights).sum(axis=1)).ravel())
    return MarkerTies(weights=weights, offset=offset, amplification=amplification)


def _affine_weights(m: int, patch: np.ndarray, marker: np.ndarray, foot: np.ndarray, radius: float) -> np.ndarray:
    """w = Phi P (P^T Phi P)^-1 p with rows P_i = (1, (x_i - foot) / r) and p = (1, (marker - foot) / r)."""
    phi = np.exp(-((1.5 * np.linalg.norm(patch - foot, axis=1) / radius) ** 2))
    basis = np.concatenate([np.ones((len(patch), 1)), (patch - foot) / radius], axis=1)
    thin = np.linalg.svd(np.sqrt(phi)[:, None] * (basis[:, 1:] - np.average(basis[:, 1:], axis=0, weights=phi)))[1][-1]
    require(thin > 1e-6, "x", f"surround marker {m} in all three directions", "points in one plane or line")
    target = np.concatenate([[1.0], (marker - foot) / radius])
    return phi * (basis @ np.linalg.solve(basis.T @ (phi[:, None] * basis), target))
