"""A printed ArUco marker found in a picture, its corners put where its four edges meet (paper "Dataset")."""

from dataclasses import dataclass

import cv2
import numpy as np

from recon.cameras import Camera
from sim.checks import require

_ACROSS = 0.45  # of a cell: how far a profile reaches to either side of an edge
_ALONG = 24  # profiles an edge
_FINE = 0.25  # [px] between samples of a profile
_ENDS = 0.1  # of an edge, where its neighbours already blur it
_ROUNDS = 3
_FAR = 3.0  # [px], more than any corner detection is off
_CONTRAST = 20.0  # grey levels between border and paper, below which there is no edge
_WIDER = 1.0  # sides of the marker searched around its last place


@dataclass(frozen=True, kw_only=True)
class Marker:
    """A square marker: its id in one of OpenCV's dictionaries and the side of its black square [m].

    Its frame: origin in the centre, x to the right and y upwards on the print, z out of it towards who reads it.
    Raises ValueError for a dictionary that OpenCV does not have and an id that is not in it.
    """

    id: int
    side: float
    dictionary: str = "DICT_ARUCO_MIP_36h12"

    def __post_init__(self) -> None:
        require(self.side > 0, "marker side", "be positive", self.side)
        count = len(dictionary(self.dictionary).bytesList)
        require(0 <= self.id < count, "marker id", f"be one of {self.dictionary}'s {count}", self.id)

    @property
    def corners(self) -> np.ndarray:
        """(4, 3) [m]: top left, top right, bottom right, bottom left."""
        return self.side / 2 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0.0]])

    @property
    def cells(self) -> int:
        """Cells along a side, the black border included."""
        return dictionary(self.dictionary).markerSize + 2

    def print(self, pixels_per_cell: int) -> np.ndarray:
        """The marker to be printed, (n, n) uint8, with a white margin of one cell."""
        inner = self.cells * pixels_per_cell
        image = cv2.aruco.generateImageMarker(dictionary(self.dictionary), self.id, inner)
        return np.pad(image, pixels_per_cell, constant_values=255)


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """What one picture shows: corners (n, 4, 2) [px] of the marker wherever it was found, and the other ids."""

    corners: np.ndarray
    others: tuple[int, ...]


class Finder:
    """Looks for a marker in the pictures of one camera, first where it was last."""

    def __init__(self, marker: Marker, camera: Camera) -> None:
        options = cv2.aruco.DetectorParameters()
        options.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        self.marker, self.camera = marker, camera
        self._detector = cv2.aruco.ArucoDetector(dictionary(marker.dictionary), options)
        self._last: np.ndarray | None = None

    def __call__(self, image: np.ndarray, frame: int) -> Found:
        """The marker in a picture (height, width[, 3]) uint8; raises ValueError naming camera and frame."""
        width, height = self.camera.size
        fits = image.dtype == np.uint8 and image.shape in ((height, width), (height, width, 3))
        got = f"{image.shape[1::-1]} {image.dtype}"
        require(fits, f"{self.camera.name} frame {frame}", f"be {width} x {height} pixels of uint8", got)
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        found = self._near(grey) if self._last is not None else None
        found = found or self._detected(grey, np.zeros(2, int))
        self._last = found.corners[0] if len(found.corners) else None
        return found

    def _near(self, grey: np.ndarray) -> Found | None:
        low, high = self._last.min(axis=0), self._last.max(axis=0)
        reach = _WIDER * (high - low).max()
        corner = np.maximum(low - reach, 0).astype(int)
        column, row = np.minimum(high + reach, self.camera.size).astype(int)
        found = self._detected(grey[corner[1] : row, corner[0] : column], corner)
        return found if len(found.corners) else None

    def _detected(self, grey: np.ndarray, corner: np.ndarray) -> Found:
        corners, ids, _ = self._detector.detectMarkers(np.ascontiguousarray(grey))
        ids = np.zeros(0, int) if ids is None else np.ravel(ids)
        mine = [np.reshape(c, (4, 2)) + corner for c, i in zip(corners, ids, strict=True) if i == self.marker.id]
        sharp = [edged(grey, c, self.camera, self.marker.cells, corner) for c in mine]
        kept = np.array([c for c in sharp if c is not None]).reshape(-1, 4, 2)
        return Found(corners=kept, others=tuple(sorted({int(i) for i in ids} - {self.marker.id})))


