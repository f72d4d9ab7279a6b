"""What the capture side finds in a rig recording beside what is true in it: nozzle, mattes, hull, files."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from benchmarks.table import Row
from recon.cameras import Camera
from recon.capture import Capture
from recon.hull import HullOptions, visual_hull
from recon.mattes.matting import matte
from recon.mattes.nozzle import nozzle_region, without_nozzle
from recon.nozzle.path import nozzle_path, track
from recon.plush.capture import read_capture
from recon.plush.markers import read_markers
from recon.plush.reconstruction import read_plush
from recon.rig.body import Body
from recon.rig.jet import Stream, stream_forces
from recon.rig.replay import stream_of
from recon.rig.truth import Truth, read_truth

INSIDE = 40_000  # points drawn evenly in the body for the hull
Mattes = dict[str, np.ndarray]


def nozzle_rows(folder: Path, what: str) -> list[Row]:
    """The tracked nozzle's error: its marker found in the decoded videos of the three cameras that watch it."""
    capture, truth = read_capture(folder), read_truth(folder)
    watching = [capture.camera(c.name) for c in truth.cameras if c.role == "nozzle" and c.stream == "colour"]
    frames = zip(*(capture.sources[camera.name].frames() for camera in watching), strict=True)
    found = track(watching, frames)
    path, (position, direction) = nozzle_path(found), stream_of(truth.T_world_marker)
    seen = path.seen
    off = 1e3 * np.linalg.norm(path.position - position, axis=1)[seen]
    turn = np.rad2deg(np.arccos(np.clip((path.direction * direction).sum(axis=1), -1, 1)))[seen]
    name = f"{what}, {seen.sum()} of {len(seen)} frames, 3 cameras"
    return [
        Row(what=f"Nozzle's place, {name}: mean error", figure=f"{off.mean():.2f} mm (at most {off.max():.2f} mm)",
            target="<= 0.3 mm", reached=bool(off.mean() <= 0.3)),
        Row(what=f"Nozzle's direction, {name}: mean error", figure=f"{turn.mean():.2f} deg (at most {turn.max():.2f})",
            target="<= 1 deg", reached=bool(turn.mean() <= 1)),
    ]  # fmt: skip


