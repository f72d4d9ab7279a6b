"""The solid that a cloud of points fills: an alpha shape of its Delaunay tetrahedra, for volumes and surface areas."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay, QhullError

_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])  # outward for a positively oriented tetrahedron


@dataclass(frozen=True, kw_only=True)
class Solid:
    """Lumped volumes (N,) [m3] and outward area vectors (N, 3) [m2] of the tetrahedra around each point.

    An area vector is a third of the boundary faces around a point: zero inside, summing to zero, with
    `sum_i x_i (x) area_i = volume * identity`, the divergence theorem.
    """

    volume: np.ndarray  # (N,) [m3]
    area: np.ndarray  # (N, 3) [m2]
    surface: np.ndarray  # (N,) bool


def solid(x: np.ndarray, reach: np.ndarray, alpha: float = 1.8) -> Solid:
    """The alpha shape of points x (N, 3) [m]: Delaunay tetrahedra whose circumradius is below alpha * local reach.

    reach (N,) [m] is each point's mean neighbour distance. Points that no tetrahedron keeps have zero volume and
    count as surface; an empty shape (a flat cloud) returns zeros everywhere.
    """
    x = x + 1e-6 * reach[:, None] * np.random.default_rng(0).standard_normal(x.shape)  # no flat tetrahedra on grids
    tets = _kept_tetrahedra(x, reach, alpha)
    volume, area = np.zeros(len(x)), np.zeros((len(x), 3))
    np.add.at(volume, tets, (_volumes(x, tets) / 4)[:, None])
    faces = _boundary(tets)
    vectors = 0.5 * np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
    np.add.at(area, faces, np.repeat(vectors[:, None] / 3, 3, axis=1))
    surface = volume == 0
    surface[faces] = True
    return Solid(volume=volume, area=area, surface=surface)


def _kept_tetrahedra(x: np.ndarray, reach: np.ndarray, alpha: float) -> np.ndarray:
    try:
        tets = Delaunay(x).simplices
    except QhullError:
        return np.zeros((0, 4), int)
    swap = _volumes(x, tets) < 0
    tets[swap, :2] = tets[swap, 1::-1]
    return tets[_circumradii(x, tets) < alpha * reach[tets].mean(axis=1)]


def _volumes(x: np.ndarray, tets: np.ndarray) -> np.ndarray:
    a, b, c = (x[tets[:, n]] - x[tets[:, 0]] for n in (1, 2, 3))
    return np.einsum("ti,ti->t", np.cross(a, b), c) / 6


def _circumradii(x: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Radius of the sphere through the four vertices of each tetrahedron [m]."""
    a, b, c = (x[tets[:, n]] - x[tets[:, 0]] for n in (1, 2, 3))
    aa, bb, cc = ((v**2).sum(axis=1, keepdims=True) for v in (a, b, c))
    top = np.linalg.norm(aa * np.cross(b, c) + bb * np.cross(c, a) + cc * np.cross(a, b), axis=1)
    bottom = 12 * np.abs(_volumes(x, tets))
    return top / np.maximum(bottom, np.finfo(float).tiny)


def _boundary(tets: np.ndarray) -> np.ndarray:
    """Outward faces (M, 3) that belong to one tetrahedron only."""
    faces = tets[:, _FACES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]
