"""Samples along rays where there may be something: per-frame occupancy, evenly spaced, packed."""

from dataclasses import dataclass

import taichi as ti
import torch

from recon.radiance.precision import arrays_of
from sim.checks import require
from sim.runtime import ensure

Reals1, Reals2 = arrays_of(ti.f32)
Numbers1, Numbers2 = (ti.types.ndarray(dtype=ti.i32, ndim=n) for n in (1, 2))
Bytes4 = ti.types.ndarray(dtype=ti.u8, ndim=4)
triple = ti.types.vector(3, ti.f32)


@dataclass(frozen=True, kw_only=True, eq=False)
class Occupancy:
    """Where each frame may have something: cells (T, X, Y, Z) uint8 over a box; origin (3,), its lowest corner, and
    spacing, a cell's side [m]."""

    cells: torch.Tensor
    origin: torch.Tensor
    spacing: float

    def __post_init__(self) -> None:
        fits = self.cells.dtype == torch.uint8 and self.cells.ndim == 4
        require(fits, "cells", "be (T, X, Y, Z) uint8", (tuple(self.cells.shape), self.cells.dtype))

    @property
    def size(self) -> torch.Tensor:
        """Sides of the box, (3,) [m]."""
        return self.spacing * torch.tensor(self.cells.shape[1:], dtype=torch.float32)

    @property
    def step(self) -> float:
        """A useful distance between samples [m]: two in a cell."""
        return self.spacing / 2


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """place (S, 3) [m]; depth (S,) [m]; ray (S,) and frame (S,) int64; rays (R, 2) int32: first sample, number."""

    place: torch.Tensor
    depth: torch.Tensor
    ray: torch.Tensor
    frame: torch.Tensor
    rays: torch.Tensor


def march(
    occupancy: Occupancy, start: torch.Tensor, direction: torch.Tensor, frame: torch.Tensor, *, step: float,
    shift: torch.Tensor | None = None, since: torch.Tensor | None = None, until: torch.Tensor | None = None,
) -> Samples:  # fmt: skip
    """Samples every `step` [m] along rays from `start` (R, 3) [m] in unit `direction` (R, 3) in frames (R,), kept where
    the frame's cell is occupied.

    shift (R,): where in the first step a ray's samples begin, 0 to 1; default the middle. since and until (R,) [m]:
    where rays begin and end, such as on something opaque that stands in the field.
    """
    given, rays = _counted(occupancy, start, direction, frame, step, shift, since, until)
    rays[:, 0] = torch.cumsum(rays[:, 1], 0) - rays[:, 1]
    total = int(rays[-1].sum()) if len(rays) else 0
    place, depth, ray = start.new_zeros(total, 3), start.new_zeros(total), rays.new_zeros(total)
    if total:
        _write(*given, occupancy.spacing, step, rays, place, depth, ray)
    ray = ray.long()
    return Samples(place=place, depth=depth, ray=ray, frame=frame.long()[ray], rays=rays)


def meets(occupancy: Occupancy, start: torch.Tensor, direction: torch.Tensor, frame: torch.Tensor) -> torch.Tensor:
    """Which rays (R,) bool, as those of `march`, come by an occupied cell, looked at once in a cell's length."""
    return _counted(occupancy, start, direction, frame, occupancy.spacing, None, None, None)[1][:, 1] > 0


def _counted(
    occupancy: Occupancy, start: torch.Tensor, direction: torch.Tensor, frame: torch.Tensor, step: float,
    shift: torch.Tensor | None, since: torch.Tensor | None, until: torch.Tensor | None,
) -> tuple[tuple[torch.Tensor, ...], torch.Tensor]:  # fmt: skip
    """What the kernels take, and rays (R, 2) int32 with the number of samples of each."""
    ensure()
    shift = start.new_full((len(start),), 0.5) if shift is None else shift
    since = start.new_zeros(len(start)) if since is None else since
    until = start.new_full((len(start),), torch.inf) if until is None else until
    given = start, direction, frame.to(torch.int32), shift, since, until, occupancy.cells
    given = tuple(v.contiguous() for v in (*given, occupancy.origin.to(torch.float32)))
    rays = torch.zeros(len(start), 2, dtype=torch.int32, device=start.device)
    _count(*given, occupancy.spacing, step, rays)
    return given, rays