def dictionary(name: str) -> cv2.aruco.Dictionary:
    """One of OpenCV's dictionaries of markers, by its name; raises ValueError for another name."""
    known = name.startswith("DICT_") and hasattr(cv2.aruco, name)
    require(known, "dictionary", "be one of OpenCV's, like DICT_5X5_100", repr(name))
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def edged(
    grey: np.ndarray, corners: np.ndarray, camera: Camera, cells: int, corner: np.ndarray | None = None
) -> np.ndarray | None:
    """Corners (4, 2) [px] as the meeting points of lines through the marker's four edges; None where they are lost.

    OpenCV's sub-pixel corners lie 0.2 to 0.9 px inside the true ones, the more the lens blurs; an edge stays where
    it is under any even blur. `corner` is the pixel of the whole picture at which `grey` begins. An edge's place on
    a profile across it is where the profile's area over the dark level would fit a sharp step; lines are straight
    behind the lens's distortion.
    """
    shift = np.zeros(2) if corner is None else np.asarray(corner, float)
    ideal = start = _straightened(camera, corners)
    for _ in range(_ROUNDS):
        reach = max(1.5, _ACROSS * np.linalg.norm(ideal - np.roll(ideal, 1, axis=0), axis=1).min() / cells)
        lines = [_edge(grey, camera, ideal[k], ideal[(k + 1) % 4], reach, shift) for k in range(4)]
        if any(line is None for line in lines):
            return None
        ideal = np.array([_crossing(lines[k - 1], lines[k]) for k in range(4)])
    return _bent(camera, ideal) if np.abs(ideal - start).max() < _FAR else None


def _edge(
    grey: np.ndarray, camera: Camera, a: np.ndarray, b: np.ndarray, reach: float, shift: np.ndarray
) -> np.ndarray | None:
    """The line (3,) with `n . p + c = 0` of the edge from a to b, whose dark side is to the right on the picture."""
    length = np.linalg.norm(b - a)
    along, outward = (b - a) / length, np.array([b[1] - a[1], a[0] - b[0]]) / length
    place = np.linspace(_ENDS, 1 - _ENDS, _ALONG) * length
    across = np.linspace(-reach, reach, 2 * int(np.ceil(reach / _FINE)) + 1)
    grid = a + place[:, None, None] * along + across[:, None] * outward
    column, row = np.moveaxis((_bent(camera, grid.reshape(-1, 2)) - shift).astype(np.float32), 1, 0)
    profile = cv2.remap(grey, column[None], row[None], cv2.INTER_LINEAR).reshape(len(place), -1).astype(float)
    few = max(2, len(across) // 6)
    dark, bright = profile[:, :few].mean(), profile[:, -few:].mean()
    if bright - dark < _CONTRAST:
        return None
    step = np.clip((profile - dark) / (bright - dark), -0.5, 1.5)
    offset = reach - (step[:, 1:] + step[:, :-1]).sum(axis=1) * (across[1] - across[0]) / 2
    kept = np.abs(offset - np.median(offset)) < max(0.5, 3 * np.median(np.abs(offset - np.median(offset))))
    slope, level = np.polyfit(place[kept], offset[kept], 1)
    normal = outward - slope * along
    return np.append(normal, -normal @ (a + level * outward))


def _crossing(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    meet = np.cross(one, other)
    return meet[:2] / meet[2]


def _straightened(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Where pixels (n, 2) would lie without the lens's distortion."""
    rays = camera.rays(pixels) @ camera.T_camera_world[:3, :3].T
    return (rays[:, :2] / rays[:, 2:]) @ camera.K[:2, :2].T + camera.K[:2, 2]


def _bent(camera: Camera, ideal: np.ndarray) -> np.ndarray:
    """The pixels (n, 2) of places (n, 2) without distortion."""
    if len(camera.distortion) == 0:
        return ideal
    plane = np.linalg.solve(camera.K, np.concatenate([ideal, np.ones((len(ideal), 1))], axis=1).T).T
    return cv2.projectPoints(plane, np.zeros(3), np.zeros(3), camera.K, camera.distortion)[0][:, 0]
