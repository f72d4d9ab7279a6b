"""What `veo inspect` takes for the object in the middle frame, and its hull; the nozzle is known not to be it."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from recon.cameras import Camera
from recon.capture import Capture
from recon.crop import rough_matte
from recon.hull import Hull, visual_hull
from recon.mattes.nozzle import nozzle_region
from recon.plush.markers import read_markers

BESIDE = 0.02  # of the picture's width, by which the nozzle's bright parts may be off: blur, a pose that is not exact
FEWEST = 2  # cameras that a hull needs


def nozzle_regions(folder: Path, capture: Capture, frame: int, notes: list[str]) -> dict[str, np.ndarray]:
    """Where each calibrated colour camera without mattes may see the nozzle in a frame, (height, width) bool by name.

    Empty where no path of the nozzle is known; a frame without a pose becomes a note.
    """
    if capture.nozzle is None:
        return {}
    path = folder / "capture/aruco_path.json"
    poses = read_markers(path) if path.exists() else ()
    T = poses[frame] if frame < len(poses) else None
    cameras = [
        c for c in capture.cameras if c.stream == "colour" and c.role != "nozzle" and c.name not in capture.mattes
    ]
    if T is None:
        if cameras:
            notes.append(f"frame {frame} has no pose of the nozzle: its bright parts may be in the hull.")
        return {}
    return {camera.name: _grown(nozzle_region(camera, T), BESIDE * camera.size[0]) for camera in cameras}


def object_matte(
    capture: Capture, name: str, frame: int, image: np.ndarray, threshold: int, nozzle: np.ndarray | None
) -> np.ndarray:
    """The object (height, width) bool in a picture: the recording's own matte, or what is bright but not the nozzle."""
    if name in capture.mattes:
        return capture.matte(name, frame) > 127
    rough = rough_matte(image, capture.plates.get(name), threshold)
    return rough if nozzle is None else rough & ~nozzle


def object_hull(
    capture: Capture, mattes: Mapping[str, np.ndarray], nozzle: Mapping[str, np.ndarray], notes: list[str]
) -> Hull | None:
    """The object's hull from the calibrated colour cameras that show something, but for those of the nozzle.

    Where the nozzle may stand before the object a camera says nothing. What cannot be done becomes a note.
    """
    cameras = [c for c in capture.cameras if c.stream == "colour" and c.name in mattes]
    if sum(camera.role != "nozzle" for camera in cameras) >= FEWEST:
        cameras = [camera for camera in cameras if camera.role != "nozzle"]
    for camera in [camera for camera in cameras if not mattes[camera.name].any()]:
        notes.append(f"{camera.name} shows nothing bright: it is left out of the hull.")
        cameras.remove(camera)
    if len(cameras) < FEWEST:
        notes.append("no hull of the object: that needs two calibrated cameras that show it.")
        return None
    try:
        return _carved(cameras, mattes, nozzle)
    except ValueError as error:
        notes.append(f"no hull of the object: {error}; the calibration may not belong to these videos.")
        return None


def _carved(cameras: Sequence[Camera], mattes: Mapping[str, np.ndarray], nozzle: Mapping[str, np.ndarray]) -> Hull:
    unclear = [nozzle.get(camera.name) for camera in cameras]
    return visual_hull(cameras, [mattes[camera.name] for camera in cameras], unclear=unclear).without_specks()


def _grown(mask: np.ndarray, pixels: float) -> np.ndarray:
    size = (2 * max(1, round(pixels)) + 1,) * 2
    return cv2.dilate(mask.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, size)) > 0