def matte_rows(folder: Path, what: str, most: int) -> list[Row]:
    """Intersection over union of computed and true mattes in at most so many pictures of the cameras that teach."""
    capture, truth = read_capture(folder), read_truth(folder)
    cameras, rows = teaching(capture, truth), []
    every = max(1, len(cameras) * len(capture.times) // most)
    pictures = [(c, f) for f in range(len(capture.times)) for c in cameras][::every]
    for by in ("plate", "brightness"):
        plates = {c.name: truth.plate(c.name) for c in cameras} if by == "plate" else {}
        shares = np.array([overlap(_computed(folder, capture, c, f, plates), _true(truth, c, f)) for c, f in pictures])
        rows.append(
            Row(what=f"Matte by {by} and closed form, {what}, {len(pictures)} pictures: mean overlap (IoU)",
                figure=f"{shares.mean():.4f} (worst {shares.min():.3f})", target=">= 0.975",
                reached=bool(shares.mean() >= 0.975))
        )  # fmt: skip
    return rows


def hull_rows(folder: Path, what: str) -> list[Row]:
    """How much of the body the hull of the middle frame keeps, from computed mattes and from the true ones."""
    capture, truth = read_capture(folder), read_truth(folder)
    cameras, frame = teaching(capture, truth), len(capture.times) // 2
    plates = {c.name: truth.plate(c.name) for c in cameras}
    T, points = read_markers(folder / "capture/aruco_path.json")[frame], interior(truth, frame)
    unclear = [None if T is None else nozzle_region(c, T) for c in cameras]
    volume = _volume(truth, frame)
    rows = []
    for name, mattes in (
        ("computed mattes", [_computed(folder, capture, c, frame, plates) for c in cameras]),
        ("true mattes", [_true(truth, c, frame) for c in cameras]),
    ):
        hull = visual_hull(cameras, mattes, HullOptions(cells=96), unclear=unclear)
        kept = hull.contains(points).mean()
        figure = f"{100 * kept:.3f} % (hull's volume {hull.volume / volume:.2f} x the body's)"
        rows.append(
            Row(what=f"Hull of {len(cameras)} cameras from {name}, {what}: share of the body inside", figure=figure,
                target=">= 99.9 %", reached=bool(kept >= 0.999))
        )  # fmt: skip
    return rows


def file_rows(folder: Path, what: str) -> list[Row]:
    """What the PLUSH files give back of what was true: cameras, times, marker poses, and forces computed from them."""
    capture, truth = read_capture(folder), read_truth(folder)
    pairs = [(camera, truth.camera(camera.name)) for camera in capture.cameras]
    cameras = max(np.abs(a.T_camera_world - b.T_camera_world).max() for a, b in pairs)
    lenses = max(max(np.abs(a.K - b.K).max(), np.abs(a.distortion - b.distortion).max()) for a, b in pairs)
    poses = read_markers(folder / "capture/aruco_path.json")
    known = [f for f, T in enumerate(poses) if T is not None]
    markers = np.abs(np.array([poses[f] for f in known]) - truth.T_world_marker[known]).max()
    force = max(_force_error(truth, f, poses[f]) for f in known)
    times = np.abs(capture.times - truth.times).max()
    figures = (
        ("cameras' poses", f"{1e3 * cameras:.1e} mm", cameras < 1e-9),
        ("lenses", f"{lenses:.1e}", lenses < 1e-9),
        ("times", f"{times:.1e} s", times < 1e-9),
        ("marker's poses", f"{1e3 * markers:.1e} mm", markers < 1e-9),
        ("forces from the poses read", f"{force:.1e} of the largest", force < 1e-5),
        *_reconstructed(folder, truth),
    )
    return [Row(what=f"PLUSH files, {what}: {name}, largest error", figure=figure, target="rounding",
                reached=bool(reached)) for name, figure, reached in figures]  # fmt: skip


def teaching(capture: Capture, truth: Truth) -> list[Camera]:
    """The colour cameras that do not watch the nozzle."""
    names = [c.name for c in truth.cameras if c.role == "train" and c.stream == "colour"]
    return [capture.camera(name) for name in names]


def overlap(first: np.ndarray, second: np.ndarray) -> float:
    """Intersection over union of two pictures of truth values."""
    return float((first & second).sum() / max((first | second).sum(), 1))


def interior(truth: Truth, frame: int) -> np.ndarray:
    """Points (INSIDE, 3) [m] evenly in the body as it is in a frame."""
    rng, corner = np.random.default_rng(0), truth.rest[truth.tetrahedra]
    volume = np.linalg.det(corner[:, 1:] - corner[:, :1])
    chosen = corner[rng.choice(len(corner), INSIDE, p=volume / volume.sum())]
    return truth.warp(np.einsum("mk,mkj->mj", rng.dirichlet(np.ones(4), INSIDE), chosen), frame)


def _computed(folder: Path, capture: Capture, camera: Camera, frame: int, plates: Mapping[str, np.ndarray]):
    """The matte as `veo matte` makes it, cut at one half, (height, width) bool."""
    alpha = matte(capture.image(camera.name, frame), plates.get(camera.name))
    T = read_markers(folder / "capture/aruco_path.json")[frame]
    return (alpha if T is None else without_nozzle(alpha, camera, T)) > 0.5


def _true(truth: Truth, camera: Camera, frame: int) -> np.ndarray:
    return truth.matte(camera.name, frame) > 127


def _volume(truth: Truth, frame: int) -> float:
    corner = truth.points[frame][truth.tetrahedra]
    return float(np.linalg.det(corner[:, 1:] - corner[:, :1]).sum() / 6)


def _force_error(truth: Truth, frame: int, T: np.ndarray) -> float:
    """The jet's forces at the pose that was read beside the true ones, as a share of the largest."""
    position, direction = stream_of(T)
    stream = Stream(position=position, direction=direction, force=truth.jet_force, footprint=truth.jet_footprint)
    body, nodes = Body(nodes=truth.rest, tetrahedra=truth.tetrahedra), truth.points[frame]
    x, area = body.skin_points(nodes)
    found = body.lumped @ stream_forces(stream, x, area, nodes, body.triangles)
    return float(np.abs(found - truth.jet[frame]).max() / max(np.abs(truth.jet).max(), 1e-12))


def _reconstructed(folder: Path, truth: Truth) -> Iterator[tuple[str, str, bool]]:
    """The reconstruction that the rig wrote, where it did: points of all frames beside the true motion."""
    if not (folder / "reconstruction").exists():
        return
    plush = read_plush(folder)
    rest, frames = plush.points(0), plush.frame_numbers.tolist()
    off = max(np.abs(plush.points(f) - truth.warp(rest, f)).max() for f in frames)
    yield "reconstructed points", f"{1e3 * off:.1e} mm", off < 5e-5
