"""From pictures of a ChArUco board to cameras: each one's lens, then where all of them stand (paper "Capture")."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from recon.calibration.bundle import Bundle, BundleOptions, adjusted
from recon.calibration.chains import board_poses, chained, view_poses
from recon.calibration.charuco import Board, BoardViews
from recon.calibration.sightings import Sightings, lenses
from recon.cameras import STREAMS, Camera
from recon.plush.reconstruction import TO_RECONSTRUCTION
from sim.checks import as_array, require

FIRST_CAMERA = np.diag([*TO_RECONSTRUCTION, 1.0])  # T_camera_world of PLUSH's first camera: its own frame, y upwards
_FEWEST = 3  # views that fix a lens
_START = 40  # views that OpenCV's own calibration begins with
_COVERED = 0.4  # of the picture, below which its corners' lens is a guess
_STRAY = 0.02  # share of corners left out that is worth a word


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraReport:
    """How well one camera is known."""

    name: str
    views: int
    corners: int
    strays: int  # corners left out as wrong
    error_px: float  # root mean square distance between seen and predicted corners
    covered: float  # share of the picture inside the hull of all corners
    turn_error_deg: float  # standard error of the direction, root of the sum over axes; 0 where it defines the world
    place_error_mm: float  # standard error of the place, likewise
    focal_error_px: float  # standard error of the mean focal length; 0 where the lens was given

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a user should know and may mend."""
        said = []
        if self.covered < _COVERED:
            said.append(
                f"{self.name}: the board covered {self.covered:.0%} of the picture; beyond it the lens is a guess"
            )
        if self.strays > _STRAY * self.corners:
            said.append(f"{self.name}: {self.strays} of {self.corners} corners were left out as wrong")
        return tuple(said)


@dataclass(frozen=True, kw_only=True, eq=False)
class RigReport:
    """How well a rig is known; with the cameras all that a picture of it needs."""

    cameras: tuple[CameraReport, ...]
    noise_px: float  # of one coordinate of a corner
    covariance: np.ndarray  # (C, 6, 6): turn in the camera's axes [rad], then place in the world [m]
    shots: np.ndarray  # (S,) int, the moments at which the board was seen
    T_world_board: np.ndarray  # (S, 4, 4) [m]

    @property
    def error_px(self) -> float:
        """Root mean square reprojection error over all cameras' corners."""
        kept = np.array([camera.corners - camera.strays for camera in self.cameras])
        return float(np.sqrt((kept * [camera.error_px**2 for camera in self.cameras]).sum() / kept.sum()))

    @property
    def sentences(self) -> tuple[str, ...]:
        """Those of all cameras."""
        return tuple(sentence for camera in self.cameras for sentence in camera.sentences)


def calibrate_camera(
    board: Board, views: BoardViews, *, options: BundleOptions | None = None
) -> tuple[Camera, CameraReport]:
    """One camera's focal lengths, principal point and distortion; it stands at the world's origin.

    Raises ValueError naming the camera when fewer than three pictures show the board.
    """
    options = replace(options or BundleOptions(), lenses=True)
    cameras, report = _solved(board, [views], [_opened(board, views, options)], options, None)
    return cameras[0], report.cameras[0]


def calibrate_rig(
    board: Board,
    views: Sequence[BoardViews],
    *,
    cameras: Sequence[Camera] | None = None,
    first: np.ndarray = FIRST_CAMERA,
    options: BundleOptions | None = None,
) -> tuple[tuple[Camera, ...], RigReport]:
    """Where all cameras stand, from pictures in which they see a board together, and their lenses.

    cameras: with lenses known already, in the order of the views; without, each is calibrated by itself first. The
    lenses are then adjusted with the rest where options ask for it, which without options they do only if not given.
    first: T_camera_world (4, 4) of the first camera, which defines the world. Shots that one camera alone sees say
    something about its lens only. Raises ValueError naming the camera that never sees the board, that shares no
    moment with the others, or whose pictures have another size than its lens was made for.
    """
    require(len({v.name for v in views}) == len(views) > 0, "views", "name each camera once", [v.name for v in views])
    for seen in views:
        require(len(seen.shot) > 0, f"{seen.name} board", "be seen in a picture", f"none of {seen.shots}")
    first, usual = as_array("first", first, (4, 4)), None
    if cameras is None:
        options = options or BundleOptions()
        cameras = [calibrate_camera(board, v, options=options)[0] for v in views]
    else:
        require(len(cameras) == len(views), "cameras", f"be as many as views, {len(views)}", len(cameras))
        options = _kept(cameras, options or BundleOptions(lenses=False))
        usual = lenses(cameras)
        for camera, seen in zip(cameras, views, strict=True):
            fits = camera.name == seen.name and camera.size == seen.size
            require(fits, f"{seen.name} pictures", f"be {camera.name}'s of {camera.size} pixels", seen.size)
    return _solved(board, views, [replace(cameras[0], T_camera_world=first), *cameras[1:]], options, usual)


