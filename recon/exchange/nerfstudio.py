"""nerfstudio's transforms.json with times and masks, read."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from recon.cameras import STREAMS, Camera
from recon.capture import Capture
from recon.files import read_json
from recon.images import ImageFiles
from recon.rigid import inverse
from recon.video import FrameSource
from sim.checks import as_array, require

FILE = "transforms.json"
MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")  # all of one formula in nerfstudio
INTRINSICS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "k3", "k4", "p1", "p2")
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL's camera looks along -z, y up
HALF = 0.5  # nerfstudio's first pixel reaches from 0 to 1, OpenCV's has its centre at 0


@dataclass(frozen=True, kw_only=True)
class _Shot:
    """One entry of the file: which picture, taken how and when."""

    file: str
    mask: str | None
    time: float | None
    matrix: tuple[float, ...]  # 16, camera to world
    numbers: tuple[float, ...]  # as INTRINSICS


def read_transforms(path: str | Path, *, unit_m: float = 1.0) -> Capture:
    """The recording of a transforms.json, or of the folder that holds one: cameras that stand still, at all times.

    Pictures with the same pose and lens are one camera's, named after its folder or its picture. unit_m [m]: length
    of the file's unit. `time` is taken as seconds where the file has no time_span_s.
    Raises ValueError naming file and camera for another camera model, a radial k4 (r^8), which OpenCV does not have,
    a matrix that is no rotation and shift, a picture that is missing, and cameras without a picture at every time.
    """
    path = Path(path) / FILE if Path(path).is_dir() else Path(path)
    meta = read_json(path)
    held = isinstance(meta, dict) and isinstance(meta.get("frames"), list) and len(meta["frames"]) > 0
    require(held, path.name, "hold a list of frames", "none")
    model = meta.get("camera_model", MODELS[0])
    require(model in MODELS, f"{path.name} camera_model", f"be one of {', '.join(MODELS)}", model)
    groups: dict[tuple, list[_Shot]] = {}
    for number, entry in enumerate(meta["frames"]):
        shot = _shot(path, meta, entry, number)
        groups.setdefault((shot.matrix, shot.numbers), []).append(shot)
    named = _named(list(groups.values()))
    times = _times(path, meta, named)
    fps = float(1 / np.diff(times).mean()) if len(times) > 1 else 1.0
    judging = {*meta.get("test_filenames", ()), *meta.get("val_filenames", ())}
    return Capture(
        cameras=tuple(_camera(path, name, shots[0], unit_m, judging) for name, shots in named.items()),
        times=times,
        sources={name: _pictures(path, name, [s.file for s in shots], fps) for name, shots in named.items()},
        mattes=_masks(path, named, fps),
    )


def _shot(path: Path, meta: Mapping, entry: Mapping, number: int) -> _Shot:
    """An entry of the file; a lens's number that it lacks is the same for all."""
    file = entry.get("file_path") if isinstance(entry, dict) else None
    require(isinstance(file, str), f"{path.name} frame {number}", "have a file_path", file)
    label = f"{path.name} ({file})"
    held = {**meta, **entry}
    lacking = [name for name in ("fl_x", "w", "h", "transform_matrix") if name not in held]
    require(not lacking, label, "hold fl_x, w, h and transform_matrix", f"no {', '.join(lacking)}")
    start = {"fl_y": held["fl_x"], "cx": held["w"] / 2, "cy": held["h"] / 2}
    numbers = [held.get(name, start.get(name, 0.0)) for name in INTRINSICS]
    return _Shot(
        file=file,
        mask=entry.get("mask_path"),
        time=None if entry.get("time") is None else float(entry["time"]),
        matrix=tuple(as_array(f"{label} transform_matrix", held["transform_matrix"], (4, 4)).ravel().tolist()),
        numbers=tuple(as_array(f"{label} intrinsics", numbers, (len(INTRINSICS),)).tolist()),
    )


def _named(groups: Sequence[Sequence[_Shot]]) -> dict[str, list[_Shot]]:
    """Cameras by the folder of their pictures, else by the picture's name, else numbered; each in order of time."""
    folders = [{PurePosixPath(shot.file).parent.name for shot in shots} for shots in groups]
    names = [next(iter(folder)) for folder in folders if len(folder) == 1]
    if len(set(names)) < len(groups):
        names = [PurePosixPath(shots[0].file).stem for shots in groups if len(shots) == 1]
    if len(set(names)) < len(groups):
        names = [f"cam{number:04d}" for number in range(1, len(groups) + 1)]
    return {name: sorted(shots, key=lambda shot: shot.time or 0.0) for name, shots in zip(names, groups, strict=True)}


def _times(path: Path, meta: Mapping, named: Mapping[str, Sequence[_Shot]]) -> np.ndarray:
    """The times (T,) [s] at which every camera has a picture."""
    stamps = {name: [shot.time for shot in shots] for name, shots in named.items()}
    if all(stamp == [None] for stamp in stamps.values()):
        return np.zeros(1)
    every = sorted({t for stamp in stamps.values() for t in stamp if t is not None})
    for name, stamp in stamps.items():
        rule = f"have one picture at each of the {len(every)} times, from where it stands still"
        require(stamp == every, f"{path.name} ({name})", rule, f"{len(stamp)} pictures")
    return float(meta.get("time_start_s", 0.0)) + float(meta.get("time_span_s") or 1.0) * np.array(every)


def _camera(path: Path, name: str, shot: _Shot, unit_m: float, judging: set[str]) -> Camera:
    fx, fy, cx, cy, w, h, k1, k2, k3, k4, p1, p2 = shot.numbers
    require(k4 == 0, f"{path.name} ({name}) k4", "be 0: OpenCV's model has no such term", k4)
    T_world_camera = np.reshape(shot.matrix, (4, 4)) @ FLIP
    T_world_camera[:3, 3] *= unit_m
    T = inverse(T_world_camera)
    T[3] = T_world_camera[3]
    K = np.array([[fx, 0, cx - HALF], [0, fy, cy - HALF], [0, 0, 1.0]])
    distortion = np.array([k1, k2, p1, p2, k3]) if any((k1, k2, p1, p2, k3)) else np.zeros(0)
    role = "test" if shot.file in judging else "train"
    try:
        return Camera(
            name=name, K=K, T_camera_world=T, size=(int(w), int(h)), distortion=distortion, stream=_stream(name),
            role=role,
        )  # fmt: skip
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from None


def _masks(path: Path, named: Mapping[str, Sequence[_Shot]], fps: float) -> dict[str, FrameSource]:
    mattes = {}
    for name, shots in named.items():
        masks = [shot.mask for shot in shots if shot.mask]
        require(len(masks) in (0, len(shots)), f"{path.name} ({name})", "have a mask_path for all or none", len(masks))
        if masks:
            mattes[name] = ImageFiles([path.parent / mask for mask in masks], grey=True, camera=name, fps=fps)
    return mattes


def _pictures(path: Path, name: str, files: Sequence[str], fps: float) -> FrameSource:
    paths = [path.parent / file for file in files]
    return ImageFiles(paths, grey=_stream(name) != STREAMS[0], camera=name, fps=fps)


def _stream(name: str) -> str:
    stream = name.rpartition(".")[2]
    return stream if stream in STREAMS else STREAMS[0]
