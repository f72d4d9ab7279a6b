"""Pictures of flat printed things (boards, markers) as a camera with a real lens sees them, by casting rays."""

import cv2
import numpy as np

from recon.cameras import Camera

FINE = 4  # rays a pixel, along each side
DARK = 12.0  # the cloth behind


def picture(
    camera: Camera,
    T_world_plane: np.ndarray,
    print_: np.ndarray,
    width: float,
    *,
    noise: float,
    blur: float = 0.6,
    light: float = 0.75,
    rng: np.random.Generator,
) -> np.ndarray:
    """A grey picture (height, width) uint8 of the print (h, w) whose sides are `width` and `width h / w` [m].

    The print lies in its plane z = 0 around the origin, its columns along +x and its rows along -y. blur: of the
    lens [px]; noise: grey levels; light: grey levels seen for one printed.
    """
    image = np.full(camera.size[::-1], DARK)
    height = width * print_.shape[0] / print_.shape[1]
    corners = np.array([[x, y, 0.0] for x in (-width / 2, width / 2) for y in (-height / 2, height / 2)])
    pixels, _ = camera.project(corners @ T_world_plane[:3, :3].T + T_world_plane[:3, 3])
    low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 8, 0)
    high = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 9, camera.size)
    if (high > low).all():
        part = camera.cropped(*low, tuple(high - low))
        image[low[1] : high[1], low[0] : high[0]] = _part(part, T_world_plane, print_, width, light)
    image = cv2.GaussianBlur(image, (0, 0), blur)
    return np.clip(np.rint(image + noise * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8)


def _part(camera: Camera, T_world_plane: np.ndarray, print_: np.ndarray, width: float, light: float) -> np.ndarray:
    """A part of the picture; where its rays meet the plane is smooth, so it is found once a pixel and spread."""
    R, t = T_world_plane[:3, :3], T_world_plane[:3, 3]
    rays, eye = camera.rays(camera.grid()) @ R, (camera.centre - t) @ R
    where = eye[:2] - rays[..., :2] * (eye[2] / rays[..., 2:])
    scale, middle = print_.shape[1] / width, (np.array(print_.shape[::-1]) - 1) / 2
    place = (where * scale * [1, -1] + middle).astype(np.float32)
    fine = cv2.resize(place, (camera.size[0] * FINE, camera.size[1] * FINE), interpolation=cv2.INTER_LINEAR)
    seen = cv2.remap(light * print_.astype(np.float32), fine, None, cv2.INTER_LINEAR, borderValue=-1.0)
    seen = cv2.resize(np.where(seen < 0, DARK, seen), camera.size, interpolation=cv2.INTER_AREA)
    return np.where(rays[..., 2] * eye[2] < 0, seen, DARK)
