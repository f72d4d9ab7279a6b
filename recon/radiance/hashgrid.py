"""Multiresolution hash grid in Taichi, with its derivative in the place as well (Mueller et al. 2022, section 3).

Rays are bent before they meet the canonical field, so a loss must reach the bending through the encoding's place.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import taichi as ti
import torch

from recon.radiance.precision import arrays_of, real_of
from sim.checks import require
from sim.runtime import ensure

FEATURES = 2  # numbers a table entry holds
_BLOCK = 512  # turns of a loop that Taichi gives to one thread at once, whatever `block_dim` says
_PRIMES = (2654435761, 805459861)  # of the hash; the first coordinate has one


@dataclass(frozen=True, kw_only=True)
class HashGrid:
    """Levels from `coarsest` to `finest` cells along a side, geometrically spaced; tables of at most 2**log2_table."""

    levels: int = 8
    coarsest: int = 16
    finest: int = 240
    log2_table: int = 15

    def __post_init__(self) -> None:
        fits = self.levels >= 1 and 1 <= self.coarsest <= self.finest and 4 <= self.log2_table <= 24
        require(fits, "hash grid", "have levels, rising resolutions and tables of 2**4 to 2**24", self)

    @cached_property
    def layout(self) -> np.ndarray:
        """(L, 3) int: cells along a side, first entry in the table, whether every corner has an entry of its own."""
        growth = (self.finest / self.coarsest) ** (1 / max(self.levels - 1, 1))
        rows, first = [], 0
        for level in range(self.levels):
            cells = round(self.coarsest * growth**level)
            dense = (cells + 1) ** 3 <= 2**self.log2_table
            rows.append((cells, first, dense))
            first += (cells + 1) ** 3 if dense else 2**self.log2_table
        return np.array(rows, np.int32)

    @property
    def entries(self) -> int:
        """Rows of the table."""
        cells, first, dense = self.layout[-1].tolist()
        return first + ((cells + 1) ** 3 if dense else 2**self.log2_table)

    @property
    def width(self) -> int:
        """Numbers that encode one place."""
        return FEATURES * self.levels


class HashEncoding(torch.nn.Module):
    """Places (N, 3) in the unit cube to (N, width) features; places outside are moved to its border.

    `level_weight` (L,) scales the derivative in the place, not the features: at zero a level is seen but does not pull
    at the bending, as fine levels must not while the motion is still far off.
    """

    def __init__(self, grid: HashGrid, *, seed: int = 0, dtype: torch.dtype = torch.float32) -> None:
        super().__init__()
        ensure()
        self.grid = grid
        start = torch.rand(grid.entries, FEATURES, generator=torch.Generator().manual_seed(seed), dtype=dtype)
        self.table = torch.nn.Parameter(1e-2 * (2 * start - 1))
        self.register_buffer("layout", torch.from_numpy(grid.layout), persistent=False)
        self.register_buffer("level_weight", torch.ones(grid.levels, dtype=dtype), persistent=False)

    def forward(self, places: torch.Tensor) -> torch.Tensor:
        """Trilinear interpolation of every level's corners."""
        return _Encode.apply(places, self.table, self.layout, self.level_weight)


class _Encode(torch.autograd.Function):
    @staticmethod
    def forward(ctx, places, table, layout, level_weight):
        places, table = places.detach().contiguous(), table.detach()
        out = places.new_empty(len(places), len(layout), FEATURES)
        kernels_of(places.dtype).encode(places, table, layout, 2 ** _log2_table(table, layout) - 1, out)
        ctx.save_for_backward(places, table, layout, level_weight)
        return out.flatten(1)

    @staticmethod
    def backward(ctx, pulled):
        places, table, layout, level_weight = (v.detach() for v in ctx.saved_tensors)
        kernels, mask = kernels_of(places.dtype), 2 ** _log2_table(table, layout) - 1
        pulled = pulled.contiguous().view(len(places), len(layout), FEATURES)
        by_place = by_table = None
        if ctx.needs_input_grad[0]:
            by_place = torch.empty_like(places)
            kernels.place_gradient(places, table, layout, level_weight, mask, pulled, by_place)
        if ctx.needs_input_grad[1]:
            by_table = torch.zeros_like(table)
            add = kernels.table_gradient_at_once if places.is_cuda else kernels.table_gradient
            add(places, layout, mask, pulled, by_table)
        return by_place, by_table, None, None


def _log2_table(table: torch.Tensor, layout: torch.Tensor) -> int:
    """Of the hashed levels, the last of which ends the table; any number where there is none."""
    return max(int(len(table) - layout[-1, 1]).bit_length() - 1, 0)


@dataclass(frozen=True, kw_only=True)
class _Kernels:
    encode: object
    place_gradient: object
    table_gradient: object
    table_gradient_at_once: object


