"""What is on the stage beside the object: the nozzle with its marker, and the lines that pull."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from recon.nozzle.path import MARKER
from recon.plush.reconstruction import MM, NOZZLE_IN_MARKER
from recon.rig.light import plain_light

TUBE, LENGTH = 0.005, 0.16  # [m] radius and length of the nozzle's tube
POST = 0.004  # [m] radius of what carries the marker
PLATE = 0.034  # [m] half the plate's side; the marker's paper is smaller
LINE = 0.00022  # [m] radius of the fishing line
PLASTIC, BLACK, NYLON = 0.020, 0.010, 0.10  # reflectance
PAPER, INK = 0.80, 0.025
CELL = 48  # pixels a cell of the marker's picture


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """Small triangles with colours at their vertices, or places in the marker's picture instead."""

    points: np.ndarray  # (V, 3) [m]
    triangles: np.ndarray  # (M, 3)
    colour: np.ndarray  # (V,) reflectance
    place: np.ndarray  # (V, 2) in the marker's picture, -1..1 from edge to edge, NaN beside it
    light: np.ndarray  # (V, 3)


def nozzle(T_stage_marker: np.ndarray) -> Mesh:
    """The tube, the post and the plate with the marker on it, at a pose (4, 4)."""
    source = MM * NOZZLE_IN_MARKER
    back, foot, end = np.array([[0, 0, LENGTH], [0, -0.004, 0.004], [0, 0, -0.010]])
    parts = [
        _rod(source, source + back, TUBE, PLASTIC, rings=44),
        _rod(source + foot, end, POST, PLASTIC, rings=24),
        _plate(),
    ]
    whole = together(parts)
    R = T_stage_marker[:3, :3]
    points = whole.points @ R.T + T_stage_marker[:3, 3]
    return Mesh(points=points, triangles=whole.triangles, colour=whole.colour, place=whole.place,
                light=plain_light(whole.light @ R.T))  # fmt: skip


def line(start: np.ndarray, end: np.ndarray) -> Mesh:
    """A fishing line from the object to where it is pulled, on the stage [m]."""
    rod = _rod(start, end, LINE, NYLON, rings=120, sides=4)
    return Mesh(points=rod.points, triangles=rod.triangles, colour=rod.colour, place=rod.place,
                light=plain_light(rod.light))  # fmt: skip


def together(parts: list[Mesh]) -> Mesh:
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(part.points) for part in parts)])[:-1]
    return Mesh(
        triangles=np.concatenate([p.triangles + s for p, s in zip(parts, starts, strict=True)]),
        **{name: np.concatenate([getattr(p, name) for p in parts]) for name in ("points", "colour", "place", "light")},
    )


def reflectance(mesh: Mesh, corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Of samples (M,) given by vertex numbers (M, 3) and weights (M, 3); the marker's where there is one."""
    out = (mesh.colour[corners] * weights).sum(axis=1)
    place = np.einsum("mkj,mk->mj", mesh.place[corners], weights)
    on = (np.abs(place) <= 1).all(axis=1)
    picture = _marker_picture()
    at = np.clip((place[on] * [1, -1] + 1) / 2 * len(picture), 0, len(picture) - 1).astype(int)
    out[on] = picture[at[:, 1], at[:, 0]]
    return out


@lru_cache(maxsize=1)
def _marker_picture() -> np.ndarray:
    """The paper's reflectance, its margin included."""
    return np.where(MARKER.print(CELL) > 127, PAPER, INK)


def paper_half() -> float:
    """Half the side of the marker's paper, its white margin included [m]."""
    return MARKER.side / 2 * (MARKER.cells + 2) / MARKER.cells


def _plate() -> Mesh:
    """A square facing z, the paper on its front, in pieces that the lens may bend; a black back just behind."""
    half = paper_half()
    ticks = np.unique(np.concatenate([np.linspace(-half, half, 17), [-PLATE, PLATE]]))
    grid = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    n = len(ticks)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    triangles = np.concatenate([np.stack([corner, corner + 1, corner + n + 1], 1),
                                np.stack([corner, corner + n + 1, corner + n], 1)])  # fmt: skip
    front = np.concatenate([grid, np.zeros((len(grid), 1))], axis=1)
    back = front - [0, 0, 0.0015]
    up = np.tile([0.0, 0, 1], (len(grid), 1))
    place = np.concatenate([grid / half * (1 - 1e-9), np.full((len(grid), 2), np.nan)])
    triangles = np.concatenate([triangles, triangles[:, ::-1] + len(grid)])
    return Mesh(points=np.concatenate([front, back]), triangles=triangles, colour=np.full(2 * len(grid), BLACK),
                place=place, light=np.concatenate([up, -up]))  # fmt: skip


def _rod(start: np.ndarray, end: np.ndarray, radius: float, colour: float, *, rings: int, sides: int = 10) -> Mesh:
    """A closed tube; `light` holds its normals until it is lit."""
    way = (end - start) / np.linalg.norm(end - start)
    across = np.cross(way, np.eye(3)[np.abs(way).argmin()])
    across /= np.linalg.norm(across)
    angle = 2 * np.pi * np.arange(sides) / sides
    around = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(way, across)
    centre = start + np.linspace(0, 1, rings + 1)[:, None] * (end - start)
    points = (centre[:, None] + radius * around).reshape(-1, 3)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(rings), np.arange(sides), indexing="ij"))
    a, b = i * sides + j, i * sides + (j + 1) % sides
    triangles = np.concatenate([np.stack([a, b, b + sides], 1), np.stack([a, b + sides, a + sides], 1)])
    caps = [np.stack([np.full(sides - 2, k), k + np.arange(1, sides - 1), k + np.arange(2, sides)], 1)
            for k in (0, rings * sides)]  # fmt: skip
    return Mesh(points=points, triangles=np.concatenate([triangles, *caps]), colour=np.full(len(points), colour),
                place=np.full((len(points), 2), np.nan), light=np.tile(around, (rings + 1, 1)))  # fmt: skip
