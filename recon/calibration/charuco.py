"""The printed ChArUco board: a chessboard whose white squares carry markers, so that a part of it suffices."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import cv2
import numpy as np

from recon.marker import dictionary
from sim.checks import require

FEWEST = 8  # corners of a board that are worth a view
_WINDOW = (2, 10)  # [px], half sides of a window that still shows a corner, and that gains no more
_CLOSE = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-3)


@dataclass(frozen=True, kw_only=True)
class Board:
    """A ChArUco board of columns x rows squares.

    Its frame is OpenCV's: origin in a corner of the print, x along the columns, y along the rows, z into the board.
    Raises ValueError for sizes that cannot be printed and for a dictionary that OpenCV does not have.
    """

    columns: int
    rows: int
    square: float  # [m], side of a chess square
    marker: float  # [m], side of a marker's black square
    dictionary: str = "DICT_5X5_1000"
    legacy: bool = False  # the pattern of OpenCV before 4.6, where an even number of rows begins with white

    def __post_init__(self) -> None:
        require(min(self.columns, self.rows) >= 3, "board", "have at least 3 x 3 squares", (self.columns, self.rows))
        sound = 0 < self.marker < self.square
        require(sound, "board marker", "be smaller than its square and positive", (self.marker, self.square))
        most = len(dictionary(self.dictionary).bytesList)
        require(self.markers <= most, "board", f"need no more than {self.dictionary}'s {most} markers", self.markers)

    @property
    def markers(self) -> int:
        """How many markers it has; their ids begin at 0."""
        return self.columns * self.rows // 2

    @property
    def corners(self) -> np.ndarray:
        """The inner chess corners (N, 3) [m]."""
        return np.array(self.opencv().getChessboardCorners(), float)

    def opencv(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's own object."""
        size = (self.columns, self.rows)
        board = cv2.aruco.CharucoBoard(size, self.square, self.marker, dictionary(self.dictionary))
        board.setLegacyPattern(self.legacy)
        return board

    def print(self, pixels_per_square: int) -> np.ndarray:
        """The board to be printed, (rows, columns) times so many pixels, uint8."""
        return self.opencv().generateImage((self.columns * pixels_per_square, self.rows * pixels_per_square))


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardViews:
    """What one camera saw of the board, one row for each corner; a shot is the same moment for all cameras.

    markers: finds of the board's own markers, all pictures taken together; foreign (n,) int: the ids of finds of
    markers of its dictionary that it does not have.
    """

    name: str  # of the camera
    size: tuple[int, int]  # width, height [px]
    shots: int  # pictures looked at
    shot: np.ndarray  # (M,) int
    corner: np.ndarray  # (M,) int, row of the board's corners
    pixel: np.ndarray  # (M, 2) [px]
    markers: int = 0
    foreign: np.ndarray = field(default_factory=lambda: np.zeros(0, int))

    @property
    def seen(self) -> np.ndarray:
        """The shots that show the board, ascending."""
        return np.unique(self.shot)


def find_board(board: Board, name: str, images: Iterable[np.ndarray | None]) -> BoardViews:
    """The board's corners in one camera's pictures (height, width[, 3]) uint8, one a shot, None where there is none.

    Pictures come one at a time and are not kept. A view with fewer than 8 corners, or all in one row, is left out.
    Raises ValueError naming the camera when there is no picture or their sizes differ.
    """
    detector, opencv = cv2.aruco.CharucoDetector(board.opencv()), board.opencv()
    rows, size, count, found = [], None, 0, [np.zeros(0, int)]
    for shot, image in enumerate(images):
        count = shot + 1
        if image is None:
            continue
        size = size or image.shape[1::-1]
        same = image.dtype == np.uint8 and image.shape[1::-1] == size
        rule = f"be {size[0]} x {size[1]} pixels of uint8 like its first"
        require(same, f"{name} picture {shot}", rule, f"{image.shape[1::-1]} {image.dtype}")
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        corners, ids, _, markers = detector.detectBoard(grey)
        found += [] if markers is None else [np.ravel(markers)]
        if ids is not None and len(ids) >= FEWEST and not opencv.checkCharucoCornersCollinear(ids):
            rows.append((shot, np.ravel(ids), _sharpened(board, grey, np.ravel(ids), np.reshape(corners, (-1, 2)))))
    require(size is not None, f"{name} pictures", "hold at least one", count)
    found = np.concatenate(found).astype(int)
    return BoardViews(
        name=name,
        size=(int(size[0]), int(size[1])),
        shots=count,
        shot=np.concatenate([np.full(len(i), s) for s, i, _ in rows] + [np.zeros(0, int)]),
        corner=np.concatenate([i for _, i, _ in rows] + [np.zeros(0, int)]).astype(int),
        pixel=np.concatenate([p for _, _, p in rows] + [np.zeros((0, 2))]).astype(float),
        markers=int((found < board.markers).sum()),
        foreign=found[found >= board.markers],
    )


def _sharpened(board: Board, grey: np.ndarray, ids: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Corners (n, 2) [px] found again in the largest window that no marker's edge enters.

    OpenCV's own window may reach the markers, which pull a corner by up to a pixel.
    """
    place = np.stack(np.divmod(ids, board.columns - 1), axis=1)
    beside = np.abs(place[:, None] - place).sum(axis=2) == 1
    square = np.linalg.norm(corners[:, None] - corners, axis=2)[beside].min(initial=np.inf)
    half = 0.9 * square * (board.square - board.marker) / (2 * board.square)
    if not _WINDOW[0] <= half < np.inf:
        return corners
    window = (min(int(half), _WINDOW[1]),) * 2
    return cv2.cornerSubPix(grey, corners.astype(np.float32).reshape(-1, 1, 2), window, (-1, -1), _CLOSE)[:, 0]
