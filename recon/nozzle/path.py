"""The air nozzle's marker followed through all cameras that see it (paper "Dataset": three cameras, ArUco)."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from recon.cameras import Camera
from recon.marker import Finder, Marker
from recon.nozzle.choosing import chosen, noise_of
from recon.nozzle.consensus import Detections, Hypotheses, hypotheses
from recon.nozzle.gaps import filled
from recon.plush.reconstruction import MARKER_ID, MM, NOZZLE_IN_MARKER, STREAM_IN_MARKER, NozzlePath
from recon.rigid import cross_matrix, moved
from sim.checks import require

MARKER = Marker(id=MARKER_ID, side=0.04)
_PRIOR = 10.0  # measurements that the track's noise counts for beside a frame's own


@dataclass(frozen=True, kw_only=True)
class TrackOptions:
    """agreement: largest root mean square [px] of a find's four corners at which it still belongs to the others."""

    agreement: float = 1.5

    def __post_init__(self) -> None:
        require(self.agreement > 0, "agreement", "be positive", self.agreement)


@dataclass(frozen=True, kw_only=True, eq=False)
class NozzleTrack:
    """The marker's pose by frame; where `seen` is False it is interpolated or held, and its covariance says so.

    covariance: of a turn [rad] and then a shift [m], both in the world's axes at the marker's centre; it knows the
    noise of the pictures but not errors of the cameras' own calibration.
    """

    T_world_marker: np.ndarray  # (T, 4, 4) [m]
    covariance: np.ndarray  # (T, 6, 6)
    seen: np.ndarray  # (T,) bool
    views: np.ndarray  # (T,) int, cameras that the pose rests on
    guided: np.ndarray  # (T,) bool, one of several equal poses, chosen by the neighbouring frames
    rejected: np.ndarray  # (C,) int, finds of each camera that no chosen pose agrees with
    error_px: np.ndarray  # (C,) root mean square of the corners [px], NaN for a camera that sees nothing
    noise_px: float  # of one coordinate of one corner [px]
    cameras: tuple[str, ...]

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a user should know of frames and cameras."""
        missing, guided = int((~self.seen).sum()), int(self.guided.sum())
        counted = [(missing, "no pose could be found; it is interpolated")] if missing else []
        counted += [(guided, "two poses fit equally well; the neighbouring frames decided")] if guided else []
        said = [f"marker: in {n} of {len(self.seen)} frames {what}" for n, what in counted]
        left_out = [(name, n) for name, n in zip(self.cameras, self.rejected, strict=True) if n]
        return (
            *said,
            *(f"{name}: finds of the marker that agree with no pose and were left out: {n}" for name, n in left_out),
        )


def track(
    cameras: Sequence[Camera],
    frames: Iterable[Sequence[np.ndarray | None]],
    *,
    marker: Marker = MARKER,
    options: TrackOptions | None = None,
) -> NozzleTrack:
    """Follow the marker: `frames` gives one picture of each camera at a time, None where a camera has none.

    Raises ValueError for a picture of another size, naming camera and frame, and when no frame gives a pose.
    """
    found, others, count = _found(cameras, frames, marker)
    return track_of(cameras, found, count, others=others, marker=marker, options=options)


def track_of(
    cameras: Sequence[Camera],
    found: Detections,
    count: int,
    *,
    others: Sequence[int] = (),
    marker: Marker = MARKER,
    options: TrackOptions | None = None,
) -> NozzleTrack:
    """The track of what was found in `count` frames of each camera; others: ids of other markers that were seen.

    Raises ValueError when no frame gives a pose.
    """
    options = options or TrackOptions()
    got = f"ids {', '.join(map(str, others))}" if others else "no marker at all"
    require(len(found.frame) > 0, f"marker {marker.id}", f"be seen by {_names(cameras)}", got)
    poses = hypotheses(marker, cameras, found, agreement=options.agreement)
    pick, guided = chosen(poses, count, marker.side)
    require(bool((pick >= 0).any()), f"marker {marker.id}", "have one pose in at least one frame", "none")
    return _assembled(cameras, found, poses, pick, guided)


def nozzle_path(track: NozzleTrack) -> NozzlePath:
    """Where the stream starts and blows: `p = R (0, 105 mm, 0) + t`, `d = R (0, 0, -1)`."""
    R = track.T_world_marker[:, :3, :3]
    start = moved(track.T_world_marker, np.broadcast_to(MM * NOZZLE_IN_MARKER, (len(R), 3)))
    return NozzlePath(position=start, direction=R @ STREAM_IN_MARKER, seen=track.seen.copy())


def stream_covariance(track: NozzleTrack) -> tuple[np.ndarray, np.ndarray]:
    """Covariances (T, 3, 3) of where the stream starts [m2] and of its direction [rad2]."""
    R, eye = track.T_world_marker[:, :3, :3], np.broadcast_to(np.eye(3), (len(track.seen), 3, 3))
    start = np.concatenate([-cross_matrix(R @ (MM * NOZZLE_IN_MARKER)), eye], axis=2)
    turned = -cross_matrix(R @ STREAM_IN_MARKER)
    by_turn = track.covariance[:, :3, :3]
    return start @ track.covariance @ np.swapaxes(start, 1, 2), turned @ by_turn @ np.swapaxes(turned, 1, 2)


def _assembled(
    cameras: Sequence[Camera], found: Detections, poses: Hypotheses, pick: np.ndarray, guided: np.ndarray
) -> NozzleTrack:
    """The track of the picked poses (T,), its gaps filled."""
    seen = pick >= 0
    rows, noise = pick[seen], noise_of(poses, pick[seen])
    T, covariance = np.tile(np.eye(4), (len(pick), 1, 1)), np.zeros((len(pick), 6, 6))
    T[seen] = poses.T_world_marker[rows]
    spare = 8 * poses.views[rows] - 6
    own = (_PRIOR * noise**2 + poses.cost[rows]) / (_PRIOR + spare)
    covariance[seen] = own[:, None, None] * np.linalg.inv(poses.normal[rows])
    T, covariance = filled(T, covariance, seen)
    used = np.isin(poses.pair[:, 0], rows)
    camera = found.camera[poses.pair[used, 1]]
    finds, agreed = (np.bincount(c, minlength=len(cameras)) for c in (found.camera, camera))
    squares = np.bincount(camera, poses.error[used], minlength=len(cameras))
    error = np.sqrt(np.divide(squares, 4 * agreed, out=np.full(len(cameras), np.nan), where=agreed > 0))
    return NozzleTrack(
        T_world_marker=T,
        covariance=covariance,
        seen=seen,
        views=np.where(seen, poses.views[pick], 0),
        guided=guided,
        rejected=finds - agreed,
        error_px=error,
        noise_px=noise,
        cameras=tuple(camera.name for camera in cameras),
    )


def _names(cameras: Sequence[Camera]) -> str:
    return ", ".join(camera.name for camera in cameras)


def _found(
    cameras: Sequence[Camera], frames: Iterable[Sequence[np.ndarray | None]], marker: Marker
) -> tuple[Detections, tuple[int, ...], int]:
    """All finds, the other ids seen, and the number of frames."""
    finders = [Finder(marker, camera) for camera in cameras]
    rows, others, count = [], set(), 0
    for frame, images in enumerate(frames):
        require(len(images) == len(cameras), f"frame {frame}", f"hold {len(cameras)} pictures", len(images))
        for c, (finder, image) in enumerate(zip(finders, images, strict=True)):
            if image is not None:
                found = finder(image, frame)
                rows += [(frame, c, corners) for corners in found.corners]
                others.update(found.others)
        count = frame + 1
    frame, camera = (np.array([row[k] for row in rows], int) for k in (0, 1))
    corners = np.array([row[2] for row in rows]).reshape(-1, 4, 2)
    return Detections(frame=frame, camera=camera, corners=corners), tuple(sorted(others)), count
