"""The nozzle is not the object: where a known marker's pose puts it in a picture, and a matte without it."""

import cv2
import numpy as np

from recon.cameras import Camera
from recon.plush.reconstruction import MM, NOZZLE_IN_MARKER, STREAM_IN_MARKER
from recon.rigid import moved

_HALF = 0.036  # [m] half the side of the plate that carries the marker of 40 mm with its margin
_ROD = 0.006  # [m] radius of the tube, and of what holds the plate
_BACK = 0.2  # [m] of the tube, against the stream from where it starts
_BEADS = 60  # discs that a rod is drawn with
_NEAR = 0.006  # of the picture's width, by which the nozzle may be wider than drawn
_FAINT = 0.05  # of a pixel, below which nothing is there
_MOSTLY = 0.5


def nozzle_region(camera: Camera, T_world_marker: np.ndarray) -> np.ndarray:
    """Where the nozzle can be seen, (H, W) bool: the marker's plate, the tube behind the stream's start, its holder."""
    region = np.zeros(camera.size[::-1], np.uint8)
    plate = _HALF * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0.0]])
    start = MM * NOZZLE_IN_MARKER
    pixels, depth = camera.project(moved(T_world_marker, plate))
    if (depth > 0).all() and np.abs(pixels).max() < 1e4:
        cv2.fillConvexPoly(region, np.round(pixels).astype(np.int32), 1)
    share = np.linspace(0, 1, _BEADS)[:, None]
    for end in (np.zeros(3), start - _BACK * STREAM_IN_MARKER):
        beads, depth = camera.project(moved(T_world_marker, (1 - share) * start + share * end))
        for place, away in zip(beads, depth, strict=True):
            if away > 0.05 and np.abs(place).max() < 1e4:
                radius = int(np.ceil(camera.K[0, 0] * _ROD / away))
                cv2.circle(region, tuple(np.round(place).astype(int).tolist()), radius, 1, cv2.FILLED)
    return region > 0


def without_nozzle(matte: np.ndarray, camera: Camera, T_world_marker: np.ndarray) -> np.ndarray:
    """The matte (H, W) in [0, 1] without the nozzle.

    Who looks the way the stream blows sees the nozzle in front of the object: its pixels are cut out. For everyone it
    holds that parts of the matte of which more than half lies on the nozzle, or beside it, are the nozzle's.
    """
    region = nozzle_region(camera, T_world_marker)
    if not region.any():
        return matte
    stream = T_world_marker[:3, :3] @ STREAM_IN_MARKER
    if stream @ camera.axis > 0:
        matte = np.where(region, 0, matte).astype(matte.dtype)
    reach = 2 * max(1, round(_NEAR * camera.size[0])) + 1
    near = cv2.dilate(region.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))) > 0
    count, labels = cv2.connectedComponents((matte > _FAINT).astype(np.uint8), connectivity=8)
    whole, inside = (np.bincount(labels.ravel(), weights.ravel(), count) for weights in (matte, matte * near))
    dropped = inside > _MOSTLY * whole
    dropped[0] = False
    return np.where(dropped[labels], 0, matte).astype(matte.dtype)
