"""Ways on which places lie: scales, directions, the surface."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from veo_ti.diagnosis.scene import Scene

Course = Callable[[Any, float], Any]  # place, steps (half the way to the next scanned, or so) -> that there

_HALF = 0.7  # of a scale, that is half a step before it


def scaled(size: float, steps: float) -> float:
    """From a scale on to smaller and larger ones."""
    return size * _HALF**-steps


def across(way: Sequence[float], beside: np.ndarray | None = None) -> np.ndarray:
    """Two unit vectors (2, 3) perpendicular to a vector (3,) and to each other; the first one towards `beside` (3,), so
    that they turn with the object."""
    first, second = np.linalg.svd(np.asarray(way)[None])[2][1:]
    if beside is None:
        return np.stack([first, second])
    turn = np.arctan2(beside @ second, beside @ first)
    return np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) @ [first, second]


def turned(way: Sequence[float], angle: float, beside: np.ndarray | None = None) -> list[Course]:
    """From a unit vector (3,), and those near it, on to others in two planes, by an angle [rad] a step; places are
    tuples."""

    def to(side: np.ndarray) -> Course:
        def place(start: Sequence[float], steps: float) -> tuple[float, ...]:
            n = np.array(start)
            level = side - side @ n * n
            level /= np.linalg.norm(level)
            return tuple((np.cos(steps * angle) * n + np.sin(steps * angle) * level).tolist())

        return place

    return [to(side) for side in across(way, beside)]


def sideways(scene: Scene, centre: Sequence[float]) -> np.ndarray:
    """From the surface point nearest to a centre (3,) [m] to its nearest neighbour, (3,) [m]."""
    here = scene.nearest(centre)
    return scene.cloud.x[scene.cloud.neighbours[here, 0]] - scene.cloud.x[here]


def along_surface(scene: Scene, centre: Sequence[float], length: float) -> list[Course]:
    """From a centre (3,) [m], and those near it, on along the free surface in two directions, a length [m] a step;
    places are tuples."""
    normals = scene.cloud.normals

    def to(side: np.ndarray) -> Course:
        def place(start: Sequence[float], steps: float) -> tuple[float, ...]:
            point = np.array(start) + steps * length * side
            there = scene.nearest(point)
            beyond = (point - scene.cloud.x[there]) @ normals[there]
            return tuple((point - beyond * normals[there]).tolist())

        return place

    return [to(side) for side in across(normals[scene.nearest(centre)], sideways(scene, centre))]
