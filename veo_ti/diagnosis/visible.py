"""Whether what a fit leaves is more than noise and the simulation's own error could be."""

import numpy as np

from veo_ti.diagnosis.model import Refit
from veo_ti.diagnosis.noise import measure_noise
from veo_ti.diagnosis.scene import Scene

_VISIBLE = 0.35  # of the noise, and
_SHARE = 0.004  # of the motion: root mean square below which the simulation's own error is as large
_FAINT = 0.6, 0.015  # of the noise and of the motion: no more than that, it takes a cause to be said to be wrong
_SHARED = 1.0  # of the noise between neighbours, that the noise they share may add at most


def visible(current: Refit, s2: float, modes: np.ndarray) -> bool:
    """Whether what a refit leaves, its cause taken in, is more than the simulation's own error may be."""
    excess, local = _excess(current, s2, modes)
    return excess > least_visible(current.scene, local)


def faint(current: Refit, s2: float, modes: np.ndarray) -> bool:
    """Whether it is so little more that the simulation may be to blame, unless a cause explains it."""
    excess, local = _excess(current, s2, modes)
    return excess < max(_FAINT[0] * local, _FAINT[1] * _motion(current.scene))


def noise_alike(current: Refit, s2: float, modes: np.ndarray) -> bool:
    """Whether it is no larger than noise that neighbours share may be."""
    excess, local = _excess(current, s2, modes)
    return excess < _SHARED * local


def least_visible(scene: Scene, sigma: float) -> float:
    """The root mean square of an effect [m], per coordinate, below which the simulation's own error is as large."""
    return max(_VISIBLE * sigma, _SHARE * _motion(scene))


def _motion(scene: Scene) -> float:
    """Root mean square per coordinate [m]."""
    seen = scene.target.seen & scene.train[:, None]
    return float(np.sqrt((((scene.y - scene.cloud.x) ** 2).sum(axis=2) * seen).sum() / (3 * seen.sum())))


def _excess(current: Refit, s2: float, modes: np.ndarray) -> tuple[float, float]:
    """Root mean square per coordinate [m] of what is left beyond noise, and the noise as neighbours show it."""
    scene = current.scene
    seen = scene.target.seen & scene.train[:, None]
    square = ((scene.target.residual(current.shown) ** 2).sum(axis=2) * seen).sum() / (
        3 * seen.sum() - current.used(s2)
    )
    local = measure_noise(scene, modes).local
    return float(np.sqrt(max(square - local**2, 0.0))), local
