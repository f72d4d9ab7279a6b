"""Pictures of cameras that need not be calibrated: videos in the PLUSH layout, or a folder of pictures a camera."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recon.images import ImageFiles
from recon.oak.recording import PLACE as RECORDED
from recon.plush.capture import ENDING
from recon.video import FrameSource, VideoFile
from sim.checks import require

PICTURES = (".png", ".jpg", ".jpeg")
RESULT = "calibrate.json"  # what a folder of results holds, whose pictures no camera took


@dataclass(frozen=True, kw_only=True, eq=False)
class Footage:
    """What cameras took at common moments.

    sources: camera name -> its pictures; moment: camera name -> the moment (F,) int of each picture, ascending;
    moments: how many there are in all.
    """

    sources: Mapping[str, FrameSource]
    moment: Mapping[str, np.ndarray]
    moments: int


def footage_of(folder: str | Path, without: Sequence[str] = ()) -> Footage:
    """The videos FOLDER/capture/NAME.aligned.mp4 (or right in FOLDER), else the pictures FOLDER/NAME/*.png or .jpg.

    In videos the moment is the frame's number, in folders of pictures equal file names are the same moment. without:
    cameras, or devices with all their cameras, to leave out. Raises ValueError naming file and camera for a folder
    that holds neither, a damaged video, unequal frame counts, and a name that is not there.
    """
    folder = Path(folder)
    require(folder.is_dir(), "FOLDER", "be a folder with videos or pictures", repr(str(folder)))
    names = video_names(folder)
    return _of_videos(folder, _left(names, without)) if names else _of_pictures(folder, without)


def video_place(folder: Path) -> Path:
    """Where the folder keeps its videos."""
    return folder / "capture" if (folder / "capture").is_dir() else folder


def video_names(folder: Path) -> list[str]:
    """The cameras whose videos the folder holds."""
    return sorted(path.name.removesuffix(ENDING) for path in video_place(folder).glob(f"*{ENDING}"))


def video_of(folder: Path, name: str) -> VideoFile:
    """One camera's video, upright; raises ValueError naming file and camera when it is missing or damaged."""
    grey = name.partition(".")[2] in ("left", "right")
    return VideoFile(video_place(folder) / f"{name}{ENDING}", turned=True, grey=grey, camera=name)


def _of_videos(folder: Path, names: Sequence[str]) -> Footage:
    videos = {name: video_of(folder, name) for name in names}
    first = next(iter(videos.values()))
    for video in videos.values():
        rule = f"have {first.count} frames as {first.label}"
        require(video.count == first.count, video.label, rule, video.count)
    every = np.arange(first.count)
    return Footage(sources=videos, moment=dict.fromkeys(videos, every), moments=first.count)


def _of_pictures(folder: Path, without: Sequence[str]) -> Footage:
    places = [place for place in sorted(folder.iterdir()) if place.is_dir() and not (place / RESULT).exists()]
    held = {place.name: files for place in places if (files := _pictures(place))}
    got = repr(str(folder))
    if not held and (folder / RECORDED).is_dir():
        got = f"a recording that is not finished: veo capture --out {folder} --finish"
    require(len(held) > 0, "FOLDER", f"hold capture/cam0001{ENDING}, ... or pictures cam0001/*.png, ...", got)
    chosen = {name: held[name] for name in _left(list(held), without)}
    stems = sorted({path.stem for files in chosen.values() for path in files})
    moment = {name: np.array([stems.index(path.stem) for path in files]) for name, files in chosen.items()}
    sources = {name: ImageFiles(files, camera=name) for name, files in chosen.items()}
    return Footage(sources=sources, moment=moment, moments=len(stems))


def _pictures(place: Path) -> list[Path]:
    """Picture files in the order of their names, one of each name."""
    files = {path.stem: path for path in sorted(place.iterdir()) if path.suffix.lower() in PICTURES}
    return [files[stem] for stem in sorted(files)]


def _left(names: Sequence[str], without: Sequence[str]) -> list[str]:
    known = {*names, *(name.split(".")[0] for name in names)}
    strange = sorted(set(without) - known)
    require(not strange, "--without", f"name cameras among {', '.join(names)}", ", ".join(strange))
    left = [name for name in names if name not in without and name.split(".")[0] not in without]
    require(len(left) > 0, "--without", "leave a camera", ", ".join(without))
    return left