@cache
def kernels_of(dtype: torch.dtype) -> _Kernels:
    """The kernels in one precision. Places and a table's rows are vectors, which are loaded at once."""
    real = real_of(dtype)
    Reals1, Layout = arrays_of(real)[0], ti.types.ndarray(dtype=ti.i32, ndim=2)
    row, triple = ti.types.vector(FEATURES, real), ti.types.vector(3, real)
    Places, Table = (ti.types.ndarray(dtype=v, ndim=1) for v in (triple, row))
    Features = ti.types.ndarray(dtype=row, ndim=2)

    @ti.func
    def cell(place, cells):
        """The place's cell and where in it the place lies, in cells."""
        p = ti.min(ti.max(place, ti.cast(0, real)), ti.cast(0.999999, real)) * ti.cast(cells, real)
        corner = ti.cast(p, ti.i32)
        return corner, p - ti.cast(corner, real)

    @ti.func
    def entries(cells, first, dense, corner, mask):
        """The rows (8,) of the table for a cell's corners, the first coordinate's changing fastest."""
        x, y, z = ti.cast(corner[0], ti.u32), ti.cast(corner[1], ti.u32), ti.cast(corner[2], ti.u32)
        rows = ti.Vector.zero(ti.i32, 8)
        if dense != 0:
            stride = ti.cast(cells + 1, ti.u32)
            lowest = x + stride * (y + stride * z)
            for c in ti.static(range(8)):
                upper = ti.u32(c & 1) + stride * (ti.u32((c >> 1) & 1) + stride * ti.u32((c >> 2) & 1))
                rows[c] = first + ti.cast(lowest + upper, ti.i32)
        else:
            y, z = y * ti.u32(_PRIMES[0]), z * ti.u32(_PRIMES[1])
            for c in ti.static(range(8)):
                upper_y, upper_z = ti.u32(_PRIMES[0] * ((c >> 1) & 1)), ti.u32(_PRIMES[1] * ((c >> 2) & 1))
                hashed = (x + ti.u32(c & 1)) ^ (y + upper_y) ^ (z + upper_z)
                rows[c] = first + ti.cast(hashed & ti.cast(mask, ti.u32), ti.i32)
        return rows

    @ti.func
    def share(inside, a: ti.template(), upper: ti.template()):
        return inside[a] if ti.static(upper) else 1 - inside[a]

    @ti.kernel
    def encode(places: Places, table: Table, layout: Layout, mask: ti.i32, out: Features):
        for n in range(places.shape[0]):
            place = places[n]
            for level in range(layout.shape[0]):
                cells, first, dense = layout[level, 0], layout[level, 1], layout[level, 2]
                corner, inside = cell(place, cells)
                rows, total = entries(cells, first, dense, corner, mask), row(0)
                for c in ti.static((0, 2, 4, 6)):
                    edge = share(inside, 0, 0) * table[rows[c]] + inside[0] * table[rows[c + 1]]
                    total += share(inside, 1, c & 2) * share(inside, 2, c & 4) * edge
                out[n, level] = total

    @ti.kernel
    def place_gradient(
        places: Places, table: Table, layout: Layout, level_weight: Reals1, mask: ti.i32, pulled: Features, out: Places
    ):
        for n in range(places.shape[0]):
            place, total = places[n], triple(0)
            for level in range(layout.shape[0]):
                cells, first, dense = layout[level, 0], layout[level, 1], layout[level, 2]
                corner, inside = cell(place, cells)
                rows, pull, slope = entries(cells, first, dense, corner, mask), pulled[n, level], triple(0)
                for c in ti.static((0, 2, 4, 6)):
                    y, z = share(inside, 1, c & 2), share(inside, 2, c & 4)
                    lower, upper = table[rows[c]].dot(pull), table[rows[c + 1]].dot(pull)
                    between = share(inside, 0, 0) * lower + inside[0] * upper
                    slope[0] += (upper - lower) * y * z
                    slope[1] += (1 if ti.static(c & 2) else -1) * between * z
                    slope[2] += (1 if ti.static(c & 4) else -1) * between * y
                total += ti.cast(cells, real) * level_weight[level] * slope
            for a in ti.static(range(3)):
                beyond = place[a] < 0 or place[a] > ti.cast(0.999999, real)
                out[n][a] = ti.cast(0, real) if beyond else total[a]

    @ti.func
    def add(cells, first, dense, mask, place, pull, out: ti.template(), atomic: ti.template()):
        corner, inside = cell(place, cells)
        rows = entries(cells, first, dense, corner, mask)
        for c in ti.static(range(8)):
            weight = share(inside, 0, c & 1) * (share(inside, 1, c & 2) * share(inside, 2, c & 4))
            if ti.static(atomic):
                out[rows[c]] += weight * pull
            else:
                out[rows[c]] = out[rows[c]] + weight * pull

    @ti.func
    def add_level(
        level, places: ti.template(), layout: ti.template(), mask, pulled: ti.template(), out: ti.template()
    ):  # fmt: skip
        cells, first, dense = layout[level, 0], layout[level, 1], layout[level, 2]
        for n in range(places.shape[0]):
            add(cells, first, dense, mask, places[n], pulled[n, level], out, False)

    @ti.kernel
    def table_gradient(places: Places, layout: Layout, mask: ti.i32, pulled: Features, out: Table):
        # One level in one thread: no two threads add to the same entry, and the order of additions is always the same.
        for turn in range(_BLOCK * layout.shape[0]):
            if turn % _BLOCK == 0:
                add_level(turn // _BLOCK, places, layout, mask, pulled, out)

    @ti.kernel
    def table_gradient_at_once(places: Places, layout: Layout, mask: ti.i32, pulled: Features, out: Table):
        # For a GPU, which one thread a level would leave idle; the order of additions is another one every time.
        for n, level in ti.ndrange(places.shape[0], layout.shape[0]):
            cells, first, dense = layout[level, 0], layout[level, 1], layout[level, 2]
            add(cells, first, dense, mask, places[n], pulled[n, level], out, True)

    return _Kernels(
        encode=encode, place_gradient=place_gradient, table_gradient=table_gradient,
        table_gradient_at_once=table_gradient_at_once,
    )  # fmt: skip