def _kept(cameras: Sequence[Camera], options: BundleOptions) -> BundleOptions:
    """Options that drop no coefficient of a lens."""
    most = max(len(camera.distortion) for camera in cameras)
    return replace(options, coefficients=max(options.coefficients, most))


def _solved(
    board: Board,
    views: Sequence[BoardViews],
    cameras: Sequence[Camera],
    options: BundleOptions,
    usual: np.ndarray | None,
) -> tuple[tuple[Camera, ...], RigReport]:
    shots = np.unique(np.concatenate([v.shot for v in views]))
    sightings = _sightings(board, views, shots)
    seen, poses = view_poses(cameras, sightings)
    start = chained(cameras, seen, poses)
    placed = [replace(camera, T_camera_world=T) for camera, T in zip(cameras, start, strict=True)]
    boards = board_poses(placed, sightings, seen, poses)
    bundle = adjusted(placed, boards, sightings, usual=usual, options=options)
    return bundle.cameras, _report(bundle, views, sightings, shots)


def _sightings(board: Board, views: Sequence[BoardViews], shots: np.ndarray) -> Sightings:
    camera = np.repeat(np.arange(len(views)), [len(v.shot) for v in views])
    shot, corner, pixel = (np.concatenate([getattr(v, part) for v in views]) for part in ("shot", "corner", "pixel"))
    return Sightings(camera=camera, body=np.searchsorted(shots, shot), point=board.corners[corner], pixel=pixel)


def _opened(board: Board, views: BoardViews, options: BundleOptions) -> Camera:
    """A first guess of the lens, by Zhang's method with at most OpenCV's five first numbers."""
    count = len(views.seen)
    require(count >= _FEWEST, f"{views.name} board", f"be seen in {_FEWEST} pictures", f"{count} of {views.shots}")
    chosen = views.seen[np.unique(np.linspace(0, count - 1, min(count, _START)).astype(int))]
    rows = [views.shot == shot for shot in chosen]
    points = [board.corners[views.corner[r]].astype(np.float32) for r in rows]
    pixels = [views.pixel[r].astype(np.float32) for r in rows]
    known = min(options.coefficients, 5)
    flags = cv2.CALIB_FIX_K3 if known < 5 else 0
    if known == 0:
        flags |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_ZERO_TANGENT_DIST
    _, K, distortion, _, _ = cv2.calibrateCamera(points, pixels, views.size, None, None, flags=flags)
    padded = np.zeros(options.coefficients)
    padded[:known] = np.ravel(distortion)[:known]
    stream = views.name.split(".")[-1]
    stream = stream if stream in STREAMS else "colour"
    return Camera(name=views.name, K=K, T_camera_world=np.eye(4), size=views.size, distortion=padded, stream=stream)


def _report(bundle: Bundle, views: Sequence[BoardViews], sightings: Sightings, shots: np.ndarray) -> RigReport:
    cameras = []
    for c, seen in enumerate(views):
        mine = sightings.camera == c
        square = (bundle.residual[mine & bundle.kept] ** 2).sum(axis=1)
        deviation = np.sqrt(np.diag(bundle.covariance[c]))
        hull = cv2.contourArea(cv2.convexHull(seen.pixel.astype(np.float32)))
        report = CameraReport(
            name=seen.name,
            views=len(seen.seen),
            corners=int(mine.sum()),
            strays=int((mine & ~bundle.kept).sum()),
            error_px=float(np.sqrt(square.mean())) if len(square) else float("inf"),
            covered=float(hull / (seen.size[0] * seen.size[1])),
            turn_error_deg=float(np.degrees(np.linalg.norm(deviation[:3]))),
            place_error_mm=float(1e3 * np.linalg.norm(deviation[3:])),
            focal_error_px=float(bundle.lens_error[c, :2].mean()),
        )
        cameras.append(report)
    return RigReport(
        cameras=tuple(cameras),
        noise_px=bundle.noise_px,
        covariance=bundle.covariance,
        shots=shots,
        T_world_board=bundle.T_world_body,
    )
