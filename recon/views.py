"""One pass over a recording: undistorted pictures of the object at training resolution, as memory maps."""

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from recon.cameras import ROLES, STREAMS, Camera, Resampling
from recon.capture import Capture
from recon.crop import FIRST_THRESHOLD, object_box
from recon.files import read_json, replacing, write_json
from recon.mattes.foreground import over_black
from recon.video import FrameSource
from sim.checks import require

SCHEMA = 2


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """resolution [px] of the longer side, never finer than filmed; margin around the object as a share of its size."""

    resolution: int = 256
    roles: tuple[str, ...] = ("train",)
    streams: tuple[str, ...] = ("colour",)
    threshold: int = FIRST_THRESHOLD  # of 255, what counts as object where there are no mattes
    margin: float = 0.1
    box_frames: int = 8  # frames looked at for the object's box

    def __post_init__(self) -> None:
        require(self.resolution >= 1 and self.box_frames >= 1, "resolution and box_frames", "be positive", self)
        require(set(self.roles) <= set(ROLES), "roles", f"be among {ROLES}", self.roles)
        require(set(self.streams) <= set(STREAMS), "streams", f"be among {STREAMS}", self.streams)
        require(0 <= self.threshold < 255 and self.margin >= 0, "threshold and margin", "be in range", self)


@dataclass(frozen=True, kw_only=True, eq=False)
class Views:
    """What training reads: cameras behind perfect lenses, and for each its pictures.

    times (T,) [s]; images: (T, h, w, 3) or grey (T, h, w) uint8 by camera, read from disk as they are used; where there
    are mattes, what the object alone adds to the picture, over black; mattes: (T, h, w) uint8 by camera, or none at
    all; inside: (h, w) bool by camera, False where the lens showed nothing.
    """

    cameras: tuple[Camera, ...]
    times: np.ndarray
    images: tuple[np.ndarray, ...]
    mattes: tuple[np.ndarray, ...]
    inside: tuple[np.ndarray, ...]

    def looks(self, frames: Iterable[int]) -> Iterator[tuple[Camera, int, np.ndarray, np.ndarray]]:
        """Each camera's pictures of some frames, (h, w[, 3]), with their mattes (h, w), both 0 to 1."""
        for camera, images, mattes in zip(self.cameras, self.images, self.mattes, strict=True):
            for frame in frames:
                yield camera, frame, images[frame] / 255, mattes[frame] / 255

    @property
    def identity(self) -> str:
        """Changes when a camera, a picture or a matte does; reads them all."""
        digest = hashlib.sha256(repr(self.times.tolist()).encode())
        for camera, images in zip(self.cameras, self.images, strict=True):
            stands = camera.K.tolist(), camera.T_camera_world.tolist()
            digest.update(repr((camera.name, camera.stream, stands, images.shape)).encode())
        for stack in (*self.images, *self.mattes):
            for picture in stack:
                digest.update(np.ascontiguousarray(picture))
        return digest.hexdigest()


def training_views(
    capture: Capture,
    folder: str | Path,
    options: ViewOptions | None = None,
    progress: Callable[[str], None] | None = None,
) -> Views:
    """Decode every chosen camera once, one frame at a time, into NAME.npy (and NAME.matte.npy) in the folder.

    A camera whose files are there already, made from the same inputs, is not decoded again. progress is told each
    camera's name before it is read. Raises ValueError naming file and camera for a damaged video or one that shows
    nothing, and when no camera is chosen or only some of them have mattes.
    """
    options = options or ViewOptions()
    chosen = capture.chosen(options.roles, options.streams)
    require(len(chosen) > 0, "cameras", f"include one of {options.roles} and {options.streams}", "none")
    with_matte = [camera.name for camera in chosen if camera.name in capture.mattes]
    require(len(with_matte) in (0, len(chosen)), "mattes", "be there for all cameras or none", ", ".join(with_matte))
    goals = []
    for camera in chosen:
        if progress is not None:
            progress(camera.name)
        goals.append(_kept(capture, camera, Path(folder), options) or _made(capture, camera, Path(folder), options))
    return Views(
        cameras=tuple(goals),
        times=capture.times,
        images=tuple(_mapped(Path(folder), c.name) for c in goals),
        mattes=tuple(_mapped(Path(folder), f"{c.name}.matte") for c in goals if with_matte),
        inside=tuple(_inside(source, goal) for source, goal in zip(chosen, goals, strict=True)),
    )


