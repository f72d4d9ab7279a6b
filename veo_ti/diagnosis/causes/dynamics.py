"""Causes in the motion itself: mass that has to be moved, air that has to be pushed aside."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from veo_ti.diagnosis.causes.base import Cause, Change, Parameter
from veo_ti.diagnosis.scene import Scene


class Inertia(Cause):
    """M y'' joins the balance of forces: what the lowest vibrations add to the quasi-static motion."""

    name = "inertia"
    sentence = "Inertia matters at this speed: the object lags behind its load and rings after it."
    parameters = (Parameter(name="share", unit="of the mass", sd=1.0, positive=True),)
    known = (1.0,)  # the object was weighed
    needs_mass = True
    over_time = "a motion"

    def places(self, scene: Scene) -> Sequence[float]:
        """Damping ratios of all vibrations."""
        return (0.02, 0.07, 0.2, 0.6)

    def near(self, scene: Scene, place: float) -> Sequence[float]:
        """Damping ratios in between."""
        return [place * factor for factor in (0.5, 0.7, 1.4, 2.0)]

    def plausible(self, theta: np.ndarray) -> bool:
        """A mass that was weighed is not off by more than the linear vibrations may be."""
        return bool(abs(theta[0] - 1) < 0.12)

    def change(self, scene: Scene, theta: np.ndarray, place: float) -> Change:
        """Linear about the rest shape, exact in time for loads that are linear between frames."""
        lag = scene.vibrations.lag(scene.y - scene.cloud.x, scene.time, inertia=theta[0], damping=place)
        return Change(observe=lambda y, frames: y + lag[frames])

    def describe(self, scene: Scene, place: float) -> str:
        """The damping ratio, and the slowest vibration."""
        slowest = scene.vibrations.omega[0] / (2 * np.pi)
        return f"with a damping ratio of {place:g} and a slowest vibration of {slowest:.3g} Hz"


class Damping(Cause):
    """f_i = -c V_i v_i."""

    name = "damping"
    sentence = "The surroundings resist the motion in proportion to its speed."
    parameters = (Parameter(name="drag", unit="N s/m4", sd=1e3, positive=True),)
    over_time = "a motion"

    def widths(self, scene: Scene) -> np.ndarray:
        """A drag of a fifth of the largest load when motion is fastest."""
        velocity = np.gradient(scene.y, scene.time, axis=0)
        flow = np.linalg.norm(np.einsum("n,tna->tna", scene.cloud.volume, velocity), axis=2).sum(axis=1)
        return np.array([0.2 * scene.largest_force / max(float(flow.max()), 1e-300)])

    def change(self, scene: Scene, theta: np.ndarray, place: Any) -> Change:
        """Linear about the rest shape, exact in time for loads that are linear between frames."""
        delay = scene.relaxations.delay(scene.y - scene.cloud.x, scene.time, drag=theta[0])
        return Change(observe=lambda y, frames: y + delay[frames])
