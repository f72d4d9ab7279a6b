"""A soft body of quadratic tetrahedra: its nodes, its skin, and values at any point inside."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))  # corners at whose middle the nodes 4 to 9 lie
FACES = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))  # outwards for a tetrahedron of positive volume
CANDIDATES = 24  # tetrahedra looked at for each point
NEWTON = 12
SAME = 1e-7  # [m], vertices of the skin nearer than this are one
# Dunavant's rule of degree 4 on the triangle (1985): weights and the one of three barycentrics that differs.
DUNAVANT = ((0.223381589678011, 0.108103018168070), (0.109951743655322, 0.816847572980459))


def edges_of(tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The edges (M, 2) of tetrahedra (E, 4), sorted, and each tetrahedron's six among them, (E, 6)."""
    pairs = np.sort(tetrahedra[:, EDGES], axis=2)
    edges, index = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
    return edges, index.reshape(len(tetrahedra), 6)


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """Nodes: first the corners of the tetrahedra, then the middles of their edges in the order of `edges_of`."""

    nodes: np.ndarray  # (N, 3) [m] at rest
    tetrahedra: np.ndarray  # (E, 4) corners

    @cached_property
    def cells(self) -> np.ndarray:
        """All nodes of each tetrahedron, (E, 10)."""
        edges, index = edges_of(self.tetrahedra)
        corners = len(self.nodes) - len(edges)
        return np.concatenate([self.tetrahedra, corners + index], axis=1)

    @cached_property
    def faces(self) -> np.ndarray:
        """The skin's quadratic triangles, (S, 6): corners, seen from outside, and the middles of 01, 12, 20."""
        local = [(*f, *(4 + _edge(f[i], f[(i + 1) % 3]) for i in range(3))) for f in FACES]
        every = self.cells[:, local].reshape(-1, 6)
        _, first, count = np.unique(np.sort(every[:, :3], axis=1), axis=0, return_index=True, return_counts=True)
        return every[np.sort(first[count == 1])]

    @cached_property
    def surface(self) -> np.ndarray:
        """Which nodes lie on the skin, (N,) bool."""
        return np.isin(np.arange(len(self.nodes)), self.faces)

    @cached_property
    def triangles(self) -> np.ndarray:
        """The skin as flat triangles between its nodes, (4 S, 3)."""
        a, b, c, ab, bc, ca = self.faces.T
        return np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])

    def skin(self, cuts: int) -> tuple[csr_matrix, np.ndarray]:
        """A finer skin, each edge of a quadratic triangle cut in so many: values (V, N) at its vertices, triangles."""
        bary, local = cut_triangle(cuts)
        values = six(bary)
        place = np.einsum("gk,skj->sgj", values, self.nodes[self.faces]).reshape(-1, 3)
        _, first, index = np.unique(
            np.round(place / SAME).astype(np.int64), axis=0, return_index=True, return_inverse=True
        )
        face, point = np.divmod(first, len(bary))
        rows = np.repeat(np.arange(len(first)), 6)
        weights = csr_matrix(
            (values[point].ravel(), (rows, self.faces[face].ravel())), shape=(len(first), len(self.nodes))
        )
        return weights, index.reshape(len(self.faces), len(bary))[:, local].reshape(-1, 3)

    def skin_points(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (Q, 3) on the skin of displaced nodes (N, 3) [m] and their outward area vectors (Q, 3) [m2]."""
        bary, weight = rule()
        corner = nodes[self.faces]
        x = np.einsum("gk,skj->sgj", six(bary), corner)
        along, across = (np.einsum("gk,skj->sgj", slope, corner) for slope in six_slopes(bary))
        return x.reshape(-1, 3), (np.cross(along, across) * weight[:, None] / 2).reshape(-1, 3)

    @cached_property
    def consistent(self) -> csr_matrix:
        """Forces at `skin_points` to nodal forces that do the same work on every quadratic displacement, (N, Q)."""
        return self._spread(six(rule()[0]))

    @cached_property
    def lumped(self) -> csr_matrix:
        """The same on flat triangles between the nodes: no node gets a negative share, (N, Q)."""
        return self._spread(_flat(rule()[0]))

    def interpolation(self, points: np.ndarray) -> csr_matrix:
        """Nodal values to values at rest positions (M, 3) [m] in the body or a little outside, (M, N)."""
        cell, local = self._located(points)
        values = ten(local)
        rows = np.repeat(np.arange(len(points)), 10)
        return csr_matrix((values.ravel(), (rows, self.cells[cell].ravel())), shape=(len(points), len(self.nodes)))

    def _spread(self, values: np.ndarray) -> csr_matrix:
        """Values (G, 6) of a triangle's nodes at its points as a matrix (N, Q)."""
        count = len(self.faces) * len(values)
        rows = np.repeat(self.faces[:, None], len(values), axis=1).ravel()
        columns = np.repeat(np.arange(count), 6)
        return csr_matrix((np.tile(values.ravel(), len(self.faces)), (rows, columns)), shape=(len(self.nodes), count))

    def _located(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The tetrahedron of each point and its place in it, three of the four barycentrics (M, 3)."""
        corner = self.nodes[self.tetrahedra]
        inverse = np.linalg.inv((corner[:, 1:] - corner[:, :1]).transpose(0, 2, 1))
        near = cKDTree(corner.mean(axis=1)).query(points, k=CANDIDATES)[1]
        local = np.einsum("mkij,mkj->mki", inverse[near], points[:, None] - corner[near, 0])
        least = np.minimum(local.min(axis=2), 1 - local.sum(axis=2))
        best = least.argmax(axis=1)
        cell, local = near[np.arange(len(points)), best], local[np.arange(len(points)), best]
        nodes = self.nodes[self.cells[cell]]
        found, nearest = local, np.full((len(points), 1), np.inf)
        for _ in range(NEWTON + 1):  # edges on the skin are curved; beside it there may be no such place
            off = points - np.einsum("mk,mkj->mj", ten(local), nodes)
            far = np.linalg.norm(off, axis=1, keepdims=True)
            nearer = far < nearest
            found, nearest = np.where(nearer, local, found), np.minimum(far, nearest)
            local = np.where(nearer, local + np.einsum("mij,mj->mi", inverse[cell], off), found)
        return cell, found


def ten(local: np.ndarray) -> np.ndarray:
    """Quadratic shape functions of a tetrahedron at local coordinates (M, 3), (M, 10)."""
    b = np.concatenate([1 - local.sum(axis=1, keepdims=True), local], axis=1)
    return np.concatenate([b * (2 * b - 1), *(4 * b[:, [i]] * b[:, [j]] for i, j in EDGES)], axis=1)


def six(b: np.ndarray) -> np.ndarray:
    """Quadratic shape functions of a triangle at barycentrics (M, 3), (M, 6)."""
    return np.concatenate([b * (2 * b - 1), 4 * b * np.roll(b, -1, axis=1)], axis=1)


def six_slopes(b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Their derivatives along the first edge, corner 0 to 1, and along 0 to 2, (M, 6) each."""
    d = 4 * b - 1
    zero, (p, q, r) = np.zeros(len(b)), b.T
    first = np.stack([-d[:, 0], d[:, 1], zero, 4 * (p - q), 4 * r, -4 * r], axis=1)
    second = np.stack([-d[:, 0], zero, d[:, 2], -4 * q, 4 * q, 4 * (p - r)], axis=1)
    return first, second


def rule() -> tuple[np.ndarray, np.ndarray]:
    """Barycentrics (6, 3) and weights (6,) of sum 1 that integrate degree 4 on a triangle."""
    bary = [np.roll([a, (1 - a) / 2, (1 - a) / 2], i) for _, a in DUNAVANT for i in range(3)]
    return np.array(bary), np.repeat([w for w, _ in DUNAVANT], 3)


def _flat(b: np.ndarray) -> np.ndarray:
    """Linear shape functions on the four flat triangles between a quadratic triangle's nodes, (M, 6)."""
    corner = np.maximum(0.0, 2 * b - 1)
    inner = (b < 0.5).all(axis=1, keepdims=True)
    side = np.where(inner, 1 - 2 * np.roll(b, -2, axis=1), 0.0)
    out = np.concatenate([corner, side], axis=1)
    for i in range(3):
        here = b[:, i] >= 0.5
        out[here, 3 + i], out[here, 3 + (i + 2) % 3] = 2 * b[here, (i + 1) % 3], 2 * b[here, (i + 2) % 3]
    return out


def _edge(a: int, b: int) -> int:
    return EDGES.index((min(a, b), max(a, b)))


def cut_triangle(cuts: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentrics of a triangle cut evenly, and its small triangles."""
    steps = [(i, j) for i in range(cuts + 1) for j in range(cuts + 1 - i)]
    number = {step: k for k, step in enumerate(steps)}
    up = [(number[i, j], number[i + 1, j], number[i, j + 1]) for i, j in steps if i + j < cuts]
    down = [(number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]) for i, j in steps if i + j < cuts - 1]
    second, third = np.array(steps).T / cuts
    return np.stack([1 - second - third, second, third], axis=1), np.array(up + down)
