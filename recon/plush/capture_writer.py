"""Write a recording in exactly the PLUSH layout: turned H.265 videos, millimetres, twelve distortion numbers."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from recon.cameras import Camera
from recon.files import write_json
from recon.plush.calibration import write_calibration
from recon.plush.reconstruction import MARKER_ID, MM, TO_RECONSTRUCTION
from recon.video import write_video
from sim.checks import as_array, require


def write_capture(
    folder: str | Path,
    cameras: Sequence[Camera],
    fps: float,
    frames: Callable[[str], Iterable[np.ndarray]],
    T_world_marker: Sequence[np.ndarray | None],
) -> Path:
    """Write `capture/` into an object's folder: a video a camera, calibration.json, aruco_path.json.

    cameras: named cam0001, cam0001.left, ...; fps [1/s]; frames(name): that camera's upright pictures, RGB for colour
    and grey for left and right; T_world_marker: (4, 4) [m] by frame, None where the marker was not seen.
    Returns the folder `capture`. Raises ValueError for pictures of another size than the camera's, a distortion with
    a tilted sensor, which the layout cannot hold, or a marker pose that is none.
    """
    place = Path(folder) / "capture"
    write_calibration(place / "calibration.json", cameras)
    write_markers(place / "aruco_path.json", T_world_marker)
    for camera in cameras:
        pictures = (_fitting(camera, image) for image in frames(camera.name))
        path, grey = place / f"{camera.name}.aligned.mp4", camera.stream != "colour"
        write_video(path, pictures, fps, turned=True, grey=grey)
    return place


def write_markers(path: str | Path, T_world_marker: Sequence[np.ndarray | None]) -> Path:
    """Write aruco_path.json: (4, 4) [m] by frame, null for None; raises ValueError for what is no rigid motion."""
    return write_json(path, [_marker(i, T) for i, T in enumerate(T_world_marker)])


def _marker(frame: int, T: np.ndarray | None) -> dict[str, object] | None:
    if T is None:
        return None
    T = as_array(f"marker pose of frame {frame}", T, (4, 4))
    R = T[:3, :3]
    rigid = np.abs(R @ R.T - np.eye(3)).max() < 1e-6 and np.linalg.det(R) > 0
    require(bool(rigid), f"marker pose of frame {frame}", "hold a rotation and a shift", T.tolist())
    shift = TO_RECONSTRUCTION * T[:3, 3] / MM
    return {"aruco_ids": [MARKER_ID], "rvecs": (TO_RECONSTRUCTION[:, None] * R).tolist(), "tvecs": shift.tolist()}


def _fitting(camera: Camera, image: np.ndarray) -> np.ndarray:
    fits = np.shape(image)[1::-1] == camera.size
    require(fits, f"{camera.name} frames", f"be {camera.size[0]} x {camera.size[1]} pixels", np.shape(image)[1::-1])
    return image
