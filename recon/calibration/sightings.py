"""Points of rigid bodies seen in pictures, where cameras predict them, and how every unknown moves them."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import cv2
import numpy as np

from recon.cameras import Camera
from recon.rigid import cross_matrix, moved

LENS = 18  # fx, fy, cx, cy and OpenCV's 14 coefficients of distortion
_NOWHERE = 1e5  # [px], where a point behind a camera is said to be: farther from the truth than anything in front


@dataclass(frozen=True, kw_only=True, eq=False)
class Sightings:
    """Points of bodies (boards, markers) found in pictures, one row each."""

    camera: np.ndarray  # (M,) int
    body: np.ndarray  # (M,) int
    point: np.ndarray  # (M, 3) [m], in the body's frame
    pixel: np.ndarray  # (M, 2) [px]

    def chosen(self, rows: np.ndarray) -> "Sightings":
        """The rows of a mask or index."""
        return replace(self, **{name: getattr(self, name)[rows] for name in ("camera", "body", "point", "pixel")})


@dataclass(frozen=True, kw_only=True, eq=False)
class Projection:
    """Predicted pixels and their slopes by small changes.

    by_camera and by_body: a turn [rad] then a shift [m]; the camera's `R <- exp([w]) R`, centre `c <- c + v`, the
    body's `R <- exp([w]) R`, `t <- t + v` in the world. by_lens: fx, fy, cx, cy, then the coefficients.
    """

    pixel: np.ndarray  # (M, 2) [px]
    by_camera: np.ndarray  # (M, 2, 6)
    by_lens: np.ndarray  # (M, 2, 18)
    by_body: np.ndarray  # (M, 2, 6)

    def where(self, rows: np.ndarray, other: "Projection") -> "Projection":
        """This one's rows where (M,) bool says so, the other's elsewhere."""
        parts = {f.name: (getattr(self, f.name), getattr(other, f.name)) for f in fields(self)}
        chosen = {name: np.where(rows.reshape(-1, *[1] * (a.ndim - 1)), a, b) for name, (a, b) in parts.items()}
        return Projection(**chosen)


def lens_of(camera: Camera) -> np.ndarray:
    """(18,): fx, fy, cx, cy and the 14 coefficients, zero where the camera has fewer."""
    lens = np.zeros(LENS)
    lens[:4] = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    lens[4 : 4 + len(camera.distortion)] = camera.distortion
    return lens


def with_lens(camera: Camera, lens: np.ndarray, coefficients: int) -> Camera:
    """The camera with another lens (18,), of which the first so many coefficients are kept."""
    K = np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1.0]])
    return replace(camera, K=K, distortion=lens[4 : 4 + coefficients])


def lenses(cameras: Sequence[Camera]) -> np.ndarray:
    """(C, 18) of all cameras."""
    return np.array([lens_of(camera) for camera in cameras]).reshape(-1, LENS)


def projected(
    lens: np.ndarray, T_camera_world: np.ndarray, T_world_body: np.ndarray, sightings: Sightings
) -> Projection:
    """Where cameras (C, 18), (C, 4, 4) should see the points of bodies (B, 4, 4), and the slopes."""
    count = len(sightings.camera)
    pixel, by_local, by_lens = np.empty((count, 2)), np.empty((count, 2, 3)), np.empty((count, 2, LENS))
    body, R = T_world_body[sightings.body], T_camera_world[sightings.camera, :3, :3]
    arm = np.einsum("mij,mj->mi", body[:, :3, :3], sightings.point)
    local = moved(T_camera_world[sightings.camera], arm + body[:, :3, 3])
    for c in np.unique(sightings.camera):
        rows = np.flatnonzero(sightings.camera == c)
        pixel[rows], by_local[rows], by_lens[rows] = _seen(lens[c], local[rows])
    by_world = by_local @ R
    by_camera = np.concatenate([-by_local @ cross_matrix(local), -by_world], axis=2)
    by_body = np.concatenate([-by_world @ cross_matrix(arm), by_world], axis=2)
    return Projection(pixel=pixel, by_camera=by_camera, by_lens=by_lens, by_body=by_body)


def residuals(
    lens: np.ndarray, T_camera_world: np.ndarray, T_world_body: np.ndarray, sightings: Sightings
) -> np.ndarray:
    """Predicted less seen pixels (M, 2)."""
    return projected(lens, T_camera_world, T_world_body, sightings).pixel - sightings.pixel


def _seen(lens: np.ndarray, local: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels (n, 2) of points (n, 3) in the camera's frame, their slopes by the point (n, 2, 3) and the lens."""
    K = np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1.0]])
    ahead = local[:, 2] > 0
    safe = np.where(ahead[:, None], local, [0.0, 0.0, 1.0])
    pixel, slopes = cv2.projectPoints(safe[:, None], np.zeros(3), np.zeros(3), K, lens[4:])
    slopes = slopes.reshape(len(local), 2, -1) * ahead[:, None, None]
    pixel = np.where(ahead[:, None], pixel[:, 0], _NOWHERE)
    return pixel, slopes[:, :, 3:6], slopes[:, :, 6 : 6 + LENS]
