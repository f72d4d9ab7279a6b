"""The empty scene of every camera: from frames without the object, from pictures of it, or as the recording has it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recon.crop import spread_images
from recon.images import ImageFiles, read_image, write_image
from recon.mattes.masks import plate_of
from recon.video import FrameSource, VideoFile
from sim.checks import require
from veo_ti.footage.sources import PICTURES, video_names, video_of, video_place

MOST = 31  # pictures that a plate is the median of


@dataclass(frozen=True, kw_only=True, eq=False)
class Plate:
    """The empty scene (height, width[, 3]) uint8 of a camera, None where there is none; source: where it is from."""

    image: np.ndarray | None
    source: str


def plates_of(
    folder: Path, videos: dict[str, VideoFile], frames: str | None = None, given: str | Path | None = None
) -> dict[str, Plate]:
    """A plate for every camera, written to capture/plates/NAME.png when it is new.

    frames: of the recording, that show no object, as "12" or "0-30"; given: a folder with NAME.png or .jpg, with
    NAME/*.png, or with videos of the empty scene; without both the plates that the recording has. Raises ValueError
    naming file and camera for frames that are not there, a camera without a plate, and one of another size.
    """
    once = frames is None or given is None
    require(once, "--plate-frame and --plates", "not be given together", f"{frames} and {given}")
    if given is not None:
        plates = {name: _given(Path(given), name) for name in videos}
    elif frames is not None:
        plates = {name: _of_frames(video, frames) for name, video in videos.items()}
    else:
        return {name: _held(folder, video) for name, video in videos.items()}
    for name, plate in plates.items():
        _require_size(plate.image, videos[name], plate.source)
        image = _like(plate.image, videos[name])
        plates[name] = Plate(image=image, source=plate.source)
        write_image(_path(folder, name), image)
    return plates


def _path(folder: Path, name: str) -> Path:
    return video_place(folder) / "plates" / f"{name}.png"


def _held(folder: Path, video: VideoFile) -> Plate:
    path = _path(folder, video.camera)
    if not path.exists():
        return Plate(image=None, source="no plate")
    image = read_image(path, grey=video.grey, label=f"plates/{path.name} ({video.camera})")
    _require_size(image, video, f"plates/{path.name}")
    return Plate(image=image, source=f"plates/{path.name}")


def _of_frames(video: VideoFile, frames: str) -> Plate:
    first, _, last = frames.partition("-")
    last = last or first
    rule = "be a frame or two with - between, like 12 or 0-30"
    require(first.isdigit() and last.isdigit(), "--plate-frame", rule, repr(frames))
    fits = int(first) <= int(last) < video.count
    require(fits, "--plate-frame", f"be among the {video.count} frames of {video.label}", frames)
    wanted = np.unique(np.linspace(int(first), int(last), MOST).round().astype(int)).tolist()
    at = {*wanted}
    images = video.frames(int(first), int(last) + 1)
    chosen = (image for frame, image in enumerate(images, int(first)) if frame in at)
    return Plate(image=plate_of(chosen), source=f"frames {frames}" if first != last else f"frame {first}")


def _given(folder: Path, name: str) -> Plate:
    require(folder.is_dir(), "--plates", "be a folder", repr(str(folder)))
    for path in (folder / f"{name}{ending}" for ending in PICTURES):
        if path.exists():
            return Plate(image=read_image(path, label=f"{path.name} ({name})"), source=path.name)
    source = _empty_scene(folder, name)
    require(source is not None, "--plates", f"hold the empty scene of {name}: {name}.png, pictures or a video", "none")
    return Plate(image=plate_of(spread_images(source, MOST)), source=source.label)


def _empty_scene(folder: Path, name: str) -> FrameSource | None:
    if name in video_names(folder):
        return video_of(folder, name)
    place = folder / name
    files = sorted(p for p in place.iterdir() if p.suffix.lower() in PICTURES) if place.is_dir() else []
    return ImageFiles(files, camera=name) if files else None


def _require_size(image: np.ndarray, video: VideoFile, label: str) -> None:
    width, height = video.size
    got = f"{image.shape[1]} x {image.shape[0]}"
    require(image.shape[1::-1] == video.size, label, f"be {width} x {height} pixels as {video.label}", got)


def _like(image: np.ndarray, video: VideoFile) -> np.ndarray:
    """Grey where the camera's pictures are."""
    return np.rint(image.mean(axis=2)).astype(np.uint8) if video.grey and image.ndim == 3 else image
