"""Distance to a triangulated surface in 64 bits: closest points, the side, the Hessian of the squared distance."""

from dataclasses import dataclass

import numpy as np

from sim.checks import require

_NEXT = np.array([1, 2, 0])
_BEFORE = np.array([2, 0, 1])


@dataclass(frozen=True, kw_only=True, eq=False)
class Triangles:
    """Corner numbers of outward faces, and the face beyond each edge."""

    faces: np.ndarray  # (M, 3)
    beyond: np.ndarray  # (M, 3) the face across the edge that lies opposite to each corner

    @classmethod
    def of(cls, faces: np.ndarray) -> "Triangles":
        """Raises ValueError unless every edge is used once in each direction as often: unless the surface is closed."""
        faces = np.asarray(faces, np.int64)
        start, end = faces[:, _NEXT].ravel(), faces[:, _BEFORE].ravel()
        size = faces.max(initial=0) + 1
        there, back = np.argsort(start * size + end, kind="stable"), np.argsort(end * size + start, kind="stable")
        open_edges = (start[there] != end[back]) | (end[there] != start[back])
        rule = "close up, every edge shared by two faces that wind alike"
        require(len(faces) > 0 and not open_edges.any(), "faces", rule, f"{len(faces)} faces")
        beyond = np.empty(len(start), np.int64)
        beyond[there] = back // 3
        return cls(faces=faces, beyond=beyond.reshape(-1, 3))


@dataclass(frozen=True, kw_only=True, eq=False)
class Foot:
    """Where points stand on given triangles."""

    shares: np.ndarray  # (P, 3) barycentric, exact zeros away from the corner or edge the point stands on
    offset: np.ndarray  # (P, 3) [m] from the closest point to the point
    side: np.ndarray  # (P, 3) pseudonormal there: the point is inside where offset . side < 0

    @property
    def inside(self) -> np.ndarray:
        """Which points lie behind the surface, (P,) bool."""
        return (self.offset * self.side).sum(axis=1) < 0


def foot(p: np.ndarray, face: np.ndarray, v: np.ndarray, mesh: Triangles) -> Foot:
    """Closest point to p (P, 3) on the triangle `face` (P,) of a surface with vertices v (V, 3) [m].

    The side is told by the angle-weighted pseudonormal (Baerentzen and Aanaes 2005), exact on a closed surface.
    """
    shares = closest_shares(p, v[mesh.faces[face]])
    offset = p - np.einsum("pk,pkc->pc", shares, v[mesh.faces[face]])
    return Foot(shares=shares, offset=offset, side=_pseudonormal(shares, face, v, mesh))


def closest_shares(p: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Barycentric shares (P, 3) of the point of a triangle (P, 3, 3) closest to p (P, 3)."""
    best, distance = np.zeros((len(p), 3)), np.full(len(p), np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        edge, arm = corners[:, b] - corners[:, a], p - corners[:, a]
        length = (edge**2).sum(axis=1)
        s = np.clip((arm * edge).sum(axis=1) / np.where(length > 0, length, 1.0), 0.0, 1.0)
        away = ((arm - s[:, None] * edge) ** 2).sum(axis=1)
        nearer = away < distance
        best[nearer], distance[nearer] = 0.0, away[nearer]
        best[nearer, a], best[nearer, b] = 1 - s[nearer], s[nearer]
    inner = _projection(p, corners)
    above = (inner > 0).all(axis=1)
    best[above] = inner[above]
    return best


def _projection(p: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Barycentric shares of the projection on the triangle's plane; negative for a degenerate triangle."""
    u, v, w = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], p - corners[:, 0]
    normal = np.cross(u, v)
    size = (normal**2).sum(axis=1)
    size = np.where(size > 0, size, np.inf)
    second, third = ((np.cross(a, b) * normal).sum(axis=1) / size for a, b in ((w, v), (u, w)))
    flat = np.isinf(size)
    return np.stack([np.where(flat, -1.0, 1 - second - third), second, third], axis=1)


def face_normals(v: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (M, 3)."""
    return _unit(np.cross(v[faces[:, 1]] - v[faces[:, 0]], v[faces[:, 2]] - v[faces[:, 0]]))


def _pseudonormal(shares: np.ndarray, face: np.ndarray, v: np.ndarray, mesh: Triangles) -> np.ndarray:
    flat = face_normals(v, mesh.faces)
    out, corners = flat[face], (shares > 0).sum(axis=1)
    edge, corner = np.flatnonzero(corners == 2), np.flatnonzero(corners == 1)
    out[edge] += flat[mesh.beyond[face[edge], shares[edge].argmin(axis=1)]]
    out[corner] = _vertex_normals(v, mesh.faces, flat)[mesh.faces[face[corner], shares[corner].argmax(axis=1)]]
    return out


def _vertex_normals(v: np.ndarray, faces: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Normals weighted by the angle of each face at the vertex, (V, 3)."""
    edges = _unit(v[faces[:, _NEXT]] - v[faces])
    cosine = -(edges * edges[:, _BEFORE]).sum(axis=2)
    turned = (np.arccos(np.clip(cosine, -1, 1))[..., None] * flat[:, None]).reshape(-1, 3)
    return np.stack([np.bincount(faces.ravel(), turned[:, c], minlength=len(v)) for c in range(3)], axis=1)


def distance_hessian(shares: np.ndarray, offset: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Hessian (P, 4, 4, 3, 3) of half the squared distance in a point and the three corners (P, 3, 3) of its triangle.

    `a a^T (x) I - C (E^T E)^-1 C^T` with `C = a (x) E + s (x) r`, r the offset and a = (1, -shares); the closest point
    slides along the columns of E (two on a face, one on an edge, none at a corner), s = +-1 at their ends. Block
    [0, 0] is positive semi-definite: it is the whole Hessian for a surface that stays.
    """
    a = np.concatenate([np.ones((len(shares), 1)), -shares], axis=1)
    E, s = _slides(shares, corners)
    C = a[:, :, None, None] * E[:, None] + s[:, :, None] * offset[:, None, :, None]
    CG = C @ np.linalg.pinv(E.swapaxes(1, 2) @ E)[:, None]
    return (a[:, :, None] * a[:, None])[..., None, None] * np.eye(3) - np.einsum("paim,pbjm->pabij", CG, C)


def _slides(shares: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """E (P, 3, 2) [m], the differences of corners that the closest point slides along, and their ends s (P, 4, 2)."""
    first = shares.argmax(axis=1)
    rows, s = np.arange(len(shares)), np.zeros((len(shares), 4, 2))
    for column, other in enumerate(((first + 1) % 3, (first + 2) % 3)):
        free = shares[rows, other] > 0
        s[rows[free], 1 + other[free], column] = 1
        s[rows[free], 1 + first[free], column] = -1
    return np.einsum("pkm,pkc->pcm", s[:, 1:], corners), s


def _unit(v: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.divide(v, length, out=np.zeros_like(v), where=length > 0)
