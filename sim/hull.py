"""The solid that a cloud of points fills: an alpha shape of its Delaunay tetrahedra, for volumes and surface areas."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear
from scipy.sparse import csr_matrix, diags, vstack
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, QhullError

_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])  # outward for a positively oriented tetrahedron
_ALPHA = 1.25  # largest circumradius over neighbour distance: a cubic cell has 0.87, a gap of two and a half 1.25
_FILLED = 1.03, 1.5  # times the points' own volume, between which the hull's says that it closes gaps
_SOLID = 0.3  # of a tetrahedron, by which the points' volumes must speak against it, or for it alone
_NOTHING = 1e-9  # of the largest: where the faces around a point cancel, it has no outside


@dataclass(frozen=True, kw_only=True, eq=False)
class Hull:
    """Tetrahedra (M, 4) between neighbouring points and the outward faces (B, 3) that bound them."""

    tetrahedra: np.ndarray
    faces: np.ndarray

    @classmethod
    def of(cls, x: np.ndarray, reach: np.ndarray) -> "Hull":
        """The alpha shape of points x (N, 3) [m] with neighbour distances reach (N,) [m]; empty for a flat cloud."""
        x = x + 1e-6 * reach[:, None] * np.random.default_rng(0).standard_normal(x.shape)  # no flat cells on grids
        try:
            tets = Delaunay(x).simplices
        except QhullError:
            tets = np.zeros((0, 4), int)
        swap = _volumes(x, tets) < 0
        tets[swap, :2] = tets[swap, 1::-1]
        tets = tets[_circumradii(x, tets) < _ALPHA * reach[tets].mean(axis=1)]
        return cls(tetrahedra=tets, faces=_boundary(tets))

    def carved(self, x: np.ndarray, volume: np.ndarray, surface: np.ndarray) -> "Hull":
        """Without the gaps that it closes, by the volumes (N,) [m3] that the points x have and which of them are on the
        surface (N,) bool; itself where it closes none.

        A gap as wide as the points are apart is a cell like any other, but all its corners lie on the surface, and it
        is in no point's volume. Of such tetrahedra those go that least squares of the volumes leave out, together with
        most of those beside them: a corner of the body alone, whose shares differ from its points', stays.
        """
        every = self.volume(x)
        alone = np.flatnonzero(surface[self.tetrahedra].all(axis=1))
        if not (_FILLED[0] < every.sum() / volume.sum() < _FILLED[1] and len(alone) < len(self.tetrahedra)):
            return self
        tets, cell, count = self.tetrahedra[alone], np.median(volume), len(alone)
        size, beside = _volumes(x, tets), _beside(tets)
        shares = csr_matrix((np.repeat(size / 4, 4), (tets.ravel(), np.repeat(np.arange(count), 4))), (len(x), count))
        wanted = volume - every + np.asarray(shares.sum(axis=1)).ravel()
        asked, solid = np.unique(tets), _SOLID * size
        tied = _SOLID * size[beside].min(axis=1)
        ends = np.repeat(np.arange(len(beside)), 2), beside.ravel()
        alike = csr_matrix((np.outer(tied, [1, -1]).ravel(), ends), (len(beside), count))
        left = vstack([shares[asked], diags(solid), alike]).tocsr() / cell
        there = lsq_linear(left, np.concatenate([wanted[asked], solid, 0 * tied]) / cell, bounds=(0, 1)).x
        gone = there < 0.5
        both = beside[gone[beside].all(axis=1)].T
        gap = connected_components(csr_matrix((np.ones(both.shape[1]), both), (count, count)), directed=False)[1]
        gone &= np.bincount(gap, size * gone)[gap] > cell
        kept = np.delete(self.tetrahedra, alone[gone], axis=0)
        return Hull(tetrahedra=kept, faces=_boundary(kept))

    def volume(self, x: np.ndarray) -> np.ndarray:
        """A quarter of the tetrahedra around each point, at positions x (N, 3): (N,) [m3]."""
        corners = np.repeat(_volumes(x, self.tetrahedra) / 4, 4)
        return np.bincount(self.tetrahedra.ravel(), corners, minlength=len(x))

    def area(self, x: np.ndarray) -> np.ndarray:
        """A third of the boundary faces around each point as an outward vector, at positions x: (N, 3) [m2].

        Zero inside, summing to zero, with `sum_i x_i (x) area_i = volume * identity`: the divergence theorem.
        """
        a, b, c = (x[self.faces[:, n]] for n in range(3))
        return self._summed(np.repeat(np.cross(b - a, c - a) / 6, 3, axis=0), len(x))

    def normals(self, x: np.ndarray) -> np.ndarray:
        """Outward unit normals (N, 3) at positions x (N, 3) [m]; zero inside.

        Every face counts by the part of it that lies nearest to the point (the mixed areas of Meyer et al. 2003): a
        third of each would depend on which way a flat patch happens to be cut, and tilt the normals of edges.
        """
        corners = x[self.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        out = self._summed((_nearest_parts(corners)[..., None] * normal[:, None]).reshape(-1, 3), len(x))
        size = np.linalg.norm(out, axis=1, keepdims=True)
        return np.divide(out, size, out=np.zeros_like(out), where=size > _NOTHING * size.max(initial=0.0))

    def _summed(self, shares: np.ndarray, count: int) -> np.ndarray:
        """What the faces' corners (3 B, 3) bring to each of so many points, (count, 3)."""
        return np.stack([np.bincount(self.faces.ravel(), shares[:, n], minlength=count) for n in range(3)], axis=1)

    def surface(self, count: int) -> np.ndarray:
        """The points on the boundary, or in no tetrahedron, (count,) bool."""
        outside = np.ones(count, bool)
        outside[self.tetrahedra] = False
        outside[self.faces] = True
        return outside


