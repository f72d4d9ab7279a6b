"""The PLUSH layout's calibration.json: millimetres, twelve distortion numbers, y and z the other way round."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from recon.cameras import Camera
from recon.files import read_json, write_json
from recon.plush.reconstruction import MM, TO_RECONSTRUCTION, NozzlePath
from sim.checks import as_array, require

KEYS = ("distortion", "extrinsic", "intrinsic", "resolution_w_h")
COEFFICIENTS = 12
FLIP = np.diag([*TO_RECONSTRUCTION, 1.0])
NEAR, FAR = 0.01, 100.0  # [m], what distances in a rig exceed and stay below unless the unit is another one


def read_calibration(path: str | Path) -> dict[str, Mapping[str, object]]:
    """The entries of the file by camera name; raises ValueError naming the file when it holds something else."""
    path = Path(path)
    entries = read_json(path)
    require(isinstance(entries, dict) and len(entries) > 0, path.name, "hold cameras by name", type(entries).__name__)
    for name, entry in entries.items():
        held = sorted(entry) if isinstance(entry, dict) else []
        require(set(KEYS) <= set(held), f"{path.name} ({name})", f"hold {', '.join(KEYS)}", ", ".join(held) or "none")
    return entries


def camera_of(name: str, entry: Mapping[str, object], size: tuple[int, int], file: str = "calibration.json") -> Camera:
    """A camera from its entry: T_camera_world = T_file diag(1, -1, -1, 1), the shift in metres.

    size: of its upright pictures, width and height [px]; the file may give the two in either order as long as the
    principal point belongs to the upright picture. Raises ValueError naming file and camera.
    """
    label = f"{file} ({name})"
    T = as_array(f"{label} extrinsic", entry["extrinsic"], (4, 4)) @ FLIP
    T[:3, 3] *= MM
    given = tuple(as_array(f"{label} resolution_w_h", entry["resolution_w_h"], (2,)).astype(int).tolist())
    wanted = f"be {size[0]} x {size[1]} pixels as the upright video"
    require(given in (tuple(size), tuple(size)[::-1]), f"{label} resolution_w_h", wanted, given)
    K = as_array(f"{label} intrinsic", entry["intrinsic"], (3, 3))
    upright, lying = (np.linalg.norm(K[:2, 2] - np.array(s) / 2) for s in (size, size[::-1]))
    rule = f"describe the upright picture of {size[0]} x {size[1]} pixels"
    require(bool(upright <= lying), f"{label} intrinsic", rule, f"a principal point at {K[:2, 2].round(1).tolist()}")
    distortion = as_array(f"{label} distortion", np.ravel(entry["distortion"]), (None,))
    stream = name.partition(".")[2] or "colour"
    try:
        return Camera(name=name, K=K, T_camera_world=T, size=size, distortion=distortion, stream=stream)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None


def require_millimetres(cameras: Sequence[Camera], nozzle: NozzlePath | None, file: str = "calibration.json") -> None:
    """Raise ValueError naming file and camera when distances suggest that the file was not in millimetres."""
    if not cameras:
        return
    centres, first = np.stack([camera.centre for camera in cameras]), cameras[0]
    away = np.linalg.norm(centres - centres[0], axis=1)
    if len(cameras) > 1:
        far = cameras[int(away.argmax())].name
        got = f"{away.max() / MM:.3g} from {first.name} to {far}, the farthest"
        require(bool(NEAR < away.max() < FAR), f"{file} ({far}) extrinsic", "be in millimetres", got)
    if nozzle is not None:
        gap = float(np.median(np.linalg.norm(nozzle.position[nozzle.seen] - first.centre, axis=1)))
        rule = f"be in millimetres as {file} ({first.name}) is"
        require(NEAR < gap < FAR, "aruco_path.json", rule, f"a nozzle {gap / MM:.3g} from {first.name}")


def write_calibration(path: str | Path, cameras: Sequence[Camera]) -> Path:
    """Write calibration.json; raises ValueError for a tilted sensor, which the layout cannot hold."""
    return write_json(path, {camera.name: _entry(camera) for camera in cameras})


def _entry(camera: Camera) -> dict[str, object]:
    """T_file = T_camera_world diag(1, -1, -1, 1), the shift in millimetres."""
    T = camera.T_camera_world @ FLIP
    T[:3, 3] /= MM
    tilt = camera.distortion[COEFFICIENTS:]
    require(not tilt.any(), f"{camera.name} distortion", "have no tilted sensor in the PLUSH layout", tilt.tolist())
    distortion = np.zeros(COEFFICIENTS)
    distortion[: min(len(camera.distortion), COEFFICIENTS)] = camera.distortion[:COEFFICIENTS]
    return {
        "distortion": distortion.tolist(),
        "extrinsic": T.tolist(),
        "intrinsic": camera.K.tolist(),
        "resolution_w_h": list(camera.size),
    }
