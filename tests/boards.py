"""Rigs of cameras around a table and what they see of a board, for tests of calibration."""

import numpy as np

from recon.calibration.charuco import Board, BoardViews
from recon.cameras import Camera, look_at
from recon.rigid import inverse, moved, rigid

BOARD = Board(columns=9, rows=6, square=0.06, marker=0.045)
MIDDLE = np.array([0.27, 0.18, 0.0])  # of the board [m]
LENS = np.array([0.08, -0.15, 0.0005, -0.0003, 0.05])
SIZE = (1280, 800)


def ring(count: int, rng: np.random.Generator, *, lens: np.ndarray = LENS) -> list[Camera]:
    """Cameras in a ring of radius 800 mm at three heights, looking inwards, no two with the same focal length."""
    cameras = []
    for k in range(count):
        angle, f = 2 * np.pi * k / count, 870 * (1 + 0.03 * rng.normal())
        eye = np.array([0.8 * np.cos(angle), 0.8 * np.sin(angle), 0.1 + 0.17 * (k % 3)])
        T = look_at(eye, 0.02 * rng.normal(size=3), np.array([0.0, 0, 1]))
        cx, cy = np.array([639.5, 399.5]) + 5 * rng.normal(size=2)
        K = np.array([[f, 0, cx], [0, 1.001 * f, cy], [0, 0, 1]])
        cameras.append(Camera(name=f"cam{k + 1:04d}", K=K, T_camera_world=T, size=SIZE, distortion=lens))
    return cameras


def poses(count: int, rng: np.random.Generator) -> np.ndarray:
    """T_world_board (S, 4, 4) of boards held up near the middle of the table, facing all round, a little up or down."""
    none, along = np.zeros((count, 3)), np.eye(3)
    facing = rigid(np.array([0, -np.pi / 2, 0]), np.zeros(3))  # the front, -z, looks along the world's x
    roll, tilt, yaw = rng.uniform(-1, 1, (3, count, 1)) * np.array([np.pi, 0.6, np.pi])[:, None, None]
    turned = rigid(yaw * along[2], rng.uniform(-0.1, 0.1, (count, 3))) @ rigid(tilt * along[1], none) @ facing
    return turned @ rigid(roll * along[2], none) @ rigid(np.zeros(3), -MIDDLE)


def held_close(camera: Camera, count: int, rng: np.random.Generator) -> np.ndarray:
    """T_world_board (S, 4, 4) of boards that fill one camera's picture, tilted every way."""
    shift = np.concatenate([rng.uniform(-0.12, 0.12, (count, 2)), rng.uniform(0.5, 0.8, (count, 1))], axis=1)
    T = rigid(rng.uniform(-0.5, 0.5, (count, 3)), shift) @ rigid(np.zeros(3), -MIDDLE)
    return inverse(camera.T_camera_world) @ T


def views_of(cameras: list[Camera], boards: np.ndarray, rng: np.random.Generator, *, noise: float) -> list[BoardViews]:
    """What each camera sees of boards (S, 4, 4) that show it their front, corners off by `noise` [px]."""
    return [_views(camera, boards, rng, noise) for camera in cameras]


def _views(camera: Camera, boards: np.ndarray, rng: np.random.Generator, noise: float) -> BoardViews:
    shots, corners, pixels = [], [], []
    for shot, T in enumerate(boards):
        sight = camera.centre - moved(T, MIDDLE)
        facing = -T[:3, 2] @ sight / np.linalg.norm(sight) > 0.45
        where, depth = camera.project(moved(T, BOARD.corners))
        where = where + noise * rng.normal(size=where.shape)
        inside = (where > 8).all(axis=1) & (where < np.array(camera.size) - 9).all(axis=1) & (depth > 0)
        if facing and inside.sum() >= 8:
            corner = np.flatnonzero(inside)
            shots.append(np.full(len(corner), shot))
            corners.append(corner)
            pixels.append(where[corner])
    shot, corner = (np.concatenate([*rows, np.zeros(0, int)]).astype(int) for rows in (shots, corners))
    pixel = np.concatenate([*pixels, np.zeros((0, 2))])
    return BoardViews(name=camera.name, size=camera.size, shots=len(boards), shot=shot, corner=corner, pixel=pixel)
