"""Pictures of a recording: what every camera sees, where it stands, the nozzle's way, and who is out of step."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyvista as pv
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from recon.cameras import Camera
from recon.hull import Hull
from recon.plush.reconstruction import NozzlePath
from recon.sync import Sync
from sim.checks import require
from veo_ti.plots import INK, MODEL, PAPER, PLAIN, REST, saved
from veo_ti.stage import ARROW, Colours, add_spheres, limits_of, set_up, write
from veo_ti.view import save_picture
from veo_ti.viewpoint import Viewpoint, look_at

ACROSS = 6  # pictures in a row of the contact sheet
FRUSTUM = 0.22  # of the distance to the object: how far a camera's pyramid is drawn
ROLE_COLOURS = {"train": INK, "test": PLAIN, "nozzle": ARROW}
PAPER_LEVELS = (251, 251, 249)  # PAPER as RGB
SIDES = 6  # of a drawn line
AXES_COLOURS = (PLAIN, MODEL, ARROW)


def contact_sheet(pictures: Mapping[str, np.ndarray], path: str | Path) -> Path:
    """A small picture, RGB or grey uint8, of every camera under its name. Returns the path written."""
    require(len(pictures) > 0, "pictures", "be at least one", 0)
    across = min(ACROSS, len(pictures))
    tile_w, tile_h = (max(p.shape[i] for p in pictures.values()) for i in (1, 0))
    step_w, step_h = tile_w + 8, tile_h + 26
    sheet = np.full((-(-len(pictures) // across) * step_h, across * step_w, 3), PAPER_LEVELS, np.uint8)
    figure = Figure(figsize=(sheet.shape[1] / 100, sheet.shape[0] / 100), dpi=100, facecolor=PAPER)
    axes = figure.add_axes((0, 0, 1, 1), frame_on=False, xticks=[], yticks=[])
    for number, (name, picture) in enumerate(pictures.items()):
        left, top = number % across * step_w + 4, number // across * step_h + 22
        sheet[top : top + picture.shape[0], left : left + picture.shape[1]] = picture.reshape(*picture.shape[:2], -1)
        axes.text(left, top - 6, name, color=INK, fontsize=10)
    axes.imshow(sheet, interpolation="nearest")
    return saved(figure, path)


def rig_picture(cameras: Sequence[Camera], hull: Hull | None, nozzle: NozzlePath | None, path: str | Path) -> Path:
    """The cameras' pyramids, the object's visual hull and the nozzle's way, seen from a little above."""
    require(len(cameras) > 0, "cameras", "be at least one", 0)
    centres = np.stack([camera.centre for camera in cameras])
    middle = hull.points.mean(axis=0) if hull is not None else _looked_at(cameras)
    reach = FRUSTUM * float(np.median(np.linalg.norm(centres - middle, axis=1)))
    corners = {camera.name: _corners(camera, reach) for camera in cameras}
    up = -np.mean([camera.T_camera_world[1, :3] for camera in cameras], axis=0)
    shown = [*corners.values(), middle[None], *([nozzle.position[nozzle.seen]] if nozzle is not None else [])]
    view = look_at(np.concatenate(shown), up=up, room=(1200, 820))
    stage = set_up(view, f"{len(cameras)} cameras" + (", the object's hull" if hull is not None else ""))
    for role, colour in ROLE_COLOURS.items():
        edges = [edge for c in cameras if c.role == role for edge in _edges(corners[c.name])]
        _add_lines(stage, edges, colour, 0.011 * reach)
    if hull is not None:
        _add_hull(stage, hull, view.up)
    if nozzle is not None:
        _add_lines(stage, _seen_pieces(nozzle), MODEL, 0.02 * reach)
    for camera in cameras:
        write(stage, camera.name, tuple(_on_screen(view, camera.centre) + 8), size=13)
    return save_picture(stage, path)


def sync_plot(names: Sequence[str], energy: np.ndarray, first: int, sync: Sync, path: str | Path) -> Path:
    """The motion energy (C, F) of every camera over the frames from `first`; those out of step stand out."""
    figure = Figure(figsize=(9.0, 1.2 + 0.34 * len(names)), dpi=130, layout="constrained", facecolor=PAPER)
    axes = figure.add_subplot(facecolor=PAPER)
    frames = first + 1 + np.arange(energy.shape[1])
    for row, curve in enumerate(energy):
        height = (curve - curve.min()) / max(np.ptp(curve), 1e-9)
        late = sync.known[row] and sync.offset[row] != 0
        base, colour = len(names) - 1 - row, PLAIN if late else MODEL if sync.known[row] else REST
        axes.plot(frames, base + 0.9 * height, color=colour, lw=1.8 if late else 1.0)
        text = f"{sync.offset[row]:+d} frames" if late else "in step" if sync.known[row] else "cannot be told"
        axes.text(frames[-1], base + 0.25, f"  {text}", color=colour, fontsize=7)
    axes.set_yticks(np.arange(len(names)) + 0.25, list(names)[::-1], fontsize=7)
    _dress(axes, "How much changes from frame to frame, camera by camera", "frame")
    return saved(figure, path)