def _made(capture: Capture, camera: Camera, folder: Path, options: ViewOptions) -> Camera:
    """Write the camera's pictures; the note that they are whole comes last, and an older one goes first."""
    note = folder / f"{camera.name}.json"
    note.unlink(missing_ok=True)
    goal = _goal(capture, camera, options)
    resample = Resampling.of(camera, goal)
    for source, name in reversed(_files(capture, camera)):
        pictures = map(resample, source.frames())
        if name == camera.name and name in capture.mattes:
            pictures = map(over_black, pictures, _mapped(folder, f"{name}.matte"))
        _write_stack(folder / f"{name}.npy", pictures, source.count, goal.size)
    kept = {"inputs": _inputs(capture, camera, options), "K": goal.K.tolist(), "size": list(goal.size)}
    write_json(note, kept)
    return goal


def _kept(capture: Capture, camera: Camera, folder: Path, options: ViewOptions) -> Camera | None:
    """The camera of the pictures that are there, when they were made from the same inputs."""
    note = folder / f"{camera.name}.json"
    whole = note.exists() and all((folder / f"{name}.npy").exists() for _, name in _files(capture, camera))
    kept = read_json(note) if whole else {}
    if not isinstance(kept, dict) or kept.get("inputs") != _inputs(capture, camera, options):
        return None
    return replace(camera.undistorted(), K=np.array(kept["K"]), size=tuple(kept["size"]))


def _goal(capture: Capture, camera: Camera, options: ViewOptions) -> Camera:
    """The camera of the object's box at training resolution."""
    box = object_box(capture, camera, frames=options.box_frames, threshold=options.threshold, margin=options.margin)
    part = camera.undistorted().cropped(box.column, box.row, (box.width, box.height))
    scale = min(1.0, options.resolution / max(part.size))
    return part.resized((max(1, round(scale * box.width)), max(1, round(scale * box.height))))


def _files(capture: Capture, camera: Camera) -> list[tuple[FrameSource, str]]:
    pictures = [(capture.sources[camera.name], camera.name)]
    matte = capture.mattes.get(camera.name)
    return pictures if matte is None else [*pictures, (matte, f"{camera.name}.matte")]


def _inputs(capture: Capture, camera: Camera, options: ViewOptions) -> str:
    """Changes when anything that decides the pictures does."""
    plate = capture.plates.get(camera.name)
    parts = {
        "schema": SCHEMA,
        "sources": [source.identity for source, _ in _files(capture, camera)],
        "plate": "" if plate is None else hashlib.sha256(np.ascontiguousarray(plate)).hexdigest(),
        "camera": [camera.K.tolist(), camera.distortion.tolist(), camera.size],
        "options": {k: v for k, v in asdict(options).items() if k not in ("roles", "streams")},
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _write_stack(path: Path, images: Iterable[np.ndarray], count: int, size: tuple[int, int]) -> None:
    """Write pictures one after the other as one .npy array, without ever holding two."""
    with replacing(path) as partial, partial.open("wb") as file:
        for number, image in enumerate(images):
            if number == 0:
                shape = (count, size[1], size[0], *image.shape[2:])
                header = {"descr": "|u1", "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(file, header)
            file.write(np.ascontiguousarray(image).data)


def _mapped(folder: Path, name: str) -> np.ndarray:
    return np.load(folder / f"{name}.npy", mmap_mode="r", allow_pickle=False)


def _inside(source: Camera, goal: Camera) -> np.ndarray:
    white = np.full(source.size[::-1], 255, np.uint8)
    return Resampling.of(source, goal)(white) > 254
