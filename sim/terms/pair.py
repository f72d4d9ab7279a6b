"""Contact between two objects that both give way (paper "Novel Interactions": several objects that interact)."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from sim.checks import as_array, require
from sim.cloud import RestCloud
from sim.hull import Hull
from sim.terms.base import PointBlocks
from sim.terms.triangles import Triangles, closest_shares, distance_hessian, foot

_CANDIDATES = 12  # triangles around a point among which the closest is sought


@dataclass(frozen=True, kw_only=True, eq=False)
class CoupledBlocks(PointBlocks):
    """A Hessian that couples a few points at a time; `blocks` holds the part of it that couples none."""

    frame: np.ndarray  # (H,)
    points: np.ndarray  # (H, S) the points that couple
    coupling: np.ndarray  # (H, S, S, 3, 3) [N/m]

    def product(self, p: np.ndarray) -> np.ndarray:
        """H p, (T, N, 3)."""
        push = np.einsum("habij,hbj->hai", self.coupling, p[self.frame[:, None], self.points])
        return _scattered(p.shape, self.frame, self.points, push)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Hits:
    """The points that are inside the other body, over all frames."""

    frame: np.ndarray  # (H,)
    points: np.ndarray  # (H, 4) the point and the corners of its closest triangle
    shares: np.ndarray  # (H, 4) 1 and minus the barycentric shares: their sum is zero
    offset: np.ndarray  # (H, 3) [m] from the closest point of the triangle
    strength: np.ndarray  # (H,) 2 V alpha [N/m]


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceContact:
    """`E = sum_i V_i alpha g_i^2`, g_i the depth of point i of one body inside the deformed surface of another.

    g is the distance to the closest triangle of that surface. A push on a point goes back to the triangle's corners by
    their barycentric shares, along the same line: both momenta are conserved. A body thinner than g is passed through.
    """

    probes: np.ndarray  # (P,) points that may not enter
    volume: np.ndarray  # (P,) [m3] their volumes
    mesh: Triangles  # the other body's surface
    alpha: float  # [Pa/m2]

    @classmethod
    def between(cls, cloud: RestCloud, a: slice, b: slice, alpha: float) -> "tuple[SurfaceContact, SurfaceContact]":
        """Both directions of contact between the parts a and b of a joined cloud, as two terms."""
        require(alpha > 0, "alpha", "be positive", alpha)
        return cls._one_way(cloud, a, b, alpha), cls._one_way(cloud, b, a, alpha)

    @classmethod
    def _one_way(cls, cloud: RestCloud, a: slice, b: slice, alpha: float) -> "SurfaceContact":
        probes = np.arange(cloud.count)[a][cloud.surface[a]]
        faces = Hull.of(cloud.x[b], cloud.reach[b]).faces + b.start
        return cls(probes=probes, volume=cloud.volume[probes], mesh=Triangles.of(faces), alpha=alpha)

    def __post_init__(self) -> None:
        probes = as_array("probes", self.probes, (None,), np.int64)
        require(len(probes) > 0, "probes", "name at least one surface point", "none")
        object.__setattr__(self, "probes", probes)

    def value(self, y: np.ndarray) -> np.ndarray:
        """sum V alpha g^2, (T,) [J]."""
        hits = self._hits(y)
        return np.bincount(hits.frame, hits.strength / 2 * (hits.offset**2).sum(axis=1), minlength=len(y))

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """2 V alpha offset on the point and its negative shared out on the triangle, (T, N, 3) [N]."""
        hits = self._hits(y)
        push = hits.strength[:, None] * hits.offset
        return _scattered(y.shape, hits.frame, hits.points, hits.shares[..., None] * push[:, None])

    def tangent(self, y: np.ndarray, project: np.ndarray | None = None) -> CoupledBlocks:
        """The Hessian, exact or, in the frames where `project` (T,) is set, without the turning of the triangles."""
        hits = self._hits(y)
        coupling = distance_hessian(-hits.shares[:, 1:], hits.offset, y[hits.frame[:, None], hits.points[:, 1:]])
        if project is not None:
            some = project[hits.frame]
            outer = hits.shares[some, :, None] * hits.shares[some, None]
            coupling[some] = outer[..., None, None] * coupling[some, :1, :1]
        coupling *= hits.strength[:, None, None, None, None]
        blocks = _scattered((*y.shape, 3), hits.frame, hits.points, np.einsum("haaij->haij", coupling))
        return CoupledBlocks(blocks=blocks, frame=hits.frame, points=hits.points, coupling=coupling)

    def frames(self, index: np.ndarray) -> "SurfaceContact":
        """Itself: nothing here depends on the frame."""
        return self

    def depth(self, y: np.ndarray) -> np.ndarray:
        """The largest depth of each frame, (T,) [m]."""
        hits, out = self._hits(y), np.zeros(len(y))
        np.maximum.at(out, hits.frame, np.linalg.norm(hits.offset, axis=1))
        return out

    def _hits(self, y: np.ndarray) -> _Hits:
        found = [self._frame_hits(v) for v in y]
        points, shares, offset = (np.concatenate(part) for part in zip(*found, strict=True))
        frame = np.repeat(np.arange(len(y)), [len(part[0]) for part in found])
        strength = 2 * self.alpha * self.volume[np.searchsorted(self.probes, points[:, 0])]
        return _Hits(frame=frame, points=points, shares=shares, offset=offset, strength=strength)

    def _frame_hits(self, v: np.ndarray) -> tuple[np.ndarray, ...]:
        """Points, shares and offset of the probes inside the surface of one pose v (N, 3)."""
        faces = self.mesh.faces
        near = self.probes[_inside_bounds(v[self.probes], v[faces.ravel()])]
        face = _closest_faces(v[near], v[faces])
        at = foot(v[near], face, v, self.mesh)
        points = np.column_stack([near, faces[face]])
        shares = np.column_stack([np.ones(len(near)), -at.shares])
        return points[at.inside], shares[at.inside], at.offset[at.inside]


def _inside_bounds(p: np.ndarray, v: np.ndarray) -> np.ndarray:
    return ((p > v.min(axis=0)) & (p < v.max(axis=0))).all(axis=1)


def _closest_faces(p: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """The closest triangle (P,) to each point, of those whose centroids are nearest."""
    k = min(_CANDIDATES, len(corners))
    candidates = cKDTree(corners.mean(axis=1)).query(p, k)[1].reshape(len(p), k)
    triangles, q = corners[candidates].reshape(-1, 3, 3), np.repeat(p, k, axis=0)
    closest = np.einsum("pk,pkc->pc", closest_shares(q, triangles), triangles)
    away = ((q - closest) ** 2).sum(axis=1).reshape(len(p), k)
    return candidates[np.arange(len(p)), away.argmin(axis=1)]


def _scattered(shape: tuple[int, ...], frame: np.ndarray, points: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sums of values (H, S, ...) at (frame, points) in an array of the given shape, in a fixed order."""
    out = np.zeros(shape)
    np.add.at(out, (np.repeat(frame, points.shape[1]), points.ravel()), values.reshape(-1, *shape[2:]))
    return out
