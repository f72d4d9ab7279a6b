"""Where the object is in a camera's pictures, roughly: what is bright before black cloth, or differs from the plate."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce

import cv2
import numpy as np

from recon.cameras import Camera, Resampling
from recon.capture import Capture
from recon.video import FrameSource
from sim.checks import require

SPECK = 5  # [px], smaller ones are noise
SEEK_FROM = 40  # frames from which jumping to one is cheaper than decoding all before it
FIRST_THRESHOLD = 32  # of 255: black cloth with noise stays below


@dataclass(frozen=True, kw_only=True)
class Box:
    """A rectangle of pixels: column and row of its first one, width and height."""

    column: int
    row: int
    width: int
    height: int


def rough_matte(image: np.ndarray, plate: np.ndarray | None = None, threshold: int = FIRST_THRESHOLD) -> np.ndarray:
    """True (height, width) where the brightest channel, or its difference from the plate, exceeds the threshold."""
    shown = image if plate is None else cv2.absdiff(image, plate)
    bright = shown if shown.ndim == 2 else reduce(cv2.max, cv2.split(shown))
    return cv2.medianBlur((bright > threshold).astype(np.uint8), SPECK) > 0


def object_box(
    capture: Capture, camera: Camera, *, frames: int = 8, threshold: int = FIRST_THRESHOLD, margin: float = 0.1
) -> Box:
    """The box of the object in the undistorted picture, over at most so many frames, inside the sensor.

    The recording's own mattes decide where it has them, else the rough ones. The box is widened on each side by margin
    times its longer side, for what moves between the frames that are looked at.
    Raises ValueError naming file and camera when no frame shows the object.
    """
    name, matte = camera.name, capture.mattes.get(camera.name)
    source, union = matte or capture.sources[name], np.zeros(camera.size[::-1], bool)
    for image in spread_images(source, frames):
        union |= image > 127 if matte is not None else rough_matte(image, capture.plates.get(name), threshold)
    rule = f"show something brighter than {threshold} of 255" if matte is None else "show the object"
    require(bool(union.any()), source.label, rule, "nothing in any of its frames looked at")
    straight = Resampling.of(camera, camera.undistorted())(255 * union.astype(np.uint8)) > 127
    require(bool(straight.any()), source.label, "show the object inside the undistorted picture", "nothing there")
    return _around(straight, margin)


def spread_images(source: FrameSource, most: int) -> Iterator[np.ndarray]:
    """At most so many pictures, evenly from the first to the last."""
    wanted = np.unique(np.linspace(0, source.count - 1, min(source.count, most)).round().astype(int)).tolist()
    if source.count > SEEK_FROM * len(wanted):
        for frame in wanted:
            yield from source.frames(frame, frame + 1)
        return
    yield from (image for frame, image in enumerate(source.frames()) if frame in wanted)


def _around(mask: np.ndarray, margin: float) -> Box:
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    low, high = np.array([columns[0], rows[0]]), np.array([columns[-1], rows[-1]]) + 1
    wider = int(np.ceil(margin * (high - low).max()))
    low, high = np.maximum(low - wider, 0), np.minimum(high + wider, mask.shape[::-1])
    width, height = (high - low).tolist()
    return Box(column=int(low[0]), row=int(low[1]), width=width, height=height)
