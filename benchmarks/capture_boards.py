"""Calibrating the rig from drawn pictures of a ChArUco board, through the rig's own lenses, with noise."""

from collections.abc import Iterator

import cv2
import numpy as np

from benchmarks.table import Row
from recon.calibration.calibrate import calibrate_rig
from recon.calibration.charuco import Board, find_board
from recon.cameras import Camera
from recon.rig.options import RigOptions
from recon.rig.stage import build_stage
from recon.rigid import inverse, moved, rigid

BOARD = Board(columns=9, rows=6, square=0.05, marker=0.0375)
MIDDLE = np.array([0.225, 0.15, 0.0])  # of the board [m]
PRINT, FINE = 60, 3  # pixels a square of the print; rays a pixel, along each side
DARK, LIGHT = 12.0, 0.75
CLOSE = 6  # boards held before each camera by itself, for its lens
NOISE = 2.0  # grey levels
FACING = 0.35  # cosine below which a board is seen too much from its edge


def calibration_rows(cameras: int, size: int, shots: int, seed: int = 0) -> list[Row]:
    """Reprojection error, and how far cameras are from their true places once the rigs are laid on each other."""
    stage = build_stage(RigOptions(cameras=cameras, frames=2, size=size, greys=False))
    rng = np.random.default_rng(seed)
    rig = [c for c in stage.cameras if c.role == "train"]
    target = stage.to_world(np.array([0, 0, 0.15]))
    boards = [*_all_round(rig, target, shots, rng), *(T for c in rig for T in _before(c, rng))]
    views = [find_board(BOARD, c.name, pictures(c, boards, rng)) for c in rig]
    found, report = calibrate_rig(BOARD, views, first=rig[0].T_camera_world)
    off = 1e3 * np.linalg.norm([a.centre - b.centre for a, b in zip(rig, found, strict=True)], axis=1)
    what = f"Calibration, {len(rig)} cameras of {size} pixels' width, {len(boards)} boards"
    return [
        Row(what=f"{what}: reprojection error", figure=f"{report.error_px:.2f} px", target="<= 0.5 px",
            reached=bool(report.error_px <= 0.5)),
        Row(what=f"{what}: cameras' places, lenses found too", figure=f"{off.mean():.2f} mm (at most {off.max():.2f})"),
    ]  # fmt: skip


def pictures(camera: Camera, boards: list[np.ndarray], rng: np.random.Generator) -> Iterator[np.ndarray | None]:
    """A grey picture (height, width) uint8 of each board; None where it shows its back or is out of the picture."""
    rays = camera.rays(camera.grid())
    for T in boards:
        yield _drawn(camera, rays, T, rng) if _shown(camera, T) else None


def _shown(camera: Camera, T_world_board: np.ndarray) -> bool:
    ends = 2 * MIDDLE * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    pixels, depth = camera.project(moved(T_world_board, ends))
    way, half = camera.centre - moved(T_world_board, MIDDLE), np.array(camera.size) / 2
    inside = (np.abs(pixels - half) < half).all(axis=1).sum() >= 2 and (depth > 0.1).all()
    return bool(inside and -T_world_board[:3, 2] @ way > FACING * np.linalg.norm(way))


def _drawn(camera: Camera, rays: np.ndarray, T_world_board: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    R, t = T_world_board[:3, :3], T_world_board[:3, 3]
    rays, eye = rays @ R, (camera.centre - t) @ R
    place = eye[:2] - rays[..., :2] * (eye[2] / rays[..., 2:])
    place = (place * PRINT / BOARD.square - 0.5).astype(np.float32)
    fine = cv2.resize(place, None, fx=FINE, fy=FINE, interpolation=cv2.INTER_LINEAR)
    seen = cv2.remap(LIGHT * BOARD.print(PRINT).astype(np.float32), fine, None, cv2.INTER_LINEAR, borderValue=DARK)
    seen = cv2.GaussianBlur(cv2.resize(seen, camera.size, interpolation=cv2.INTER_AREA), (0, 0), 0.6)
    return np.clip(np.rint(seen + NOISE * rng.standard_normal(seen.shape)), 0, 255).astype(np.uint8)


def _all_round(rig: list[Camera], target: np.ndarray, shots: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Boards near the object's place, each facing between two neighbouring cameras."""
    out = []
    for shot in range(shots):
        first, second = rig[shot % len(rig)], rig[(shot + 1) % len(rig)]
        eye = (first.centre + second.centre) / 2 + 0.1 * rng.normal(size=3)
        out.append(_facing(target + 0.06 * rng.normal(size=3), eye, rng))
    return out


def _before(camera: Camera, rng: np.random.Generator) -> list[np.ndarray]:
    """Boards that one camera sees large and in the corners of its picture, tilted every way."""
    shift = np.stack(
        [*rng.uniform(-0.1, 0.1, (1, CLOSE)), *rng.uniform(-0.2, 0.2, (1, CLOSE)), rng.uniform(0.45, 0.7, CLOSE)],
        axis=1,
    )
    T = rigid(rng.uniform(-0.5, 0.5, (CLOSE, 3)), shift) @ rigid(np.zeros(3), -MIDDLE)
    return list(inverse(camera.T_camera_world) @ T)


def _facing(place: np.ndarray, eye: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """T_world_board (4, 4) of a board around a place whose front, -z, looks to the eye, rolled by chance."""
    z = (place - eye) / np.linalg.norm(place - eye)
    x = np.cross(z, rng.normal(size=3))
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), place
    return T @ rigid(np.zeros(3), -MIDDLE)
