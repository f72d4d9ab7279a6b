"""Where rays may end: samples behind what is opaque already cost as much as others and teach nothing."""

from collections.abc import Sequence
from dataclasses import dataclass

import taichi as ti
import torch

from recon.radiance.fields import Field
from recon.radiance.marching import Numbers1, Occupancy, Reals1, Reals2, cell_of, ray_in_box
from sim.runtime import ensure

_COARSER = 2  # cells of the occupancy along a side of one of these
_LIMIT = 8.0  # optical thickness behind which nothing is seen: exp(-8) of the light passes
_TRUST = 0.5  # share of the density found in a cell's middle that is counted
_BEYOND = 2.0  # cells that rays go on behind that
_PART = 1 << 17  # places at a time
Reals4 = ti.types.ndarray(dtype=ti.f32, ndim=4)


@dataclass(frozen=True, kw_only=True, eq=False)
class Stops:
    """How dense each frame was when last looked at: density (T, X, Y, Z) f32 [1/m] over the occupancy's box, in cells
    twice as large; zero where nobody looked yet."""

    occupied: torch.Tensor  # (T, X, Y, Z) bool
    density: torch.Tensor
    origin: torch.Tensor
    spacing: float

    @classmethod
    def of(cls, occupancy: Occupancy) -> "Stops":
        """Nothing is opaque yet."""
        cells = occupancy.cells.to(torch.float32)
        occupied = torch.nn.functional.max_pool3d(cells, _COARSER, ceil_mode=True) > 0
        origin = occupancy.origin.to(torch.float32).contiguous()
        return cls(occupied=occupied, density=torch.zeros(occupied.shape), origin=origin,
                   spacing=_COARSER * occupancy.spacing)  # fmt: skip

    @torch.no_grad()
    def look(self, field: Field, frames: Sequence[int]) -> None:
        """Ask the field for the density in the middles of these frames' occupied cells."""
        for frame in frames:
            cell = torch.nonzero(self.occupied[frame])
            for some in cell.split(_PART):
                places = self.origin + (some + 0.5) * self.spacing
                found, _ = field(places, torch.full((len(some),), frame))
                self.density[frame, some[:, 0], some[:, 1], some[:, 2]] = found

    def until(self, start: torch.Tensor, direction: torch.Tensor, frame: torch.Tensor) -> torch.Tensor:
        """Depth [m], (R,), at which rays from start (R, 3) in unit direction (R, 3) in frames (R,) may end; infinite
        where they meet nothing opaque."""
        ensure()
        until = torch.full((len(start),), torch.inf)
        _thicken(start.contiguous(), direction.contiguous(), frame.to(torch.int32), until, self.density, self.origin,
                 self.spacing)  # fmt: skip
        return until


@ti.kernel
def _thicken(
    start: Reals2, direction: Reals2, frame: Numbers1, until: Reals1, density: Reals4, origin: Reals1, spacing: ti.f32
):
    step = spacing / 2
    for r in range(start.shape[0]):
        o, d, low, near, far = ray_in_box(start, direction, until, density, origin, spacing, r)
        thickness, depth = ti.cast(0, ti.f32), near + step / 2
        while depth < far:
            at = cell_of(density, o + depth * d, low, spacing)
            thickness += ti.cast(_TRUST, ti.f32) * step * density[frame[r], at[0], at[1], at[2]]
            if thickness > ti.cast(_LIMIT, ti.f32):
                until[r] = depth + ti.cast(_BEYOND, ti.f32) * spacing
                far = depth
            depth += step
