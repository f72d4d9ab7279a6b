"""Write a synthetic recording: videos, calibration and marker path in the PLUSH layout, and the truth beside them."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from recon.cameras import Camera
from recon.files import read_json
from recon.images import write_image
from recon.nozzle.path import MARKER
from recon.plush.calibration import write_calibration
from recon.plush.capture_writer import write_capture
from recon.plush.reconstruction_writer import write_reconstruction
from recon.rig.backdrop import backdrop
from recon.rig.faults import shown_frames, written_cameras, written_marker
from recon.rig.film import Film
from recon.rig.motion import load_motion
from recon.rig.options import RigOptions, plain
from recon.rig.replay import Replay
from recon.rig.sensor import Sensor
from recon.rig.stage import FPS, Stage, build_stage
from recon.rig.texture import colour_of
from recon.rig.truth import matte_path, plate_path, write_truth
from sim.checks import require

SAMPLES = ((500, 2), (200, 3), (0, 4))  # width [px] of a picture from which so many samples across a pixel are enough
STEEP = np.cos(np.deg2rad(70))  # a marker seen more from its edge than this counts as not seen
Progress = Callable[[str], None]


def make_rig(folder: str | Path, options: RigOptions, progress: Progress | None = None) -> Path:
    """Write the recording that the options describe; the same options and seed give the same files.

    Interrupted, it goes on with the videos that are missing. progress: told what is being done.
    Raises ValueError when the folder holds another recording. Returns the folder.
    """
    folder, tell = Path(folder), progress or (lambda said: None)
    faults = options.faults
    replay = Replay.of(load_motion(options.shape), options.frames, inertia=faults.inertia)
    stage = build_stage(options)
    _own(folder, options)
    shown = {c.name: shown_frames(c.device, options.frames, faults, options.seed) for c in stage.cameras}
    seen = np.stack([_sightings(stage, replay, frame) for frame in range(options.frames)])
    tell("truth")
    write_truth(folder, options.shape, replay, stage, seen, plain(options), shown)
    if options.reconstruction:
        _reconstruction(folder, options, replay, stage)
    film = Film(options.shape, replay, options.size)
    left = [c for c in stage.cameras if shown[c.name] and not (folder / "capture" / f"{c.name}.aligned.mp4").exists()]
    by_name = {camera.name: camera for camera in stage.cameras}

    def frames(name: str) -> Iterator[np.ndarray]:
        return _recorded(folder, options, film, stage, by_name[name], shown[name], tell)

    markers = [_written(stage, replay, frame, seen[frame].any(), options) for frame in range(options.frames)]
    write_capture(folder, written_cameras(tuple(left), faults), FPS, frames, markers)
    write_calibration(folder / "capture/calibration.json", written_cameras(stage.cameras, faults))
    return folder


def _own(folder: Path, options: RigOptions) -> None:
    """Raise ValueError unless the folder is free or holds the same recording."""
    known = folder / "truth/options.json"
    if known.exists():
        same = read_json(known)["options"] == plain(options)
        require(same, str(folder), "be a new folder or hold a recording with the same options", "another recording")
        return
    require(not (folder / "capture").exists(), str(folder), "be a new folder", "one with a recording in it")


def _recorded(
    folder: Path, options: RigOptions, film: Film, stage: Stage, camera: Camera, shown: list[int], tell: Progress
) -> Iterator[np.ndarray]:
    """One camera's pictures as its video shows them; its plate and mattes are written on the way."""
    there = stage.on_stage(camera)
    sensor = Sensor.of(camera, options.frames, options.noise, options.drift, options.seed)
    light = backdrop(there)
    plate = sensor.shown(light)
    write_image(plate_path(folder, camera.name), np.round(plate).astype(np.uint8))
    fineness, made = next(samples for width, samples in SAMPLES if camera.size[0] >= width), 0
    for frame in range(options.frames):
        tell(f"{camera.name} frame {frame + 1} of {options.frames}")
        view = film.view(there, frame, fineness)
        levels, matte = plate.copy(), np.zeros(plate.shape[:2], np.uint8)
        if view is not None:
            window = slice(view.row, view.row + len(view.matte)), slice(view.column, view.column + view.matte.shape[1])
            levels[window] = sensor.shown(view.over(light))
            matte[window] = np.round(255 * view.matte)
        write_image(matte_path(folder, camera.name, frame), matte)
        while made < len(shown) and shown[made] == frame:
            yield sensor.exposed(levels, made)
            made += 1


def _sightings(stage: Stage, replay: Replay, frame: int) -> np.ndarray:
    """Which cameras have the whole marker in their picture, turned towards them, (C,) bool, hidden or not."""
    T = stage.T_world_stage @ replay.T_stage_marker(frame)
    corners = MARKER.corners @ T[:3, :3].T + T[:3, 3]
    return np.array([_sees(camera, corners, T) for camera in stage.cameras])


def _sees(camera: Camera, corners: np.ndarray, T: np.ndarray) -> bool:
    pixels, _ = camera.project(corners)
    way = camera.centre - T[:3, 3]
    inside = (pixels >= 0).all() and (pixels <= np.array(camera.size) - 1).all()
    return bool(inside and way @ T[:3, 2] > STEEP * np.linalg.norm(way) and camera.role == "nozzle")


def _written(stage: Stage, replay: Replay, frame: int, seen: bool, options: RigOptions) -> np.ndarray | None:
    T = stage.T_world_stage @ replay.T_stage_marker(frame)
    return written_marker(T, options.faults) if seen else None


def _reconstruction(folder: Path, options: RigOptions, replay: Replay, stage: Stage) -> None:
    """A perfect reconstruction of so many points, the body's nodes first, then places drawn evenly from its inside."""
    motion = replay.motion
    body, rng = motion.body, np.random.default_rng([7, options.seed])
    fixed = motion.held | np.isin(np.arange(len(body.nodes)), np.concatenate(motion.knots))
    count, points, held = options.reconstruction, body.nodes, fixed
    chosen = rng.permutation(len(points))[: min(count, len(points))]
    weights = body.interpolation(_inside(body, max(0, count - len(points)), rng)).tocsr()
    rest = np.concatenate([points[chosen], weights @ points])
    moved = [np.concatenate([nodes[chosen], weights @ nodes]) for nodes in map(replay.nodes, range(options.frames))]
    held = np.concatenate([fixed[chosen], weights @ fixed > 0.5])
    write_reconstruction(
        folder, vertices=stage.to_world(np.stack(moved)), colors=colour_of(options.shape, rest) ** (1 / 2.2),
        object_index=np.arange(len(rest)), fixed=np.flatnonzero(held),
    )  # fmt: skip


def _inside(body, count: int, rng: np.random.Generator) -> np.ndarray:
    """Places (count, 3) [m] in the tetrahedra, evenly by volume."""
    corner = body.nodes[body.tetrahedra]
    volume = np.linalg.det(corner[:, 1:] - corner[:, :1])
    which = rng.choice(len(corner), count, p=volume / volume.sum())
    share = rng.dirichlet(np.ones(4), count)
    return np.einsum("mk,mkj->mj", share, corner[which])
