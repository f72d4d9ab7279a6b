"""Random soft bodies: blocks of a lattice, rounded and bent, with a mesh to compute on and another one that is seen.

A point is drawn in lattice coordinates (block numbers, real) and warped to metres; x, y, z with z the long axis.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from skfem import ElementHex2, MeshHex

from blind.body import Body

NAMES = ("beam", "pillow", "L", "T", "plush")
JITTER = 0.2  # of the seen points, in their spacing
SIZES = {"tiny": (200, 450), "small": (600, 1200), "full": (1330, 2500)}  # seen points, nodes of the computation
Array = np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class Shape:
    """Blocks of the lattice, their lengths, and the warp from plain boxes to the final outline."""

    name: str
    lengths: tuple[Array, Array, Array]  # [m] of the intervals along x, y, z
    filled: Array  # (nx, ny, nz) bool
    clamp: int  # the axis whose plane 0 is held
    warp: Callable[[Array], Array]  # (M, 3) [m] -> (M, 3) [m]

    def lines(self, h: float) -> tuple[Array, Array, Array]:
        """Grid lines in lattice coordinates, about h [m] apart; two cells at least where there is one block only."""
        return tuple(
            np.concatenate([[0.0], *(i + np.arange(1, n + 1) / n for i, n in enumerate(
                max(2 if len(lengths) == 1 else 1, round(a / h)) for a in lengths))])
            for lengths in self.lengths
        )  # fmt: skip

    def grid(self, lines: tuple[Array, Array, Array]) -> MeshHex:
        """The filled cells of a grid, in lattice coordinates."""
        mesh = MeshHex.init_tensor(*lines)
        block = np.floor(mesh.p[:, mesh.t].mean(axis=1)).astype(int)
        return mesh.restrict(np.flatnonzero(self.filled[tuple(block)])).remove_unused_nodes()

    def place(self, lattice: Array) -> Array:
        """Lattice coordinates (M, 3) to metres."""
        ends = [np.concatenate([[0], np.cumsum(a)]) for a in self.lengths]
        plain = [np.interp(lattice[:, i], np.arange(len(e)), e) for i, e in enumerate(ends)]
        middle = [ends[0][-1] / 2, ends[1][-1] / 2, 0]
        return self.warp(np.stack(plain, axis=1) - middle)

    def spacing_for(self, count: int, split: int) -> float:
        """The cell size [m] whose grid, each cell split so often, has about `count` vertices."""
        sizes = np.geomspace(0.06, 0.004, 60)
        counts = [self.grid(tuple(refined(a, split) for a in self.lines(h))).p.shape[1] for h in sizes if (
            np.prod([len(refined(a, split)) for a in self.lines(h)]) < 20 * count)]  # fmt: skip
        return float(sizes[np.abs(np.log(np.array(counts) / count)).argmin()])


def refined(lines: Array, split: int) -> Array:
    """Grid lines with each interval cut into so many."""
    return np.interp(np.arange(split * (len(lines) - 1) + 1) / split, np.arange(len(lines)), lines)


def draw_shape(rng: np.random.Generator) -> Shape:
    """One of `NAMES` with random proportions."""
    u, name = rng.uniform, NAMES[rng.integers(len(NAMES))]
    depth = [u(0.045, 0.075)]
    if name == "beam":
        lengths, filled = ([u(0.045, 0.075)], depth, [u(0.18, 0.28)]), np.ones((1, 1, 1), bool)
    elif name == "pillow":
        lengths, filled = ([u(0.13, 0.2)], [u(0.05, 0.07)], [u(0.15, 0.22)]), np.ones((1, 1, 1), bool)
    elif name == "L":
        lengths = ([u(0.045, 0.065), u(0.07, 0.12)], depth, [u(0.09, 0.15), u(0.045, 0.065)])
        filled = np.array([[1, 1], [0, 1]], bool)[:, None]
    elif name == "T":
        lengths = ([u(0.05, 0.08), u(0.045, 0.065), u(0.05, 0.08)], depth, [u(0.09, 0.15), u(0.045, 0.06)])
        filled = np.array([[0, 1], [1, 1], [0, 1]], bool)[:, None]
    else:
        side, ear, gap = u(0.015, 0.025), u(0.035, 0.045), u(0.02, 0.035)
        lengths = ([side, ear, gap, ear, side], [u(0.06, 0.08)], [u(0.07, 0.1), u(0.05, 0.07), u(0.06, 0.08)])
        filled = np.array([[1, 0, 0], [1, 1, 1], [1, 1, 0], [1, 1, 1], [1, 0, 0]], bool)[:, None]
    lengths = tuple(np.array(a) for a in lengths)
    return Shape(name=name, lengths=lengths, filled=filled, clamp=2, warp=_draw_warp(rng, name, lengths))


def _draw_warp(rng: np.random.Generator, name: str, lengths: tuple[Array, ...]) -> Callable[[Array], Array]:
    """Rounded cross-sections, a taper, a bend, and a turn of the whole."""
    X, Y, Z = (a.sum() for a in lengths)
    roundness, taper, bend = rng.uniform(0, 0.3), rng.uniform(-0.15, 0.1), rng.uniform(-0.15, 0.15)
    lying = name in ("beam", "pillow") and rng.random() < 0.5
    turn = Rotation.from_euler("zy", [rng.uniform(-180, 180), 90 if lying else 0], degrees=True)

    def warp(p: Array) -> Array:
        x, y, z = p.T
        narrow = 1 + taper * z / Z
        if name == "pillow":
            y = y * (1 - roundness * (2 * x / X) ** 2) * (1 - roundness * (z / Z) ** 2)
        else:
            x, y = x * np.sqrt(1 - roundness * (2 * y / Y) ** 2), y * np.sqrt(1 - roundness * (2 * x / X) ** 2)
        return turn.apply(np.stack([x * narrow + bend * z**2 / Z, y * narrow, z], axis=1))

    return warp


@dataclass(frozen=True, kw_only=True, eq=False)
class Built:
    """A shape on its two meshes."""

    shape: Shape
    body: Body
    lattice: Array  # (N, 3) lattice coordinates of the body's nodes
    cells: Array  # (8, hexahedra) of the seen points
    fixed: Array  # (M,) bool, of the seen points
    surface: Array  # (M,) bool
    spacing: float  # [m] of the seen points
    axis: Array  # (3,) the long axis, away from the clamp
    size: float  # [m] longest side

    def seen_mesh(self, x: Array) -> MeshHex:
        """The seen points as a mesh, at positions (M, 3)."""
        return MeshHex(np.ascontiguousarray(x.T), self.cells)


def build(rng: np.random.Generator, shape: Shape, size: str) -> Built:
    """Mesh the shape and choose what is seen: vertices of another, jittered grid inside the computed geometry."""
    seen_count, node_count = SIZES[size]
    h = shape.spacing_for(seen_count, 1)
    lines = shape.lines(shape.spacing_for(node_count, 2))
    grid, seen = shape.grid(lines), shape.grid(shape.lines(h))
    lattice = _jittered(rng, seen.p.T, shape.lines(h))
    cell, values = _located(grid, lines, lattice)
    fixed = np.isclose(grid.p[shape.clamp], 0)
    body = Body.of(MeshHex(np.ascontiguousarray(shape.place(grid.p.T).T), grid.t), fixed, cell, values)
    ends = shape.place(np.array([[n / 2 for n in shape.filled.shape]] * 2) * [[1, 1, 0], [1, 1, 2]])
    outer = np.zeros(seen.p.shape[1], bool)
    outer[seen.boundary_nodes()] = True
    return Built(
        shape=shape, body=body, lattice=Body.of(grid, fixed, cell, values).nodes, cells=seen.t,
        fixed=np.isclose(seen.p[shape.clamp], 0), surface=outer, spacing=h,
        axis=(ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0]),
        size=float(np.ptp(body.nodes, axis=0).max()),
    )  # fmt: skip


def _jittered(rng: np.random.Generator, p: Array, lines: tuple[Array, Array, Array]) -> Array:
    """Every vertex moved along the axes on which it does not lie on a plane between blocks."""
    out = p.copy()
    for i, line in enumerate(lines):
        free = ~np.isclose(p[:, i], np.round(p[:, i]))
        step = np.diff(line)[np.minimum(np.searchsorted(line, p[:, i] - 1e-9), len(line) - 2)]
        out[:, i] += free * JITTER * step * rng.uniform(-1, 1, len(p))
    return out


def _located(grid: MeshHex, lines: tuple[Array, Array, Array], p: Array) -> tuple[Array, Array]:
    """The cell of each point (M,) and the quadratic shape functions there (M, 27)."""
    corner = np.stack([np.searchsorted(line, x) - 1 for line, x in zip(
        lines, grid.p[:, grid.t].mean(axis=1), strict=True)], axis=1)  # fmt: skip
    number = {tuple(c): i for i, c in enumerate(corner)}
    sides = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T * 1e-9
    around = [[tuple(np.searchsorted(line, q + s) - 1 for line, q, s in zip(lines, point, side, strict=True))
               for side in sides] for point in p]  # fmt: skip
    cell = np.array([next(number[c] for c in options if c in number) for options in around])
    local = grid.mapping().invF(p.T[:, :, None], tind=cell)[:, :, 0]
    element = ElementHex2()
    values = np.stack([np.broadcast_to(element.lbasis(local, a)[0], len(p)) for a in range(27)], axis=1)
    return cell, values
