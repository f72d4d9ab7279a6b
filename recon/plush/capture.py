"""A recording in the PLUSH layout, read as it is: turned videos, millimetres, a world of its own."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from recon.cameras import STREAMS, Camera
from recon.capture import Capture
from recon.images import ImageFiles, read_image
from recon.plush.calibration import camera_of, read_calibration, require_millimetres
from recon.plush.reconstruction import CAN_STILL, NozzlePath, read_nozzle
from recon.video import FrameSource, VideoFile
from sim.checks import require

ENDING = ".aligned.mp4"
CALIBRATION, MARKERS = "calibration.json", "aruco_path.json"
NOT_CALIBRATED = "the videos can be viewed and the cameras calibrated, but nothing reconstructed"


@dataclass(frozen=True, kw_only=True)
class _Notes:
    """Sentences on what is missing; a fault is one of them, unless faults are to be raised."""

    strict: bool
    sentences: list[str] = field(default_factory=list)

    @contextmanager
    def instead(self, rest: str) -> Iterator[None]:
        try:
            yield
        except ValueError as error:
            if self.strict:
                raise
            self.sentences.append(f"{error}: {rest}.")


def read_capture(
    folder: str | Path, *, test: Sequence[str] = (), nozzle_only: Sequence[str] = (), strict: bool = True
) -> Capture:
    """The recording of one object's folder, with whatever parts it has; `missing` says what it lacks.

    test, nozzle_only: names of cameras, or of devices with all their cameras, that judge and never teach, or only show
    the nozzle. strict: what is wrong raises, or else is left out and said in `missing`. Beside what PLUSH has,
    `capture/plates/NAME.png` and `capture/mattes/NAME/*.png` (upright) are read.
    Raises ValueError naming file and camera for a folder without videos, a damaged video, unequal frame counts or
    rates, a camera that the calibration lacks or holds wrongly, a foreign marker, and lengths in another unit.
    """
    place = Path(folder) / "capture" if (Path(folder) / "capture").is_dir() else Path(folder)
    names = sorted(path.name.removesuffix(ENDING) for path in place.glob(f"*{ENDING}"))
    require(len(names) > 0, "input", f"hold videos capture/cam0001{ENDING}, ...", repr(str(folder)))
    roles = {name: "nozzle" for name in nozzle_only} | {name: "test" for name in test}
    known = {*names, *(name.split(".")[0] for name in names)}
    require(roles.keys() <= known, "cameras chosen", f"be among the {len(names)} that have videos", sorted(roles))
    notes = _Notes(strict=strict)
    videos = _alike(_videos(place, names, notes), notes)
    count = next(iter(videos.values())).count
    cameras = _cameras(place / CALIBRATION, videos, notes)
    nozzle = _nozzle(place / MARKERS, count, notes)
    with notes.instead("its lengths are kept as they are"):
        require_millimetres(cameras, nozzle)
    if not any("." in name for name in names):
        notes.sentences.append("no left and right videos: the colour ones are enough for a reconstruction.")
    return Capture(
        cameras=tuple(replace(c, role=roles.get(c.name, roles.get(c.device, c.role))) for c in cameras),
        times=np.arange(count) / next(iter(videos.values())).fps,
        sources=videos,
        mattes=_mattes(place / "mattes", videos, notes),
        plates={name: read_image(path, grey=videos[name].grey) for name, path in _plates(place, videos)},
        nozzle=nozzle,
        missing=tuple(notes.sentences),
    )


def _videos(place: Path, names: Sequence[str], notes: _Notes) -> dict[str, VideoFile]:
    videos = {}
    for name in names:
        with notes.instead("that camera is left out"):
            stream = name.partition(".")[2] or "colour"
            require(stream in STREAMS, f"{name}{ENDING}", f"be named after one of {STREAMS}", stream)
            grey = stream != "colour"
            videos[name] = VideoFile(place / f"{name}{ENDING}", turned=True, grey=grey, camera=name)
    require(len(videos) > 0, "input", "hold a video that can be read", " ".join(notes.sentences))
    return videos


def _alike(videos: Mapping[str, VideoFile], notes: _Notes) -> dict[str, VideoFile]:
    """The videos with as many frames a second, and as many in all, as most have."""
    rate, count = Counter((round(video.fps, 2), video.count) for video in videos.values()).most_common(1)[0][0]
    require(rate > 0, next(iter(videos.values())).label, "tell its frame rate", "none")
    kept = {}
    for name, video in videos.items():
        with notes.instead("that camera is left out"):
            require(video.count == count, video.label, f"have {count} frames as the others have", video.count)
            fits = abs(video.fps / rate - 1) < 1e-2
            require(fits, video.label, f"have {rate:g} frames a second as the others have", f"{video.fps:g}")
            kept[name] = video
    return kept


def _cameras(file: Path, videos: Mapping[str, VideoFile], notes: _Notes) -> list[Camera]:
    """The calibrated cameras that have videos; those of one and not of the other are said."""
    if not file.exists():
        notes.sentences.append(f"capture/{file.name} is missing: {NOT_CALIBRATED}.")
        return []
    entries, cameras = read_calibration(file), []
    for name in sorted(entries.keys() - videos.keys()):
        if not (file.parent / f"{name}{ENDING}").exists():
            notes.sentences.append(f"capture/{name}{ENDING} is missing: {name} is left out.")
    for name, video in videos.items():
        with notes.instead("its pictures can be viewed only"):
            require(name in entries, file.name, f"hold every camera, also {name} of {video.path.name}", "none")
            cameras.append(camera_of(name, entries[name], video.size, file.name))
    return cameras


def _nozzle(file: Path, count: int, notes: _Notes) -> NozzlePath | None:
    """The nozzle's path over the video; frames that the file lacks count as not seen."""
    forces = CAN_STILL[f"capture/{MARKERS}"]
    if not file.exists():
        notes.sentences.append(f"capture/{file.name} is missing: {forces}.")
        return None
    with notes.instead(forces):
        path = read_nozzle(file, count)
        if path is None:
            notes.sentences.append(f"capture/{file.name} shows the marker in no frame: {forces}.")
            return None
        fits = len(path.seen) == count
        require(fits, file.name, f"have at most the {count} entries of the video's frames", len(path.seen))
        return path
    return None


def _mattes(place: Path, videos: Mapping[str, VideoFile], notes: _Notes) -> dict[str, FrameSource]:
    mattes = {}
    for name, video in videos.items():
        files = sorted(place.glob(f"{name}/*.png"))
        if files:
            with notes.instead("its mattes are left out"):
                require(len(files) == video.count, f"mattes/{name}", f"hold {video.count} mattes", len(files))
                mattes[name] = ImageFiles(files, grey=True, camera=name, fps=video.fps)
    return mattes


def _plates(place: Path, videos: Mapping[str, VideoFile]) -> list[tuple[str, Path]]:
    return [(path.stem, path) for path in sorted(place.glob("plates/*.png")) if path.stem in videos]
