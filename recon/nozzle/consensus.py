"""Poses of a marker on which the cameras agree, from every pose that any one of them allows."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from recon.calibration.bodies import fitted_bodies
from recon.calibration.sightings import Sightings, lenses, residuals
from recon.cameras import Camera
from recon.marker import Marker
from recon.rigid import inverse

_GATE = 1.0  # sides of the marker: how far one camera's guess may lie from what another saw


@dataclass(frozen=True, kw_only=True, eq=False)
class Detections:
    """Where the marker was found: one row for each find in a picture."""

    frame: np.ndarray  # (D,) int
    camera: np.ndarray  # (D,) int
    corners: np.ndarray  # (D, 4, 2) [px]


@dataclass(frozen=True, kw_only=True, eq=False)
class Hypotheses:
    """Poses fitted jointly to all finds that agree with them; `pair` rows say which."""

    frame: np.ndarray  # (H,) int
    T_world_marker: np.ndarray  # (H, 4, 4) [m]
    normal: np.ndarray  # (H, 6, 6)
    cost: np.ndarray  # (H,) [px2]
    views: np.ndarray  # (H,) int, cameras that agree
    pair: np.ndarray  # (P, 2) int, hypothesis and find
    error: np.ndarray  # (P,) [px2], sum of squares over the find's corners


def hypotheses(marker: Marker, cameras: Sequence[Camera], found: Detections, *, agreement: float) -> Hypotheses:
    """Every pose of the marker that some camera allows, fitted to all cameras that agree with it.

    Each find gives the two poses of a square (IPPE; Collins and Bartoli 2014). Another camera's find joins a pose when
    it lies within a marker's side of where the pose predicts it; after the joint fit the worst find farther off than
    `agreement` [px] (root mean square of its corners) leaves and the rest is fitted again.
    """
    T, source = _candidates(marker, cameras, found)
    pair = _joined(marker, cameras, found, T, source)
    lens, T_camera = lenses(cameras), np.array([camera.T_camera_world for camera in cameras])
    while True:
        seen = _sightings(marker, found, pair)
        fit = fitted_bodies(lens, T_camera, T, seen, loose=agreement)
        error = (fit.residual**2).sum(axis=1).reshape(-1, 4).sum(axis=1)
        leaves = _worst(pair, error, len(T)) & (error > 4 * agreement**2)
        if not leaves.any():
            break
        T, pair = fit.T_world_body, pair[~leaves]
    return Hypotheses(
        frame=found.frame[source],
        T_world_marker=fit.T_world_body,
        normal=fit.normal,
        cost=fit.cost,
        views=np.bincount(pair[:, 0], minlength=len(T)),
        pair=pair,
        error=error,
    )


def _candidates(marker: Marker, cameras: Sequence[Camera], found: Detections) -> tuple[np.ndarray, np.ndarray]:
    """Both poses (H, 4, 4) of each find, and the find (H,) that each comes from."""
    poses, source = [], []
    for d, (c, corners) in enumerate(zip(found.camera, found.corners, strict=True)):
        rays = cameras[c].rays(corners) @ cameras[c].T_camera_world[:3, :3].T
        plane = np.ascontiguousarray(rays[:, :2] / rays[:, 2:])
        _, turns, shifts, _ = cv2.solvePnPGeneric(
            marker.corners, plane, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        for turn, shift in zip(turns, shifts, strict=True):
            T_camera_marker = np.eye(4)
            T_camera_marker[:3, :3], T_camera_marker[:3, 3] = cv2.Rodrigues(turn)[0], np.ravel(shift)
            poses.append(inverse(cameras[c].T_camera_world) @ T_camera_marker)
            source.append(d)
    return np.array(poses).reshape(-1, 4, 4), np.array(source, int)


def _joined(
    marker: Marker, cameras: Sequence[Camera], found: Detections, T: np.ndarray, source: np.ndarray
) -> np.ndarray:
    """Pairs (P, 2) of a pose and the nearest find of each camera that lies within the gate."""
    order = np.argsort(found.frame, kind="stable")
    first = np.searchsorted(found.frame[order], found.frame[source], side="left")
    last = np.searchsorted(found.frame[order], found.frame[source], side="right")
    h = np.repeat(np.arange(len(T)), last - first)
    d = order[np.concatenate([np.arange(a, b) for a, b in zip(first, last, strict=True)])]
    all_pairs = np.stack([h, d], axis=1)
    T_camera = np.array([camera.T_camera_world for camera in cameras])
    off = residuals(lenses(cameras), T_camera, T, _sightings(marker, found, all_pairs)).reshape(-1, 4, 2)
    distance = np.linalg.norm(off, axis=2).max(axis=1) / _side(found.corners)[d]
    ranked = np.lexsort([distance, found.camera[d], h])
    new = np.ones(len(ranked), bool)
    same_pose, same_camera = np.diff(h[ranked]) == 0, np.diff(found.camera[d][ranked]) == 0
    new[1:] = ~(same_pose & same_camera)
    nearest = np.sort(ranked[new])
    return all_pairs[nearest[distance[nearest] < _GATE]]


def _side(corners: np.ndarray) -> np.ndarray:
    """The longest side (D,) [px] of quadrilaterals (D, 4, 2)."""
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)


def _sightings(marker: Marker, found: Detections, pair: np.ndarray) -> Sightings:
    h, d = np.repeat(pair, 4, axis=0).T
    points = np.tile(marker.corners, (len(pair), 1))
    return Sightings(camera=found.camera[d], body=h, point=points, pixel=found.corners[pair[:, 1]].reshape(-1, 2))


def _worst(pair: np.ndarray, error: np.ndarray, count: int) -> np.ndarray:
    """(P,) bool, the worst find of each pose."""
    most = np.zeros(count)
    np.maximum.at(most, pair[:, 0], error)
    return error >= most[pair[:, 0]]
