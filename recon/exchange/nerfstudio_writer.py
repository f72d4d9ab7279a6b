"""Write nerfstudio's transforms.json with times and masks."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path, PurePosixPath

import numpy as np

from recon.cameras import Camera
from recon.exchange.nerfstudio import FILE, FLIP, HALF
from recon.files import write_json
from recon.images import write_image
from recon.rigid import inverse
from sim.checks import as_array, require

HELD = 5  # distortion numbers k1 k2 p1 p2 k3, which nerfstudio's OPENCV model shares with OpenCV


def write_transforms(
    folder: str | Path,
    cameras: Sequence[Camera],
    times: np.ndarray,
    images: Callable[[str], Iterable[np.ndarray]],
    mattes: Callable[[str], Iterable[np.ndarray]] | None = None,
) -> Path:
    """Write images/NAME/00000000.png ..., masks/ likewise, and transforms.json; returns its path.

    times (T,) [s]: `time` runs from 0 to 1 as nerfstudio's methods want it, `time_start_s` and `time_span_s` beside it
    give seconds back. images(name), mattes(name): a camera's T pictures. Lengths stay metres.
    Raises ValueError for a skewed sensor, or a distortion beyond k1 k2 p1 p2 k3, which nerfstudio's model cannot hold.
    """
    folder, times = Path(folder), as_array("times", times, (None,))
    start, span = float(times[0]), float(np.ptp(times))
    common = {camera.name: _intrinsics(camera) | {"transform_matrix": _matrix(camera)} for camera in cameras}
    frames, split = [], {"train": [], "val": [], "test": []}
    for camera in cameras:
        files = _written(folder / "images" / camera.name, images(camera.name), len(times))
        masks = _written(folder / "masks" / camera.name, mattes(camera.name), len(times)) if mattes else ()
        for i, file in enumerate(files):
            name = PurePosixPath("images", camera.name, file).as_posix()
            mask = {"mask_path": PurePosixPath("masks", camera.name, masks[i]).as_posix()} if masks else {}
            when = (float(times[i]) - start) / span if span else 0.0
            frames.append({"file_path": name, "time": when, **mask, **common[camera.name]})
            for part in ("val", "test") if camera.role == "test" else ("train",):
                split[part].append(name)
    meta = {"camera_model": "OPENCV", "time_start_s": start, "time_span_s": span}
    named = {f"{part}_filenames": names for part, names in split.items()} if split["test"] else {}
    return write_json(folder / FILE, {**meta, **named, "frames": frames})


def _written(folder: Path, images: Iterable[np.ndarray], count: int) -> list[str]:
    """Names of the files, one a picture."""
    names = []
    for number, image in enumerate(images):
        names.append(f"{number:08d}.png")
        write_image(folder / names[-1], image)
    require(len(names) == count, f"pictures of {folder.name}", f"be {count}, one a time", len(names))
    return names


def _intrinsics(camera: Camera) -> dict[str, float | int]:
    K, distortion = camera.K, np.zeros(max(HELD, len(camera.distortion)))
    distortion[: len(camera.distortion)] = camera.distortion
    require(K[0, 1] == 0, f"{camera.name} intrinsic", "have no skew in nerfstudio", K[0, 1])
    rule = "end with k3 in nerfstudio (write undistorted views instead)"
    require(not distortion[HELD:].any(), f"{camera.name} distortion", rule, camera.distortion.tolist())
    k1, k2, p1, p2, k3 = distortion[:HELD].tolist()
    size = {"w": camera.size[0], "h": camera.size[1]}
    lens = {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2] + HALF, "cy": K[1, 2] + HALF}
    return (
        size
        | {name: float(value) for name, value in lens.items()}
        | {"k1": k1, "k2": k2, "k3": k3, "k4": 0.0, "p1": p1, "p2": p2}
    )


def _matrix(camera: Camera) -> list[list[float]]:
    """Camera to world in OpenGL's axes."""
    return (inverse(camera.T_camera_world) @ FLIP).tolist()
