"""The rest cloud: neighbours, gradient vectors and volumes, computed once and used by every solve."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from sim.checks import as_array, require, some
from sim.consistency import corrected_gradients
from sim.hull import Hull

_THIN = 2e-2  # smallest over largest moment of a neighbourhood: below it, neighbours off its plane are sought
_FLAT = 1e-3  # below it a neighbourhood says nothing about one direction
_CANDIDATES = 24
_DEFAULTS = {"consistent": (8, 1.0), "paper": (6, 0.0)}  # neighbours, stabilisation


@dataclass(frozen=True, kw_only=True)
class CloudOptions:
    """How the cloud is discretised.

    mode "consistent" corrects the gradient vectors so that the scheme passes the patch test; "paper" is the plain
    weighted least-squares scheme. neighbours None takes 8 in consistent mode (with the paper's 6, parts a few
    points thick come out up to a third too stiff) and 6 in paper mode. stabilisation is c in
    `c mu V / (2 h^2) sum_j w_j |y_ij - F x_ij|^2`; None takes 1 in consistent and 0 in paper mode.
    """

    neighbours: int | None = None
    mode: Literal["consistent", "paper"] = "consistent"
    stabilisation: float | None = None

    def __post_init__(self) -> None:
        require(self.mode in _DEFAULTS, "mode", "be 'consistent' or 'paper'", repr(self.mode))
        neighbours, stabilisation = _DEFAULTS[self.mode]
        if self.neighbours is None:
            object.__setattr__(self, "neighbours", neighbours)
        if self.stabilisation is None:
            object.__setattr__(self, "stabilisation", stabilisation)
        require(self.neighbours >= 4, "neighbours", "be at least 4", self.neighbours)
        require(self.stabilisation >= 0, "stabilisation", "not be negative", self.stabilisation)


@dataclass(frozen=True, kw_only=True, eq=False)
class RestCloud:
    """A point cloud in its reference pose, ready for simulation (paper Eq. deformation_gradient).

    `F_i = I + sum_j (u_j - u_i) g_ij^T` over the k neighbours j of i, with u the displacement.
    """

    x: np.ndarray  # (N, 3) [m]
    neighbours: np.ndarray  # (N, k) int32
    weights: np.ndarray  # (N, k), summing to 1 over k
    arms: np.ndarray  # (N, k, 3) x_j - x_i [m]
    gradients: np.ndarray  # (N, k, 3) g_ij [1/m]
    volume: np.ndarray  # (N,) [m3]
    area: np.ndarray  # (N, 3) outward area vector, zero inside [m2]
    surface: np.ndarray  # (N,) bool
    reach: np.ndarray  # (N,) mean neighbour distance [m]
    island: np.ndarray  # (N,) label of the connected part
    incident_start: np.ndarray  # (N + 1,) int32, where each point's incident edges begin
    incident_point: np.ndarray  # (N k,) int32, the edge's owner i
    incident_slot: np.ndarray  # (N k,) int32, its slot among i's neighbours
    hull: Hull
    options: CloudOptions

    @classmethod
    def build(
        cls,
        x: np.ndarray,
        *,
        volume: float | np.ndarray | None = None,
        surface: np.ndarray | None = None,
        options: CloudOptions | None = None,
    ) -> "RestCloud":
        """Precompute everything that depends on the rest positions x (N, 3) [m] only.

        volume: total [m3], or per point (N,) [m3], or None to take the volume of the cloud's alpha shape.
        surface: (N,) bool, or None to find it. Raises ValueError naming the points when two coincide or a
        neighbourhood stays flat with every near point considered.
        """
        options = options or CloudOptions()
        x = as_array("x", x, (None, 3))
        require(len(x) > options.neighbours, "x", f"hold more than {options.neighbours} points", len(x))
        neighbours, reach = _neighbourhoods(x, options.neighbours)
        hull = Hull.of(x, reach)
        told = surface is not None and np.ndim(volume) == 1
        volume = _point_volumes(volume, hull.volume(x), reach)
        surface = hull.surface(len(x)) if surface is None else as_array("surface", surface, (len(x),), bool)
        hull = hull.carved(x, volume, surface) if told else hull
        start, point, slot = _incident(neighbours)
        return cls(
            x=x, neighbours=neighbours, volume=volume, reach=reach, hull=hull,
            **_geometry(x, neighbours, volume, hull, options),
            surface=surface, island=_islands(neighbours), incident_start=start, incident_point=point,
            incident_slot=slot, options=options,
        )  # fmt: skip

    def moved(self, x: np.ndarray) -> "RestCloud":
        """The cloud of the same object at rest with its points at x (N, 3) [m]: same neighbours, same tetrahedra."""
        before = self.hull.volume(self.x)
        ratio = np.divide(self.hull.volume(x), before, out=np.ones_like(before), where=before > 0)
        volume = self.volume * ratio
        reach = np.linalg.norm(x[self.neighbours] - x[:, None], axis=2).mean(axis=1)
        parts = _geometry(x, self.neighbours, volume, self.hull, self.options)
        return replace(self, x=x, volume=volume, reach=reach, **parts)

    @property
    def count(self) -> int:
        """The number of points N."""
        return len(self.x)

    @property
    def spacing(self) -> float:
        """The cloud's mean neighbour distance [m]."""
        return float(self.reach.mean())

    @property
    def normals(self) -> np.ndarray:
        """Outward unit normals (N, 3); zero where the cloud shows no surface."""
        return self.hull.normals(self.x)

    def deformation_gradient(self, y: np.ndarray) -> np.ndarray:
        """F (T, N, 3, 3) of the positions y (T, N, 3) [m]."""
        arms = y[:, self.neighbours] - y[:, :, None] - self.arms
        return np.eye(3) + np.einsum("tnka,nkb->tnab", arms, self.gradients)

    def divergence(self, P: np.ndarray) -> np.ndarray:
        """`sum_i V_i (dF_i/dy)^T : P_i`, (T, N, 3) [N]: the gradient's transpose, for stresses P (T, N, 3, 3) [Pa]."""
        edge = np.einsum("n,tnab,nkb->tnka", self.volume, P, self.gradients)
        flat = edge.reshape(len(P), -1, 3)[:, self.incident_point * edge.shape[2] + self.incident_slot]
        padded = np.concatenate([flat, np.zeros_like(flat[:, :1])], axis=1)  # a last point may have no incident edge
        arriving = np.add.reduceat(padded, self.incident_start[:-1], axis=1)
        return arriving * (np.diff(self.incident_start) > 0)[:, None] - edge.sum(axis=2)