def _volumes(x: np.ndarray, tets: np.ndarray) -> np.ndarray:
    a, b, c = (x[tets[:, n]] - x[tets[:, 0]] for n in (1, 2, 3))
    return np.einsum("ti,ti->t", np.cross(a, b), c) / 6


def _circumradii(x: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Radius of the sphere through the four vertices of each tetrahedron [m]."""
    a, b, c = (x[tets[:, n]] - x[tets[:, 0]] for n in (1, 2, 3))
    aa, bb, cc = ((v**2).sum(axis=1, keepdims=True) for v in (a, b, c))
    top = np.linalg.norm(aa * np.cross(b, c) + bb * np.cross(c, a) + cc * np.cross(a, b), axis=1)
    return top / np.maximum(12 * np.abs(_volumes(x, tets)), np.finfo(float).tiny)


def _nearest_parts(corners: np.ndarray) -> np.ndarray:
    """Shares (B, 3) of triangles (B, 3, 3) nearest to each corner; an obtuse one gives half to its widest."""
    sides = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)  # opposite to each corner
    long = (sides**2).sum(axis=2)
    cosine = (long.sum(axis=1, keepdims=True) - 2 * long) / 2  # times the lengths of the two sides that meet there
    twice = long * cosine
    shares = (twice.sum(axis=1, keepdims=True) - twice) / np.maximum(2 * twice.sum(axis=1, keepdims=True), 1e-300)
    return np.where((cosine < 0).any(axis=1, keepdims=True), np.where(cosine < 0, 0.5, 0.25), shares)


def _boundary(tets: np.ndarray) -> np.ndarray:
    """Outward faces (M, 3) that belong to one tetrahedron only."""
    faces = tets[:, _FACES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]


def _beside(tets: np.ndarray) -> np.ndarray:
    """Pairs (M, 2) of tetrahedra that share a face."""
    faces = np.sort(tets[:, _FACES].reshape(-1, 3), axis=1)
    order = np.lexsort(faces.T)
    same = (np.diff(faces[order], axis=0) == 0).all(axis=1)
    return np.stack([order[:-1][same], order[1:][same]], axis=1) // 4
