"""What an object shows that follows its quasi-static motion through vibrations or relaxations, and how that changes."""

from collections.abc import Callable

import numpy as np

from sim.vibration import Vibrations
from veo_ti.diagnosis.causes.base import Carried, Change
from veo_ti.diagnosis.scene import Scene

# Coordinates p (T, ...) at times (T,), frequencies that follow them, and the slowest of the object -> x - p (T, ...).
Response = Callable[[np.ndarray, np.ndarray, np.ndarray, float], np.ndarray]

_BIT = 1e-4  # of a frequency, by which it is changed to see what follows
_LITTLE = 1e-4  # of how late the latest is, so late are vibrations that matter


def behind(scene: Scene, modes: Vibrations, response: Response, beyond: np.ndarray | float = 0.0) -> Change:
    """What tracking shows of a motion that is followed with a delay, and of what lies beyond the linear response."""
    p = modes.coordinates(scene.y - scene.cloud.x)
    added = modes.motion(response(p, scene.time, modes.omega, modes.omega[0])) + beyond
    return Change(observe=lambda y, frames: y + added[frames])


def further(scene: Scene, modes: Vibrations, response: Response) -> Carried:
    """The response to a change of the motion, which is linear in it, and to a change of the material.

    That turns every vibration towards others, of the lowest: `d phi_k = sum_l phi_l dK_kl / (w_k^2 - w_l^2)`. So much
    of what k followed is then followed as l does, `dq_l = sum_k dK_kl (R_k - R_l)[p_k] / (w_k^2 - w_l^2)`, whose limit
    at l = k is what its own frequency does. Where the slowest one tells how the others are damped, it changes them too.
    What k follows late moves with its shape, towards the faster ones as well that nothing is late in. Of two of which
    neither is late to speak of it does not matter how they are joined.
    """
    omega, first, elastic = modes.omega, modes.omega[0], scene.energy.elastic
    p = modes.coordinates(scene.y - scene.cloud.x)
    late = response(p, scene.time, omega, first)
    size = np.linalg.norm(late, axis=0)
    some = np.flatnonzero((size > _LITTLE * size.max()) | (omega == first))
    near = np.abs(omega / omega[:, None] - 1) < _BIT
    other = np.where(near, omega[:, None] * (1 + _BIT), omega)
    apart = late[:, :, None] - response(p[:, :, None], scene.time, other, first)
    joined = apart / (omega[:, None] ** 2 - other**2)
    ahead, before = (response(p, scene.time, omega, s * first) for s in (1 + _BIT, 1 - _BIT))
    slowest = (ahead - before) / (2 * _BIT) / (2 * first**2)

    def moved_on(motion: np.ndarray, frames: np.ndarray, change: np.ndarray) -> np.ndarray:
        rows, outward = modes.changed(elastic, change, some)
        stiffer = np.zeros((len(omega), len(omega)))
        stiffer[some], stiffer[:, some] = rows, rows.T
        then = response(modes.coordinates(motion), scene.time[frames], omega, first)
        then += np.einsum("tkl,kl->tl", joined[frames], stiffer, optimize=True) + slowest[frames] * stiffer[0, 0]
        return modes.motion(then) + np.einsum("tk,kna->tna", late[frames][:, some], outward, optimize=True)

    return moved_on
