"""The marker found camera by camera, so that long films are read one after the other, not all at once."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from recon.cameras import Camera
from recon.marker import Finder, Marker
from recon.nozzle.consensus import Detections


@dataclass(frozen=True, kw_only=True, eq=False)
class Finds:
    """Where one camera's pictures show the marker, and the ids of other markers in them."""

    frame: np.ndarray  # (D,) int
    corners: np.ndarray  # (D, 4, 2) [px]
    others: np.ndarray  # (n,) int


def finds_in(camera: Camera, images: Iterable[np.ndarray], marker: Marker) -> Finds:
    """All finds in one camera's pictures (height, width[, 3]) uint8, in order.

    Raises ValueError for a picture of another size, naming camera and frame.
    """
    finder, rows, others = Finder(marker, camera), [], set()
    for frame, image in enumerate(images):
        found = finder(image, frame)
        rows += [(frame, corners) for corners in found.corners]
        others.update(found.others)
    return Finds(
        frame=np.array([frame for frame, _ in rows], int),
        corners=np.array([corners for _, corners in rows]).reshape(-1, 4, 2),
        others=np.array(sorted(others), int),
    )


def detections(finds: Sequence[Finds]) -> Detections:
    """The finds of all cameras together, by frame and then camera."""
    camera = np.repeat(np.arange(len(finds)), [len(f.frame) for f in finds])
    frame, corners = (np.concatenate([getattr(f, part) for f in finds]) for part in ("frame", "corners"))
    order = np.lexsort([camera, frame])
    return Detections(frame=frame[order], camera=camera[order], corners=corners[order])
