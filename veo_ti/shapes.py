"""Solid shapes to sample bodies from: a box and a closed triangle mesh, with the same few questions answered."""

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np

from sim._open3d import load_open3d
from sim.checks import as_array, require

LARGEST = 10.0  # [m]; anything larger is a unit mistake


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
    """An axis-aligned box from corner low (3,) to high (3,) [m]."""

    low: np.ndarray
    high: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """(3,) [m]."""
        return self.high - self.low

    @property
    def volume(self) -> float:
        """[m3]"""
        return float(np.prod(self.size))

    @property
    def area(self) -> float:
        """[m2]"""
        return float(2 * np.prod(self.size) * (1 / self.size).sum())

    def inside(self, points: np.ndarray) -> np.ndarray:
        """(P,) bool."""
        return ((points >= self.low) & (points <= self.high)).all(axis=1)

    def onto_surface(self, points: np.ndarray) -> np.ndarray:
        """The nearest surface point (P, 3) of each point."""
        clamped = np.clip(points, self.low, self.high)
        gaps = np.concatenate([clamped - self.low, self.high - clamped], axis=1)
        face, row = gaps.argmin(axis=1), np.arange(len(points))
        clamped[row, face % 3] = np.where(face < 3, self.low[face % 3], self.high[face % 3])
        return clamped

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Outward unit normals (P, 3) at surface points; on edges and corners the mean of the faces that meet."""
        sides = (points == self.high).astype(float) - (points == self.low)
        return sides / np.linalg.norm(sides, axis=1, keepdims=True)

    def creases(self, spacing: float) -> np.ndarray:
        """Points on edges and corners, about `spacing` apart, that sampling must keep to preserve the shape."""
        steps = np.maximum(1, np.rint(self.size / spacing)).astype(int)
        lines = []
        for axis in range(3):
            along = np.linspace(0, 1, steps[axis] + 1)
            for ends in product((0.0, 1.0), repeat=2):
                lines.append(np.insert(np.broadcast_to(ends, (len(along), 2)), axis, along, axis=1))
        t = np.unique(np.concatenate(lines), axis=0)
        return np.where(t == 1, self.high, self.low + t * self.size)

    def surface_cloud(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """count points (count, 3) spread evenly at random over the surface."""
        areas = np.tile(np.prod(self.size) / self.size, 2)
        face = rng.choice(6, count, p=areas / areas.sum())
        points, row = self.low + rng.random((count, 3)) * self.size, np.arange(count)
        points[row, face % 3] = np.where(face < 3, self.low[face % 3], self.high[face % 3])
        return points


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """A closed triangle mesh: vertices (V, 3) [m], triangles (F, 3), oriented outward; see `closed_mesh`."""

    vertices: np.ndarray
    triangles: np.ndarray

    @property
    def low(self) -> np.ndarray:
        """(3,) [m], the lowest corner of the bounding box."""
        return self.vertices.min(axis=0)

    @property
    def high(self) -> np.ndarray:
        """(3,) [m]"""
        return self.vertices.max(axis=0)

    @property
    def volume(self) -> float:
        """[m3], sum over triangles of a . (b x c) / 6 (divergence theorem)."""
        return _signed_volume(self.vertices, self.triangles)

    @property
    def area(self) -> float:
        """[m2]"""
        return float(np.linalg.norm(self._crossed, axis=1).sum() / 2)

    @cached_property
    def _crossed(self) -> np.ndarray:
        a, b, c = (self.vertices[self.triangles[:, i]] for i in range(3))
        return np.cross(b - a, c - a)

    @cached_property
    def _scene(self) -> object:
        o3d = load_open3d()
        scene = o3d.t.geometry.RaycastingScene()
        centred = (self.vertices - self.low).astype(np.float32)  # single precision: keep the numbers small
        scene.add_triangles(o3d.core.Tensor(centred), o3d.core.Tensor(self.triangles.astype(np.uint32)))
        return scene

    def _query(self, points: np.ndarray) -> object:
        return load_open3d().core.Tensor((points - self.low).astype(np.float32))

    def inside(self, points: np.ndarray) -> np.ndarray:
        """(P,) bool, by the parity of crossings of several rays."""
        return self._scene.compute_occupancy(self._query(points), nsamples=3).numpy() > 0.5

    def onto_surface(self, points: np.ndarray) -> np.ndarray:
        """The nearest surface point (P, 3) of each point."""
        return self._scene.compute_closest_points(self._query(points))["points"].numpy().astype(np.float64) + self.low

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Outward unit normals (P, 3) of the nearest triangles."""
        triangle = self._scene.compute_closest_points(self._query(points))["primitive_ids"].numpy()
        return self._crossed[triangle] / np.linalg.norm(self._crossed[triangle], axis=1, keepdims=True)

    def creases(self, spacing: float) -> np.ndarray:
        """None: a mesh's creases are not kept, points may lie up to half a spacing away from them."""
        return np.empty((0, 3))

    def surface_cloud(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """count points (count, 3) spread evenly at random over the surface."""
        areas = np.linalg.norm(self._crossed, axis=1)
        corners = self.vertices[self.triangles[rng.choice(len(areas), count, p=areas / areas.sum())]]
        weights = np.sort(rng.random((count, 2)), axis=1)
        weights = np.stack([weights[:, 0], weights[:, 1] - weights[:, 0], 1 - weights[:, 1]], axis=1)
        return np.einsum("pk,pkc->pc", weights, corners)


def box(size: np.ndarray, corner: np.ndarray = (0.0, 0.0, 0.0)) -> Box:
    """A box of the given size (3,) [m] whose lowest corner is `corner`; raises ValueError when it is flat."""
    size, corner = as_array("size", size, (3,)), as_array("corner", corner, (3,))
    require(bool((size > 0).all()), "size", "be positive along all three axes: a body has a volume", size.tolist())
    _in_metres(float(size.max()))
    return Box(low=corner, high=corner + size)


def closed_mesh(path: str | Path, scale: float = 1.0) -> Mesh:
    """The closed mesh in a file (STL, PLY, OBJ, OFF ...), lengths multiplied by scale to become metres.

    Raises ValueError when the file holds no triangles, the mesh has a hole, cannot be oriented, or has no volume.
    """
    path = Path(path)
    require(path.is_file(), "file", "exist", repr(str(path)))
    o3d = load_open3d()
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        raw = o3d.io.read_triangle_mesh(str(path))
    require(len(raw.triangles) > 0, "file", "hold a triangle mesh", repr(str(path)))
    raw.remove_duplicated_vertices().remove_degenerate_triangles().remove_unreferenced_vertices()
    closed = raw.is_edge_manifold(allow_boundary_edges=False)
    require(closed, "mesh", "be closed", f"holes or crossing sheets in {path.name}")
    require(raw.orient_triangles(), "mesh", "have an inside and an outside", f"a one-sided surface in {path.name}")
    vertices, triangles = as_array("vertices", np.asarray(raw.vertices) * scale, (None, 3)), np.array(raw.triangles)
    _in_metres(float(np.ptp(vertices, axis=0).max()))
    volume = _signed_volume(vertices, triangles)
    require(abs(volume) > 0, "mesh", "enclose a volume", volume)
    mesh = Mesh(vertices=vertices, triangles=triangles if volume > 0 else triangles[:, ::-1])
    filled = _filled_volume(mesh)
    agree = abs(filled / mesh.volume - 1) < 0.1
    require(
        agree, "mesh", "enclose one volume without overlaps", f"{filled:.3g} m3 by rays, {mesh.volume:.3g} m3 by facets"
    )
    return mesh


def _filled_volume(mesh: Mesh) -> float:
    size = mesh.high - mesh.low
    probes = mesh.low + np.random.default_rng(0).random((100_000, 3)) * size
    return float(np.prod(size) * mesh.inside(probes).mean())


def _signed_volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (vertices[triangles[:, i]] - vertices.mean(axis=0) for i in range(3))
    return float(np.einsum("fc,fc->", a, np.cross(b, c)) / 6)


def _in_metres(size: float) -> None:
    rule = f"be in metres and span less than {LARGEST:g} m"
    require(size <= LARGEST, "lengths", rule, f"a body {size:.3g} m across, which looks like millimetres")
