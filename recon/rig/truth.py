"""The truth behind a recording: `truth/`, which no reader opens but the tests.

options.json what was asked for, and which true frames each video shows; cloud.npz the body at rest; motion.npz where
its points are in each frame and what acts on them; nozzle.npz the marker; cameras.npz the true cameras;
mattes/NAME/00000000.png the object's coverage in every true frame; plates/NAME.png the empty stage.
Everything is in SI units and in the axes of a PLUSH reconstruction, as in all of this project.
"""

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recon.cameras import Camera
from recon.files import replacing, write_json
from recon.images import read_image
from recon.rig.body import Body
from recon.rig.replay import Replay
from recon.rig.stage import FPS, Stage
from recon.rig.texture import colour_of
from sim.checks import require


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """A recording's truth as arrays; N nodes of the body, F frames, L lines."""

    folder: Path
    options: Mapping[str, object]
    shown: Mapping[str, list[int]]  # the true frame behind each frame of a camera's video
    cameras: tuple[Camera, ...]
    rest: np.ndarray  # (N, 3) [m]
    tetrahedra: np.ndarray  # (E, 4) corners
    triangles: np.ndarray  # (M, 3) the skin, outwards
    surface: np.ndarray  # (N,) bool
    held: np.ndarray  # (N,) bool, taped to the ground
    knots: np.ndarray  # (L, N) bool, held by each line
    mu: np.ndarray  # (N,) [Pa]
    lam: np.ndarray  # (N,) [Pa]
    colors: np.ndarray  # (N, 3) in 0..1 as a display shows them
    density: float  # [kg/m3]
    times: np.ndarray  # (F,) [s]
    points: np.ndarray  # (F, N, 3) [m]
    jet: np.ndarray  # (F, N, 3) [N]
    lines: np.ndarray  # (F, N, 3) [N]
    reaction: np.ndarray  # (F, 3) [N], what the ground adds, as the finite elements found it
    T_world_marker: np.ndarray  # (F, 4, 4) [m]
    seen: np.ndarray  # (F, C) bool, the marker is whole in the picture of that camera and turned towards it
    jet_force: float  # [N] on a flat wall
    jet_footprint: float  # [m]

    def warp(self, points: np.ndarray, frame: int) -> np.ndarray:
        """Where rest positions (M, 3) [m] inside the body are in a frame, (M, 3) [m]."""
        values = Body(nodes=self.rest, tetrahedra=self.tetrahedra).interpolation(points)
        return points + values @ (self.points[frame] - self.rest)

    def camera(self, name: str) -> Camera:
        """The true camera of that name."""
        found = [camera for camera in self.cameras if camera.name == name]
        require(len(found) == 1, "camera", f"be one of the {len(self.cameras)} of the rig", name)
        return found[0]

    def matte(self, camera: str, frame: int) -> np.ndarray:
        """The object's coverage in a true frame, (height, width) uint8."""
        return read_image(matte_path(self.folder, camera, frame), grey=True)

    def plate(self, camera: str) -> np.ndarray:
        """The empty stage without noise, RGB or grey uint8."""
        return read_image(plate_path(self.folder, camera), grey=self.camera(camera).stream != "colour")


def matte_path(folder: Path, camera: str, frame: int) -> Path:
    """Where a matte is kept."""
    return Path(folder) / "truth/mattes" / camera / f"{frame:08d}.png"


def lend_mattes(folder: str | Path) -> None:
    """Put the true mattes where `veo matte` would put its own: for tests of what comes after it.

    Frames are the true ones: not for a recording whose cameras dropped some.
    """
    for place in (Path(folder) / "truth/mattes").iterdir():
        shutil.copytree(place, Path(folder) / "capture/mattes" / place.name, dirs_exist_ok=True)


def plate_path(folder: Path, camera: str) -> Path:
    """Where a plate is kept."""
    return Path(folder) / "truth/plates" / f"{camera}.png"


def write_truth(
    folder: Path, shape: str, replay: Replay, stage: Stage, seen: np.ndarray, options: Mapping[str, object],
    shown: Mapping[str, list[int]],
) -> None:  # fmt: skip
    """Write everything but mattes and plates."""
    motion, place, frames = replay.motion, Path(folder) / "truth", range(len(replay.at))
    body = motion.body
    knots = np.zeros((len(motion.knots), len(body.nodes)), bool)
    for line, knot in zip(knots, motion.knots, strict=True):
        line[knot] = True
    _save(
        place / "cloud.npz", rest=stage.to_world(body.nodes), tetrahedra=body.tetrahedra, triangles=body.triangles,
        surface=body.surface, held=motion.held, knots=knots, mu=motion.mu, lam=motion.lam,
        colors=colour_of(shape, body.nodes) ** (1 / 2.2), density=motion.density,
    )  # fmt: skip
    first = np.floor(replay.at).astype(int)
    share = (replay.at - first)[:, None]
    reaction = (1 - share) * motion.reaction[first] + share * motion.reaction[np.minimum(first + 1, motion.frames - 1)]
    _save(
        place / "motion.npz", times=np.array(frames) / FPS,
        points=np.stack([stage.to_world(replay.nodes(f)) for f in frames]).astype(np.float32),
        jet=np.stack([stage.turned(replay.jet(f)) for f in frames]).astype(np.float32),
        lines=np.stack([stage.turned(replay.lines(f)) for f in frames]).astype(np.float32),
        reaction=stage.turned(reaction),
    )  # fmt: skip
    markers = np.stack([stage.T_world_stage @ replay.T_stage_marker(f) for f in frames])
    _save(place / "nozzle.npz", T_world_marker=markers, seen=seen, jet_force=motion.force,
          jet_footprint=motion.footprint)  # fmt: skip
    _save(
        place / "cameras.npz",
        **{name: np.array([getattr(c, name) for c in stage.cameras]) for name in _CAMERA},
    )
    write_json(place / "options.json", {"options": options, "shown": shown})


_CAMERA = ("name", "K", "T_camera_world", "size", "distortion", "stream", "role")


def read_truth(folder: str | Path) -> Truth:
    """The truth of a recording that the rig wrote; raises ValueError where there is none."""
    place = Path(folder) / "truth"
    require((place / "options.json").exists(), "input", "be a recording of the rig, with truth/", repr(str(folder)))
    said = json.loads((place / "options.json").read_text(encoding="utf-8"))
    arrays = _loaded(place / "cloud.npz") | _loaded(place / "motion.npz") | _loaded(place / "nozzle.npz")
    rows = _loaded(place / "cameras.npz")
    cameras = tuple(
        Camera(name=str(rows["name"][i]), K=rows["K"][i], T_camera_world=rows["T_camera_world"][i],
               size=tuple(rows["size"][i].tolist()), distortion=rows["distortion"][i], stream=str(rows["stream"][i]),
               role=str(rows["role"][i]))
        for i in range(len(rows["name"]))
    )  # fmt: skip
    numbers = {name: float(arrays.pop(name)) for name in ("density", "jet_force", "jet_footprint")}
    wide = {name: arrays.pop(name).astype(float) for name in ("points", "jet", "lines")}
    wide["points"][0] = arrays["rest"]  # which was stored with more digits
    return Truth(folder=Path(folder), options=said["options"], shown=said["shown"], cameras=cameras, **arrays, **wide,
                 **numbers)  # fmt: skip


def _save(path: Path, **arrays: object) -> None:
    with replacing(path) as partial:
        np.savez_compressed(partial, **arrays)


def _loaded(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}
