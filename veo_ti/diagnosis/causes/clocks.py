"""Causes in the clocks: the load comes at another time than it was said to."""

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from veo_ti.diagnosis.causes.base import Cause, Change, Parameter
from veo_ti.diagnosis.causes.loads import added
from veo_ti.diagnosis.scene import Scene


class ByTheClock(Cause):
    """A cause that reads the load between frames, where nobody knows it: places are two ways in which it may go."""

    needs_load = True

    def places(self, scene: Scene) -> Sequence[type]:
        """Smoothly, or without overshooting, as a load that sets in does."""
        return (CubicSpline, PchipInterpolator)

    def near(self, scene: Scene, place: type) -> Sequence[type]:
        """The other one."""
        return [way for way in self.places(scene) if way is not place]


class ForceTiming(ByTheClock):
    """f(t) = f0(t - delay)."""

    name = "force_timing"
    sentence = "The force comes later (or earlier) than its time stamp."
    parameters = (Parameter(name="delay", unit="s", sd=0.02),)

    def widths(self, scene: Scene) -> np.ndarray:
        """About one frame."""
        return np.array([float(np.median(np.diff(scene.time)))])

    def change(self, scene: Scene, theta: np.ndarray, place: type) -> Change:
        """The load history read at shifted times."""
        return added(_at(scene, scene.time - theta[0], place) - scene.forces)


class ClockDrift(ByTheClock):
    """f(t) = f0(t + rate (t - t0))."""

    name = "clock_drift"
    sentence = "The clock of the cameras and that of the force run at different speeds."
    parameters = (Parameter(name="rate", unit="-", sd=0.01),)

    def widths(self, scene: Scene) -> np.ndarray:
        """About one frame over the whole measurement."""
        return np.array([float(np.median(np.diff(scene.time)) / np.ptp(scene.time))])

    def change(self, scene: Scene, theta: np.ndarray, place: type) -> Change:
        """The load history read by the other clock."""
        return added(_at(scene, scene.time + theta[0] * (scene.time - scene.time[0]), place) - scene.forces)


def _at(scene: Scene, time: np.ndarray, way: type) -> np.ndarray:
    """The nominal forces at other times (T, N, 3) [N], continued by at most a frame beyond both ends."""
    first, last = scene.time[:2], scene.time[-2:]
    return way(scene.time, scene.forces, axis=0)(np.clip(time, 2 * first[0] - first[1], 2 * last[1] - last[0]))