def nozzle_plot(times: np.ndarray, nozzle: NozzlePath, path: str | Path) -> Path:
    """The nozzle's place [mm] and direction over time (T,) [s]; frames in which no camera saw the marker are shaded."""
    figure = Figure(figsize=(9.0, 5.4), dpi=130, layout="constrained", facecolor=PAPER)
    place, turn = figure.subplots(2, 1, sharex=True)
    shown = np.where(nozzle.seen[:, None], 1.0, np.nan)
    for axis, colour in enumerate(AXES_COLOURS):
        for axes, values in ((place, 1e3 * nozzle.position), (turn, nozzle.direction)):
            axes.plot(times, (shown * values)[:, axis], color=colour, marker=".", ms=3, lw=1.4, label="xyz"[axis])
    for axes in (place, turn):
        axes.set_facecolor(PAPER)
        _shade_gaps(axes, times, nozzle.seen)
    gaps = int((~nozzle.seen).sum())
    _dress(place, f"Where the nozzle is [mm]; not seen in {gaps} of {len(times)} frames (shaded)", "")
    _dress(turn, "Where it blows, unit vector", "time [s]")
    figure.legend(*place.get_legend_handles_labels(), loc="outside upper right", ncols=3, frameon=False, fontsize=8,
                  labelcolor=INK)  # fmt: skip
    return saved(figure, path)


def _on_screen(view: Viewpoint, point: np.ndarray) -> np.ndarray:
    """Where a point (3,) that may be far from the focus appears, (2,) pixels from the lower left corner."""
    right, up, toward = view.axes() @ (point - view.focus)
    scale = view.pixels * view.distance / (view.distance - toward)
    return scale * np.array([right, up]) + np.array(view.size) / 2


def _looked_at(cameras: Sequence[Camera]) -> np.ndarray:
    """The point nearest to all cameras' axes."""
    axes, centres = (np.stack([getattr(camera, part) for camera in cameras]) for part in ("axis", "centre"))
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    return np.linalg.lstsq(across.sum(axis=0), np.einsum("nij,nj->i", across, centres), rcond=None)[0]


def _corners(camera: Camera, reach: float) -> np.ndarray:
    """The camera's centre and the corners of its picture at that distance, (5, 3) [m]."""
    width, height = camera.size
    rays = camera.undistorted().rays(np.array([[0, 0], [width, 0], [width, height], [0, height]]) - 0.5)
    return np.concatenate([camera.centre[None], camera.centre + reach * rays / (rays @ camera.axis)[:, None]])


def _edges(corners: np.ndarray) -> list[np.ndarray]:
    pairs = [(0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1)]
    return [corners[list(pair)] for pair in pairs]


def _seen_pieces(nozzle: NozzlePath) -> list[np.ndarray]:
    """Steps of the path between neighbouring frames that both show the marker."""
    both = np.flatnonzero(nozzle.seen[1:] & nozzle.seen[:-1])
    steps = [nozzle.position[i : i + 2] for i in both]
    return [step for step in steps if np.ptp(step, axis=0).max() > 0]


def _add_lines(stage: pv.Plotter, lines: Sequence[np.ndarray], colour: str, radius: float) -> None:
    """Draw straight lines (2, 3) [m] as thin six-sided prisms."""
    if not lines:
        return
    points, triangles = (np.concatenate(part) for part in zip(*(_prism(*line, radius) for line in lines), strict=True))
    triangles = triangles + np.repeat(np.arange(len(lines)) * 2 * SIDES, 2 * SIDES)[:, None]
    faces = np.column_stack([np.full(len(triangles), 3), triangles])
    actor = stage.add_mesh(pv.PolyData(points, faces.ravel()), color=colour, reset_camera=False, smooth_shading=False)
    actor.prop.ambient, actor.prop.diffuse = 0.55, 0.5


def _prism(first: np.ndarray, last: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Corners (2 SIDES, 3) and triangles (2 SIDES, 3) of the sides of a prism round the line."""
    along = last - first
    side = np.cross(along, np.eye(3)[np.abs(along).argmin()])
    across = np.cross(along, side)
    side, across = side / np.linalg.norm(side), across / np.linalg.norm(across)
    angle = np.linspace(0, 2 * np.pi, SIDES, endpoint=False)[:, None]
    ring = radius * (np.cos(angle) * side + np.sin(angle) * across)
    i, j = np.arange(SIDES), (np.arange(SIDES) + 1) % SIDES
    triangles = np.concatenate([np.stack([i, j, i + SIDES], axis=1), np.stack([j, j + SIDES, i + SIDES], axis=1)])
    return np.concatenate([first + ring, last + ring]), triangles


def _add_hull(stage: pv.Plotter, hull: Hull, up: np.ndarray) -> None:
    points = hull.surface
    height = points @ up
    colours = Colours(label="", limits=limits_of(height), colormap="YlGnBu", span=(0.25, 0.8))
    add_spheres(stage, points, height, colours, radius=0.62 * hull.spacing)


def _shade_gaps(axes: Axes, times: np.ndarray, seen: np.ndarray) -> None:
    half = float(np.diff(times).mean()) / 2 if len(times) > 1 else 0.5
    edges = np.flatnonzero(np.diff(np.concatenate([[False], ~seen, [False]]).astype(int))).reshape(-1, 2)
    for first, last in edges:
        axes.axvspan(times[first] - half, times[last - 1] + half, color=INK, alpha=0.12, lw=0)


def _dress(axes: Axes, title: str, label: str) -> None:
    axes.set_title(title, loc="left", color=INK, fontsize=11)
    axes.set_xlabel(label, color=INK)
    axes.tick_params(colors=INK, length=0, labelsize=8)
    axes.grid(axis="x", color="#dddddd", lw=0.6)
    axes.margins(x=0.02)
    axes.spines[["top", "right", "left"]].set_visible(False)
