"""Where rays may begin and end: before all that may be something, and behind what is opaque, samples teach nothing."""

from collections.abc import Sequence
from dataclasses import dataclass

import taichi as ti
import torch

from recon.radiance.fields import Field
from recon.radiance.marching import Bytes4, Numbers1, Occupancy, Reals1, Reals2, cell_of, ray_in_box
from sim.runtime import ensure

_COARSER = 2  # cells of the occupancy along a side of one of these, where there are several frames to look at
_LIMIT = 8.0  # optical thickness behind which nothing is seen: exp(-8) of the light passes
_TRUST = 0.5  # share of the density found in a cell's middle that is counted
_BEYOND = 2.0  # cells that rays go on behind that
_PART = 1 << 17  # places at a time
Reals4 = ti.types.ndarray(dtype=ti.f32, ndim=4)


@dataclass(frozen=True, kw_only=True, eq=False)
class Stops:
    """How dense each frame was when last looked at: density (T, X, Y, Z) f32 [1/m] over the occupancy, in its cells
    where it has one frame, else in cells twice as large; zero where nobody looked yet."""

    occupied: torch.Tensor  # (T, X, Y, Z) uint8
    density: torch.Tensor
    origin: torch.Tensor
    spacing: float

    @classmethod
    def of(cls, occupancy: Occupancy) -> "Stops":
        """Nothing is opaque yet."""
        cells = occupancy.cells.to(torch.float32)
        coarser = _COARSER if len(cells) > 1 else 1
        occupied = (torch.nn.functional.max_pool3d(cells, coarser, ceil_mode=True) > 0).to(torch.uint8)
        origin = occupancy.origin.to(torch.float32).contiguous()
        return cls(occupied=occupied, density=cells.new_zeros(occupied.shape), origin=origin,
                   spacing=coarser * occupancy.spacing)  # fmt: skip

    @torch.no_grad()
    def look(self, field: Field, frames: Sequence[int]) -> None:
        """Ask the field for the density in the middles of these frames' occupied cells."""
        for frame in frames:
            cell = torch.nonzero(self.occupied[frame])
            for some in cell.split(_PART):
                places = self.origin + (some + 0.5) * self.spacing
                found, _ = field(places, torch.full((len(some),), frame, device=some.device))
                self.density[frame, some[:, 0], some[:, 1], some[:, 2]] = found

    def span(
        self, start: torch.Tensor, direction: torch.Tensor, frame: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Depths [m], (R,) each, at which rays from start (R, 3) in unit direction (R, 3) in frames (R,) may begin and
        end: around the occupied cells that they meet, and no further than a little behind what is opaque."""
        ensure()
        span = start.new_zeros(len(start)), start.new_full((len(start),), torch.inf)
        _spans(start.contiguous(), direction.contiguous(), frame.to(torch.int32), *span, self.occupied, self.density,
               self.origin, self.spacing)  # fmt: skip
        return span


@ti.kernel
def _spans(
    start: Reals2, direction: Reals2, frame: Numbers1, since: Reals1, until: Reals1, occupied: Bytes4, density: Reals4,
    origin: Reals1, spacing: ti.f32,
):  # fmt: skip
    step = spacing / 2
    for r in range(start.shape[0]):
        o, d, low, near, far = ray_in_box(start, direction, since, until, occupied, origin, spacing, r)
        thickness, depth = ti.cast(0, ti.f32), near + step / 2
        first, last = far, near
        while depth < far:
            at = cell_of(density, o + depth * d, low, spacing)
            if occupied[frame[r], at[0], at[1], at[2]] != 0:
                first, last = ti.min(first, depth - step), depth + step
            thickness += ti.cast(_TRUST, ti.f32) * step * density[frame[r], at[0], at[1], at[2]]
            if thickness > ti.cast(_LIMIT, ti.f32):
                last = ti.min(far, depth + ti.cast(_BEYOND, ti.f32) * spacing)
                far = depth
            depth += step
        since[r], until[r] = first, last
