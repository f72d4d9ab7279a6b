"""Shapes that can touch an object, as signed distances in their own coordinates (paper "Novel Interactions")."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from sim._open3d import load_open3d
from sim.checks import as_array, require
from sim.terms.triangles import Triangles, distance_hessian, foot


@dataclass(frozen=True, kw_only=True, eq=False)
class Distance:
    """Signed distance d of P points, negative inside, its gradient, and the Hessian of d^2 / 2 inside in two parts."""

    d: np.ndarray  # (P,) [m]
    normal: np.ndarray  # (P, 3) unit
    stiffness: np.ndarray  # (P, 3, 3) positive semi-definite part, n n^T for a smooth convex shape
    bend: np.ndarray  # (P, 3, 3) the rest, d times the Hessian of d: negative semi-definite inside a convex shape

    @classmethod
    def flat(cls, d: np.ndarray, normal: np.ndarray) -> "Distance":
        """The distance to the nearest of some planes."""
        return cls(d=d, normal=normal, stiffness=_outer(normal), bend=np.zeros((*normal.shape, 3)))

    @classmethod
    def round(cls, arm: np.ndarray, radius: float, line: np.ndarray) -> "Distance":
        """|arm| - radius for arms (P, 3) from a fixed point (line zero) or from a line of unit direction (P, 3)."""
        length = np.linalg.norm(arm, axis=1)
        n = _direction(arm, length)
        across = np.eye(3) - _outer(n) - _outer(line)
        bend = (1 - radius / np.maximum(length, 1e-9 * radius))[:, None, None] * across
        return cls(d=length - radius, normal=n, stiffness=_outer(n), bend=bend)


class Shape(Protocol):
    """Anything that knows how far inside it a point is."""

    def distance(self, p: np.ndarray) -> Distance:
        """The signed distance at points p (P, 3) [m] in the shape's coordinates."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Plane:
    """The half-space below the plane through the origin with the given normal (3,)."""

    normal: np.ndarray

    def __post_init__(self) -> None:
        normal = as_array("normal", self.normal, (3,))
        length = float(np.linalg.norm(normal))
        require(length > 0, "normal", "not be zero", self.normal)
        object.__setattr__(self, "normal", normal / length)

    def distance(self, p: np.ndarray) -> Distance:
        """n . p."""
        return Distance.flat(p @ self.normal, np.broadcast_to(self.normal, p.shape))


@dataclass(frozen=True, kw_only=True, eq=False)
class Capsule:
    """All points within `radius` [m] of the segment from -axis to +axis, axis (3,) [m]."""

    radius: float
    axis: np.ndarray

    def __post_init__(self) -> None:
        require(self.radius > 0, "radius", "be positive", self.radius)
        object.__setattr__(self, "axis", as_array("axis", self.axis, (3,)))

    def distance(self, p: np.ndarray) -> Distance:
        """The distance to the closest point of the segment, less the radius."""
        length = float(np.linalg.norm(self.axis))
        direction = self.axis / length if length > 0 else self.axis
        s = np.clip(p @ direction, -length, length)
        line = np.where((np.abs(s) < length)[:, None], direction, 0.0)
        return Distance.round(p - s[:, None] * direction, self.radius, line)


@dataclass(frozen=True, kw_only=True, eq=False)
class Sphere:
    """The ball of the given radius [m]."""

    radius: float

    def __post_init__(self) -> None:
        require(self.radius > 0, "radius", "be positive", self.radius)

    def distance(self, p: np.ndarray) -> Distance:
        """|p| - radius."""
        return Distance.round(p, self.radius, np.zeros_like(p))


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
    """The box from -half to +half, half (3,) [m]."""

    half: np.ndarray

    def __post_init__(self) -> None:
        half = as_array("half", self.half, (3,))
        require(bool((half > 0).all()), "half", "be positive", self.half)
        object.__setattr__(self, "half", half)

    def distance(self, p: np.ndarray) -> Distance:
        """Inside, the distance to the nearest face; outside, to the nearest point."""
        beyond = np.abs(p) - self.half
        out = np.maximum(beyond, 0.0)
        away, depth = np.linalg.norm(out, axis=1), beyond.max(axis=1)
        nearest = np.eye(3)[beyond.argmax(axis=1)]
        normal = np.where((depth > 0)[:, None], _direction(out, away), nearest) * np.where(p < 0, -1.0, 1.0)
        return Distance.flat(np.where(depth > 0, away, depth), normal)


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """A closed triangle mesh: vertices (V, 3) [m], faces (M, 3); raises ValueError for one that is open.

    Open3D finds the closest triangle in 32 bits; the distance to it and the side are then taken in 64. Only the choice
    between triangles equally near, to 1e-7 of the mesh's size, is rounded: any contact stiffness may be used.
    """

    vertices: np.ndarray
    faces: np.ndarray

    def __post_init__(self) -> None:
        vertices = as_array("vertices", self.vertices, (None, 3))
        faces = as_array("faces", self.faces, (None, 3), np.int64)
        low, high = (faces.min(initial=0), faces.max(initial=-1))
        require(low >= 0 and high < len(vertices), "faces", f"lie between 0 and {len(vertices) - 1}", (low, high))
        enclosed = np.linalg.det(vertices[faces] - vertices.mean(axis=0)).sum()
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces if enclosed > 0 else faces[:, ::-1])
        _ = self._triangles  # raises for an open surface

    def distance(self, p: np.ndarray) -> Distance:
        """Distance to the closest point of the surface, negative inside."""
        face = self._nearest(p)
        at = foot(p, face, self.vertices, self._triangles)
        away = np.linalg.norm(at.offset, axis=1)
        sign = np.where(at.inside, -1.0, 1.0)
        normal = np.where((away > 0)[:, None], sign[:, None] * _direction(at.offset, away), _unit_rows(at.side))
        stiffness = distance_hessian(at.shares, at.offset, self.vertices[self.faces[face]])[:, 0, 0]
        return Distance(d=sign * away, normal=normal, stiffness=stiffness, bend=np.zeros_like(stiffness))

    def _nearest(self, p: np.ndarray) -> np.ndarray:
        tensor = load_open3d().core.Tensor
        found = self._scene.compute_closest_points(tensor((p - self._centre).astype(np.float32)))
        return found["primitive_ids"].numpy().astype(np.int64)

    @cached_property
    def _triangles(self) -> Triangles:
        return Triangles.of(self.faces)

    @cached_property
    def _centre(self) -> np.ndarray:
        return self.vertices.mean(axis=0)

    @cached_property
    def _scene(self) -> Any:
        open3d = load_open3d()
        scene, tensor = open3d.t.geometry.RaycastingScene(nthreads=1), open3d.core.Tensor
        corners = (self.vertices - self._centre).astype(np.float32)
        scene.add_triangles(tensor(corners), tensor(self.faces.astype(np.uint32)))
        return scene


def _direction(arm: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Unit vectors; the z axis where the length is zero, any direction being right there."""
    safe = np.where(length > 0, length, 1.0)[:, None]
    return np.where((length > 0)[:, None], arm / safe, np.array([0.0, 0.0, 1.0]))


def _outer(v: np.ndarray) -> np.ndarray:
    return v[:, :, None] * v[:, None]


def _unit_rows(v: np.ndarray) -> np.ndarray:
    return _direction(v, np.linalg.norm(v, axis=1))
