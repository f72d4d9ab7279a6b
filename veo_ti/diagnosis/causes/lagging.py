"""What an object shows that follows its quasi-static motion through vibrations or relaxations, and how that changes."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sim.vibration import Vibrations
from veo_ti.diagnosis.causes.base import Carried, Change
from veo_ti.diagnosis.scene import Scene

Response = Callable[[Vibrations, np.ndarray, np.ndarray], np.ndarray]  # modes, u (T, N, 3), time -> coordinates (T, K)

_BIT = 1e-4  # of a frequency, by which it is changed to see what follows


def behind(scene: Scene, modes: Vibrations, response: Response, beyond: np.ndarray | float = 0.0) -> Change:
    """What tracking shows of a motion that is followed with a delay, and of what lies beyond the linear response."""
    added = modes.motion(response(modes, scene.y - scene.cloud.x, scene.time)) + beyond
    return Change(observe=lambda y, frames: y + added[frames])


def further(scene: Scene, modes: Vibrations, response: Response) -> Carried:
    """The response to a change of the motion, which is linear in it, and to a change of the material.

    That changes each frequency, and how much of each vibration joins others: `omega^2 (x - p) + dK (x - p)` is a force
    that moves them like another slow motion would, `-dK (x - p) / omega^2`.
    """
    u, elastic, omega = scene.y - scene.cloud.x, scene.energy.elastic, modes.omega
    ahead, before = (response(replace(modes, omega=s * omega), u, scene.time) for s in (1 + _BIT, 1 - _BIT))
    slope = (ahead - before) / (2 * _BIT * omega)  # of every coordinate with its own frequency, (T, K)
    late = (ahead + before) / 2

    def moved_on(motion: np.ndarray, frames: np.ndarray, change: np.ndarray) -> np.ndarray:
        stiffer = modes.stiffness(elastic, change)
        own = np.diagonal(stiffer)
        joined = -late[frames] @ (stiffer - np.diag(own)) / omega**2
        then = response(modes, motion + modes.motion(joined), scene.time[frames]) + joined
        return modes.motion(then + slope[frames] * own / (2 * omega))

    return moved_on