@ti.func
def _span(o: triple, d: triple, low: triple, high: triple):
    """Where a ray enters and leaves a box, [m]; the first is the larger where it misses."""
    near, far = ti.cast(0, ti.f32), ti.cast(1e9, ti.f32)
    for a in ti.static(range(3)):
        slope = d[a]
        if ti.abs(slope) < ti.cast(1e-9, ti.f32):
            slope = ti.cast(1e-9, ti.f32)
        one, other = (low[a] - o[a]) / slope, (high[a] - o[a]) / slope
        near, far = ti.max(near, ti.min(one, other)), ti.min(far, ti.max(one, other))
    return near, far


@ti.func
def cell_of(cells: ti.template(), place: triple, low: triple, spacing: ti.f32):
    """The cell of the grid that holds a place, or is nearest to it."""
    at = ti.cast((place - low) / spacing, ti.i32)
    for a in ti.static(range(3)):
        at[a] = ti.min(ti.max(at[a], 0), cells.shape[a + 1] - 1)
    return at


@ti.func
def _occupied(cells: ti.template(), frame, place: triple, low: triple, spacing: ti.f32):
    at = cell_of(cells, place, low, spacing)
    return cells[frame, at[0], at[1], at[2]] != 0


@ti.func
def _triple(values: ti.template(), r):
    return triple(values[r, 0], values[r, 1], values[r, 2])


@ti.func
def ray_in_box(
    start: ti.template(), direction: ti.template(), since: ti.template(), until: ti.template(), cells: ti.template(),
    origin: ti.template(), spacing: ti.f32, r,
):  # fmt: skip
    """Where ray r starts, its direction, the grid's lowest corner, and the depths at which it begins and ends in it."""
    o, d = _triple(start, r), _triple(direction, r)
    low = triple(origin[0], origin[1], origin[2])
    near, far = _span(o, d, low, low + spacing * triple(cells.shape[1], cells.shape[2], cells.shape[3]))
    return o, d, low, ti.max(near, since[r]), ti.min(far, until[r])


@ti.kernel
def _count(
    start: Reals2, direction: Reals2, frame: Numbers1, shift: Reals1, since: Reals1, until: Reals1, cells: Bytes4,
    origin: Reals1, spacing: ti.f32, step: ti.f32, rays: Numbers2,
):  # fmt: skip
    for r in range(start.shape[0]):
        o, d, low, near, far = ray_in_box(start, direction, since, until, cells, origin, spacing, r)
        found, i = 0, 0
        depth = near + shift[r] * step
        while depth < far:
            if _occupied(cells, frame[r], o + depth * d, low, spacing):
                found += 1
            i += 1
            depth = near + (shift[r] + ti.cast(i, ti.f32)) * step
        rays[r, 1] = found


@ti.kernel
def _write(
    start: Reals2, direction: Reals2, frame: Numbers1, shift: Reals1, since: Reals1, until: Reals1, cells: Bytes4,
    origin: Reals1, spacing: ti.f32, step: ti.f32, rays: Numbers2, place: Reals2, depths: Reals1, ray: Numbers1,
):  # fmt: skip
    # Compiled apart, the two kernels may round a depth differently: no more samples are written than were counted, and
    # what would be missing is put where the ray leaves the box.
    for r in range(start.shape[0]):
        o, d, low, near, far = ray_in_box(start, direction, since, until, cells, origin, spacing, r)
        n, end, i = rays[r, 0], rays[r, 0] + rays[r, 1], 0
        depth = near + shift[r] * step
        while n < end:
            at = o + ti.min(depth, far) * d
            if depth >= far or _occupied(cells, frame[r], at, low, spacing):
                for a in ti.static(range(3)):
                    place[n, a] = at[a]
                depths[n], ray[n] = ti.min(depth, far), r
                n += 1
            i += 1
            depth = near + (shift[r] + ti.cast(i, ti.f32)) * step