def _neighbourhoods(x: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
    """The k nearest neighbours (N, k) and their mean distance (N,), with flat neighbourhoods widened."""
    distance, index = cKDTree(x).query(x, min(_CANDIDATES + 1, len(x)))
    same = np.flatnonzero(distance[:, 1] <= 1e-9 * distance[:, 1].max())
    require(len(same) == 0, "x", "hold no point twice", f"{len(same)} coinciding points: {some(same)}")
    chosen = index[:, 1 : k + 1].copy()
    for i in np.flatnonzero(_flatness(x[chosen] - x[:, None]) < _THIN):
        chosen[i] = _widened(x[index[i, 1:]] - x[i], k, index[i, 1:])
    flat = np.flatnonzero(_flatness(x[chosen] - x[:, None]) < _FLAT)
    got = f"flat neighbourhoods at points {some(flat)}"
    require(len(flat) == 0, "x", "surround every point in three directions", got)
    return chosen.astype(np.int32), np.linalg.norm(x[chosen] - x[:, None], axis=2).mean(axis=1)


def _flatness(arms: np.ndarray) -> np.ndarray:
    """Smallest over largest eigenvalue of the second moment of the arms (..., k, 3)."""
    values = np.linalg.eigvalsh(np.einsum("...ka,...kb->...ab", arms, arms))
    return values[..., 0] / values[..., -1]


def _widened(arms: np.ndarray, k: int, candidates: np.ndarray) -> np.ndarray:
    """k neighbours: the nearest, the farthest two traded for the nearest ones off their plane, one a side."""
    moment = arms[:k].T @ arms[:k]
    off = arms @ np.linalg.eigh(moment)[1][:, 0] / np.linalg.norm(arms, axis=1)
    sides = [np.flatnonzero(side * off > 0.3) for side in (1, -1)]
    extra = [s[0] for s in sides if len(s)]
    return candidates[np.array([*range(k - len(extra)), *extra])]


def _geometry(
    x: np.ndarray, neighbours: np.ndarray, volume: np.ndarray, hull: Hull, options: CloudOptions
) -> dict[str, np.ndarray]:
    """The fields that follow from positions and topology: arms, weights, area, gradients."""
    arms = x[neighbours] - x[:, None]
    weights, lumped = _weights(arms), hull.volume(x)
    area = hull.area(x) * (volume.sum() / lumped.sum() if lumped.sum() > 0 else 0.0)
    gradients = _least_squares_gradients(arms, weights)
    if options.mode == "consistent":
        gradients = corrected_gradients(gradients, arms, neighbours, volume, area, lumped > 0)
    return {"arms": arms, "weights": weights, "area": area, "gradients": gradients}


def _weights(arms: np.ndarray) -> np.ndarray:
    """The polynomial kernel (1 - (r/H)^2)^3 of Mueller et al. 2004 with H three mean distances, normalised."""
    r = np.linalg.norm(arms, axis=2)
    w = np.maximum(1 - (r / (3 * r.mean(axis=1, keepdims=True))) ** 2, 1e-3) ** 3
    return w / w.sum(axis=1, keepdims=True)


def _least_squares_gradients(arms: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """g_ij = w_ij (X W X^T)^-1 x_ij the weighted least-squares gradient of paper Eq. 3."""
    moment = np.einsum("nk,nka,nkb->nab", weights, arms, arms)
    return weights[:, :, None] * np.einsum("nab,nkb->nka", np.linalg.inv(moment), arms)


def _point_volumes(volume: float | np.ndarray | None, lumped: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Per-point volumes: the caller's; else the alpha shape's, a stray point getting a small one."""
    if volume is not None and np.ndim(volume) == 1:
        volume = as_array("volume", volume, (len(reach),))
        require(bool((volume > 0).all()), "volume", "be positive at every point", volume.min())
        return volume
    own = np.maximum(lumped, 0.02 * reach**3)
    if volume is None:
        return own
    require(volume > 0, "volume", "be positive", volume)
    return np.full(len(reach), volume / len(reach))


def _incident(neighbours: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges sorted by the point they end at: sums over it are gathered, never scattered, so they are reproducible."""
    N, k = neighbours.shape
    order = np.argsort(neighbours.ravel(), kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(neighbours.ravel(), minlength=N))])
    return start.astype(np.int32), (order // k).astype(np.int32), (order % k).astype(np.int32)


def _islands(neighbours: np.ndarray) -> np.ndarray:
    N, k = neighbours.shape
    graph = csr_matrix((np.ones(N * k), (np.repeat(np.arange(N), k), neighbours.ravel())), (N, N))
    return connected_components(graph, directed=False)[1]
