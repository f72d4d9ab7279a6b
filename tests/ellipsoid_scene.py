"""A coloured ellipsoid before black cloth, filmed by a few cameras: silhouettes and pictures in closed form."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from recon.cameras import Camera, look_at

RADII = np.array([0.10, 0.06, 0.08])  # [m]
LENS = np.array([0.1, -0.05, 0.001, 0.002, 0.01, 0, 0, 0, 0.001, 0, 0, 0])


def ring(count: int, size: tuple[int, int] = (72, 96), focal: float = 110.0) -> list[Camera]:
    """Cameras 0.8 m from the origin, spread over all sides, with the dataset's kind of distortion."""
    cameras = []
    for i in range(count):
        y = -0.3 + 0.9 * ((0.618 * i) % 1)
        flat = np.sqrt(1 - y * y)
        eye = 0.8 * np.array([np.cos(2.4 * i) * flat, y, np.sin(2.4 * i) * flat])
        K = np.array([[focal, 0, size[0] / 2 - 0.7], [0, 1.01 * focal, size[1] / 2 + 0.4], [0, 0, 1]])
        T = look_at(eye, np.zeros(3), np.array([0, 1.0, 0]))
        cameras.append(Camera(name=f"cam{i + 1:04d}", K=K, T_camera_world=T, size=size, distortion=LENS))
    return cameras


@dataclass(frozen=True)
class Scene:
    """The ellipsoid's middle by frame (T, 3) [m]; late: camera name -> how many frames behind it films."""

    middle: np.ndarray
    late: tuple[tuple[str, int], ...] = ()

    def frames(self, camera: Camera) -> Iterator[np.ndarray]:
        """Upright pictures, RGB uint8, grey for left and right, with a little noise."""
        rays, late = camera.rays(camera.grid()), dict(self.late).get(camera.name, 0)
        rng = np.random.default_rng(sum(camera.name.encode()))
        for frame in range(len(self.middle)):
            image = drawn(camera, self.middle[max(0, frame - late)], rays) + rng.normal(0, 2, (*rays.shape[:2], 1))
            image = image.clip(0, 255).astype(np.uint8)
            yield image if camera.stream == "colour" else image[..., 1].copy()


def swaying(frames: int, seed: int = 0) -> np.ndarray:
    """A way (frames, 3) [m] that never repeats itself."""
    rng = np.random.default_rng(seed)
    steps = np.convolve(rng.normal(size=frames + 5), np.ones(6) / 6, "valid")
    return 0.006 * np.cumsum(steps)[:, None] * np.array([1.0, 0.3, 0.5])


def silhouette(camera: Camera, middle: np.ndarray) -> np.ndarray:
    """True (height, width) where the ray through a pixel's centre meets the ellipsoid."""
    return _met(camera, middle, camera.rays(camera.grid()))[0]


def drawn(camera: Camera, middle: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Brightness (height, width, 3), 0 to 255: coloured waves painted on the ellipsoid, 8 for the cloth."""
    hit, along = _met(camera, middle, rays)
    waves = 0.5 + 0.5 * np.sin(60 * (camera.centre - middle + along[..., None] * rays))
    return np.where(hit[..., None], 70 + 170 * waves, 8.0)


def inside(count: int, middle: np.ndarray, seed: int = 0) -> np.ndarray:
    """Points (count, 3) [m] evenly in the ellipsoid."""
    rng = np.random.default_rng(seed)
    ball = rng.normal(size=(count, 3))
    ball *= (rng.random(count) ** (1 / 3) / np.linalg.norm(ball, axis=1))[:, None]
    return middle + ball * RADII


def _met(camera: Camera, middle: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """|(o + t d) / RADII| = 1: a t^2 + 2 b t + c = 0, the nearer root."""
    o, d = (camera.centre - middle) / RADII, rays / RADII
    a, b, c = (d * d).sum(axis=-1), d @ o, o @ o - 1
    discriminant = b * b - a * c
    return discriminant >= 0, (-b - np.sqrt(np.maximum(discriminant, 0))) / a
