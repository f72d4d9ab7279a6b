"""What a camera sees behind the object: black cloth in folds, a round table under it, the lamps."""

import cv2
import numpy as np

from recon.cameras import Camera
from recon.rig.light import COLOURS, LAMPS
from recon.rig.texture import noise

TABLE = 0.19  # [m] radius
ROOM = 2.1  # [m] from the middle to the cloth
CLOTH = np.array([0.0036, 0.0036, 0.0044])  # as bright as it looks, linear
FLOOR = -0.75  # [m]
COARSE = 2, 400  # pixels a sample of the backdrop, whose only sharp edges are the lamps', in pictures of this width
LAMP = 0.085  # [m] radius
GLOW = 0.05  # [rad]


def backdrop(camera: Camera) -> np.ndarray:
    """The picture (height, width, 3) float32, linear RGB, of the empty stage; the camera is one on the stage."""
    width, height = camera.size
    steps = COARSE[0] if width >= COARSE[1] else 1
    coarse = (width // steps, height // steps)
    small = camera.resized(coarse)
    rays = small.rays(small.grid()).reshape(-1, 3)
    picture = _cloth(camera.centre, rays)
    table = _table(camera.centre, rays)
    picture = np.where(table[:, :1] >= 0, table, picture) + _lamps(camera.centre, rays)
    picture = picture.reshape(coarse[1], coarse[0], 3).astype(np.float32)
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_LINEAR)


def _cloth(eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """The sheet round the stage: folds that hang down to the floor, brighter where a lamp is near."""
    middle = eye @ rays.T
    far = -middle + np.sqrt(np.maximum(middle**2 - eye @ eye + ROOM**2, 0))
    down = np.where(rays[:, 2] < -1e-6, (FLOOR - eye[2]) / np.minimum(rays[:, 2], -1e-6), np.inf)
    place = eye + np.minimum(far, down)[:, None] * rays
    angle = np.arctan2(place[:, 1], place[:, 0]) + 0.05 * noise(place, 0.5, 21)
    hanging = np.clip((place[:, 2] - FLOOR) / 0.15, 0, 1) * np.clip((ROOM - place[:, 2]) / 0.8, 0, 1)
    fold = 1 + hanging * (0.30 * np.sin(23 * angle) + 0.18 * np.sin(57 * angle + 1.3)) + 0.3 * noise(place, 0.25, 22)
    near = sum(np.exp(-((place - lamp) ** 2).sum(1) / 0.6**2) for lamp in LAMPS)
    return CLOTH * (np.clip(fold, 0.2, 2) * (0.6 + 0.8 * near))[:, None]


def _table(eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """The covered table, -1 where the ray misses it; darker under the object."""
    far = np.where(rays[:, 2] < -1e-6, -eye[2] / np.minimum(rays[:, 2], -1e-6), np.nan)
    place = eye + far[:, None] * rays
    r = np.linalg.norm(place[:, :2], axis=1)
    on = np.nan_to_num(r, nan=np.inf) < TABLE
    out = np.full((len(rays), 3), -1.0)
    crease = 1 + 0.35 * noise(place[on] * [1, 1.6, 1], 0.05, 23) + 0.2 * noise(place[on], 0.012, 24)
    shadow = 1 - 0.65 * np.exp(-((r[on] / 0.10) ** 4))
    out[on] = CLOTH * (1.6 * crease * shadow)[:, None]
    return out


def _lamps(eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Discs far brighter than the sensor can show, with a glow round them."""
    out = np.zeros((len(rays), 3))
    for lamp, colour in zip(LAMPS, COLOURS, strict=True):
        way = lamp - eye
        angle = np.arccos(np.clip(rays @ way / np.linalg.norm(way), -1, 1))
        edge = np.arctan(LAMP / np.linalg.norm(way))
        disc = np.clip((edge - angle) / 0.004 + 0.5, 0, 1)
        halo = 0.05 * np.exp(-np.maximum(angle - edge, 0) / GLOW) * (angle < 6 * GLOW)
        out += (4 * disc + halo)[:, None] * colour
    return out
