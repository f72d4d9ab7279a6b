"""Bend rays by a moved point cloud instead of a network (paper, section "Rendering"): re-render any simulated state."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import taichi as ti
import torch
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from recon.radiance.device import tensor
from recon.radiance.fields import Field
from recon.radiance.marching import Occupancy
from sim.checks import as_array, require
from sim.runtime import ensure

NEIGHBOURS = 5  # the paper's K
_LEAST = 1e-9  # [m], below which distances are all alike
_FAR = 1e15  # [m], farther than which nothing is; its square is a number in single precision
_STRETCHED = 1.5  # times as far apart as at rest

Reals1, Reals2 = (ti.types.ndarray(dtype=ti.f32, ndim=n) for n in (1, 2))
Numbers1 = ti.types.ndarray(dtype=ti.i32, ndim=1)
Numbers3 = ti.types.vector(3, ti.i32)
triple = ti.types.vector(3, ti.f32)


@dataclass(frozen=True, kw_only=True, eq=False)
class CloudWarp:
    """A cloud at rest and moved, sorted into cubes: `p_c = p + sum_s w_s (x_s - y_s) / sum w`, over the five nearest.

    `w_s = 1/|p - y_s| - min 1/|p - y|`, so that a neighbour's say ends smoothly; all alike where all would be zero.
    """

    moved: torch.Tensor  # (N, 3) f32, by cube
    offset: torch.Tensor  # (N, 3) f32, rest minus moved
    first: torch.Tensor  # (cubes + 1,) i32
    origin: torch.Tensor  # (3,) f32, lowest corner of the cubes
    shape: tuple[int, int, int]
    spacing: float

    @classmethod
    def of(cls, rest: np.ndarray, moved: np.ndarray) -> "CloudWarp":
        """From positions (N, 3) [m] at rest and moved; raises ValueError for fewer than five points."""
        rest = as_array("rest", rest, (None, 3))
        moved = as_array("moved", moved, rest.shape)
        require(len(rest) >= NEIGHBOURS, "rest", f"have at least {NEIGHBOURS} points", len(rest))
        near = cKDTree(moved).query(moved, min(4, len(moved)))[0][:, -1]
        spacing = max(float(np.median(near)), 1e-6 * float(np.ptp(moved)), 1e-12)
        low = moved.min(axis=0)
        shape = np.floor(np.ptp(moved, axis=0) / spacing).astype(int) + 1
        cell = np.minimum(np.floor((moved - low) / spacing).astype(int), shape - 1)
        number = np.ravel_multi_index(tuple(cell.T), tuple(shape))
        order = np.argsort(number, kind="stable")
        first = np.searchsorted(number[order], np.arange(shape.prod() + 1)).astype(np.int32)
        own, offset = (tensor(np.ascontiguousarray(v[order], np.float32)) for v in (moved, rest - moved))
        return cls(
            moved=own, offset=offset, first=tensor(first), origin=tensor(low.astype(np.float32)),
            shape=tuple(shape.tolist()), spacing=spacing,
        )  # fmt: skip

    def __call__(self, places: torch.Tensor, cut: float = _FAR) -> tuple[torch.Tensor, torch.Tensor]:
        """Where places (S, 3) [m] were at rest, (S, 3), and how far the nearest point is, (S,) [m].

        Of places farther than `cut` [m] from all points it is only said that they are.
        """
        ensure()
        places = places.detach().contiguous()
        out, nearest = torch.empty_like(places), places.new_empty(len(places))
        if len(places):
            _interpolate(places, self.moved, self.offset, self.first, self.origin, Numbers3(*self.shape), self.spacing,
                         cut, out, nearest)  # fmt: skip
        return out, nearest


def moved_field(canonical: Callable, warp: CloudWarp, cut: float) -> Field:
    """The field of a moved cloud: `v(p_c)`, clear where no point is within `cut` [m]."""

    def field(places: torch.Tensor, frame: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        rest, nearest = warp(places, cut)
        near = torch.nonzero(nearest < cut)[:, 0]
        density, colour = places.new_zeros(len(places)), places.new_zeros(len(places), 3)
        if len(near):
            density[near], colour[near] = canonical(rest[near])
        return density, colour

    return field


def cloud_occupancy(moved: np.ndarray, *, cut: float, cells: int = 96) -> Occupancy:
    """One frame's occupancy: the cells that may lie within `cut` [m] of a point (N, 3) [m]."""
    moved = as_array("moved", moved, (None, 3))
    low, high = moved.min(axis=0) - 2 * cut, moved.max(axis=0) + 2 * cut
    spacing = float((high - low).max() / cells)
    shape = np.ceil((high - low) / spacing).astype(int) + 1
    empty = np.ones(shape, bool)
    empty[tuple(np.floor((moved - low) / spacing).astype(int).T)] = False
    near = distance_transform_edt(empty) * spacing <= cut + np.sqrt(3) * spacing
    origin = tensor(low.astype(np.float32))
    return Occupancy(cells=tensor(near[None].astype(np.uint8)), origin=origin, spacing=spacing)


