"""Small point clouds for tests of the simulator."""

import numpy as np


def block(counts: tuple, size: tuple, corner: tuple = (0, 0, 0), *, jitter: float = 0.15, seed: int = 0) -> np.ndarray:
    """A box filled with a grid of points [m] whose inner points are moved by up to `jitter` of the grid's step."""
    axes = [np.linspace(0, length, count) for count, length in zip(counts, size, strict=True)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    step = np.array(size) / (np.array(counts) - 1)
    free = (x > 1e-9) & (x < np.array(size) - 1e-9)
    return x + np.random.default_rng(seed).uniform(-jitter, jitter, x.shape) * step * free + np.array(corner)


def ball(radius: float, count: int, centre: tuple, *, seed: int = 0) -> np.ndarray:
    """A ball of points [m]: the shells of a cubic grid of `count` points a side, made round."""
    side = np.linspace(-radius, radius, count)
    x = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    shell, length = np.abs(x).max(axis=1), np.linalg.norm(x, axis=1)
    x = x * (shell / np.where(length > 0, length, 1.0))[:, None]
    noise = np.random.default_rng(seed).uniform(-0.08, 0.08, x.shape) * (2 * radius / (count - 1))
    return x + noise * (shell < radius - 1e-9)[:, None] + np.array(centre)


def sphere(count: int, radius: float, centre: tuple = (0, 0, 0)) -> tuple[np.ndarray, np.ndarray]:
    """Points evenly spread on a sphere (a golden spiral) [m] and their outward area vectors [m2]."""
    turn, level = np.pi * (1 + 5**0.5) * np.arange(count), 1 - (2 * np.arange(count) + 1) / count
    ring = np.sqrt(1 - level**2)
    out = np.stack([ring * np.cos(turn), ring * np.sin(turn), level], axis=1)
    return radius * out + np.array(centre), 4 * np.pi * radius**2 / count * out


def rotation(angle: float, axis: tuple = (1.0, 2.0, -1.0)) -> np.ndarray:
    """The rotation matrix of an angle [rad] about an axis (Rodrigues)."""
    a = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


BOX_FACES = np.array(
    [[0, 3, 2], [0, 1, 3], [4, 7, 5], [4, 6, 7], [0, 5, 1], [0, 4, 5], [2, 7, 6], [2, 3, 7], [0, 6, 4], [0, 2, 6],
     [1, 7, 3], [1, 5, 7]]
)  # fmt: skip


def box_mesh(half: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Corners (8, 3) [m] and outward triangles (12, 3) of the box from -half to half."""
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)
    return signs * np.array(half), BOX_FACES


def bowl_mesh() -> tuple[np.ndarray, np.ndarray]:
    """A cube of half side 1 whose top is pushed in to a pyramid with its tip at the origin: closed, not convex."""
    vertices, faces = box_mesh((1.0, 1.0, 1.0))
    top = np.array([1, 5, 7, 3])  # around the face z = 1
    faces = faces[~np.isin(faces, top).all(axis=1)]
    walls = np.array([[top[n], top[(n + 1) % 4], 8] for n in range(4)])
    return np.vstack([vertices, np.zeros(3)]), np.vstack([faces, walls])