def neighbours(rest: np.ndarray, *, near: int = 6) -> np.ndarray:
    """Pairs (P, 2) of each point of a cloud (N, 3) and its nearest ones at rest, each pair once."""
    rest = as_array("rest", rest, (None, 3))
    other = cKDTree(rest).query(rest, min(near + 1, len(rest)))[1][:, 1:]
    pairs = np.stack([np.repeat(np.arange(len(rest)), other.shape[1]), other.ravel()], axis=1)
    return np.unique(np.sort(pairs, axis=1), axis=0)


def densified(
    rest: np.ndarray, moved: np.ndarray, pairs: np.ndarray, *, stretched: float = _STRETCHED
) -> tuple[np.ndarray, np.ndarray]:
    """Both clouds (N, 3) with a point between neighbours (P, 2) that are `stretched` times as far apart as at rest, or
    more: the field would be cut away between them."""
    rest = as_array("rest", rest, (None, 3))
    moved = as_array("moved", moved, rest.shape)
    before, after = (np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1) for x in (rest, moved))
    far = pairs[after >= stretched * before]
    return tuple(np.concatenate([x, x[far].mean(axis=1)]) for x in (rest, moved))


@ti.func
def _insert(distances: ti.template(), which: ti.template(), square: ti.f32, m: ti.i32):
    """Into a list of five kept in order."""
    distances[4], which[4] = square, m
    for a in ti.static(range(4, 0, -1)):
        if distances[a] < distances[a - 1]:
            distances[a], distances[a - 1] = distances[a - 1], distances[a]
            which[a], which[a - 1] = which[a - 1], which[a]


@ti.kernel
def _interpolate(
    places: Reals2, moved: Reals2, offset: Reals2, first: Numbers1, origin: Reals1, shape: Numbers3, spacing: ti.f32,
    cut: ti.f32, out: Reals2, nearest: Reals1,
):  # fmt: skip
    # Rings of cubes around the place's own, until the fifth nearest is nearer than whatever was not searched, or all
    # that was not is farther than anyone asks.
    for q in range(places.shape[0]):
        x, home = triple(0), Numbers3(0)
        for a in ti.static(range(3)):
            x[a] = places[q, a]
            cube = ti.cast(ti.floor((x[a] - origin[a]) / spacing), ti.i32)
            home[a] = ti.min(ti.max(cube, 0), shape[a] - 1)
        distances, which = ti.Vector([ti.cast(1e30, ti.f32)] * 5), ti.Vector([0] * 5)
        done, ring = 0, 0
        while done == 0:
            low, high = ti.max(home - ring, 0), ti.min(home + ring, shape - 1)
            for i in range(low[0], high[0] + 1):
                for j in range(low[1], high[1] + 1):
                    for k in range(low[2], high[2] + 1):
                        if ti.max(ti.abs(i - home[0]), ti.abs(j - home[1]), ti.abs(k - home[2])) == ring:
                            cube = (i * shape[1] + j) * shape[2] + k
                            for m in range(first[cube], first[cube + 1]):
                                square = ti.cast(0, ti.f32)
                                for a in ti.static(range(3)):
                                    square += (moved[m, a] - x[a]) ** 2
                                if square < distances[4]:
                                    _insert(distances, which, square, m)
            # Everything within the searched block is known; a place outside the cubes is farther from what is beyond.
            reach = ti.cast(1e30, ti.f32)
            for a in ti.static(range(3)):
                inside = x[a] - origin[a] - ti.cast(home[a], ti.f32) * spacing
                reach = ti.min(reach, ti.max(inside, 0) + ring * spacing, ti.max(spacing - inside, 0) + ring * spacing)
            whole = ti.max(shape[0], shape[1], shape[2])
            beyond = distances[0] > cut * cut and reach > cut
            if distances[4] <= reach * reach or ring >= whole or beyond:
                done = 1
            ring += 1
        weights, least = ti.Vector([ti.cast(0, ti.f32)] * 5), ti.cast(1e30, ti.f32)
        for a in ti.static(range(5)):
            weights[a] = 1 / ti.max(ti.sqrt(distances[a]), ti.cast(_LEAST, ti.f32))
            least = ti.min(least, weights[a])
        total, shift = ti.cast(0, ti.f32), triple(0)
        for a in ti.static(range(5)):
            total += weights[a] - least
        for a in ti.static(range(5)):
            share = (weights[a] - least) / ti.max(total, ti.cast(1e-30, ti.f32))
            if total <= ti.cast(1e-6, ti.f32) * weights[0]:
                share = ti.cast(0.2, ti.f32)
            for b in ti.static(range(3)):
                shift[b] += share * offset[which[a], b]
        for b in ti.static(range(3)):
            out[q, b] = x[b] + shift[b]
        nearest[q] = ti.sqrt(distances[0])
