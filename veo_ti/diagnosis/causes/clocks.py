"""Causes in the clocks: the load comes at another time than it was said to."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from sim.terms.jet import Jet
from veo_ti.diagnosis.causes.base import Parameter
from veo_ti.diagnosis.causes.other_loads import OfTheJet
from veo_ti.diagnosis.scene import Scene


@dataclass(frozen=True)
class Reading:
    """How the load goes on between frames: along a curve through them, as the jet that blows it or point by point;
    filled: whether it follows as through a volume that fills, not as it was; since [s]: when a clock stopped, if not
    all along."""

    way: type
    jet: bool
    filled: bool = False
    since: float | None = None


_STOPS = 8  # moments that are scanned for one at which a clock stopped
# Gauss and Laguerre's rule for the mean of f(t - tau x) over exp(-x): what a volume that fills lets through.
_DELAYS, _SHARES = np.polynomial.laguerre.laggauss(8)


class ByTheClock(OfTheJet):
    """A cause that reads the load between frames, where nobody knows it: places are ways in which it may go."""

    rank = 0  # what was said of the nozzle belongs to the nominal times

    def places(self, scene: Scene) -> Sequence[Reading]:
        """Smoothly, or without overshooting, as a load that sets in does; where the jet is known, also as it moves on:
        between two frames the air then blows between their places, not weakly on both."""
        return [
            Reading(way, jet)
            for jet in ((True, False) if scene.jet is not None else (False,))
            for way in (CubicSpline, PchipInterpolator)
        ]

    def times(self, scene: Scene, theta: np.ndarray, place: Reading) -> np.ndarray:
        """When, by the nominal clock, the load of each frame comes, (T,) [s]."""
        raise NotImplementedError

    def loads(self, scene: Scene, theta: np.ndarray, place: Reading) -> tuple[np.ndarray, Jet | None]:
        """The nominal history read at other times: before the first frame as in the reference pose, after the last one
        continued by at most a frame. A nozzle that jumps to another place does not swing."""
        delays, shares = (_DELAYS, _SHARES) if place.filled else (np.ones(1), np.ones(1))
        late = self.times(scene, theta, place) - scene.time
        times = np.clip(scene.time + delays[:, None] * late, scene.time[0], 2 * scene.time[-1] - scene.time[-2])

        def read(values: np.ndarray, way: type = place.way) -> np.ndarray:
            return np.tensordot(shares, way(scene.time, values, axis=0)(times), axes=1)

        jet = scene.jet
        if not place.jet:
            return read(scene.forces), jet
        ours = replace(jet, force=np.maximum(read(jet.force), 0.0))
        if not place.filled:  # what fills later blows from where the nozzle is
            position, direction = (read(v, PchipInterpolator) for v in (jet.position, jet.direction))
            direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-300)
            ours = replace(ours, position=position, direction=direction)
        return scene.blown(ours) + read(scene.forces - scene.blown(jet)), ours


class ForceTiming(ByTheClock):
    """f(t) = f0(t - delay), or what a valve lets through that fills a volume: delay f' = f0 - f."""

    name = "force_timing"
    sentence = "The force comes later (or earlier) than its time stamp."
    parameters = (Parameter(name="delay", unit="s", sd=0.02),)

    def widths(self, scene: Scene) -> np.ndarray:
        """About one frame."""
        return np.array([scene.interval])

    def places(self, scene: Scene) -> Sequence[Reading]:
        """Late, or through a volume that fills, smoothly as that is."""
        late = super().places(scene)
        return [*late, *(replace(r, filled=True) for r in late if r.way is PchipInterpolator)]

    def times(self, scene: Scene, theta: np.ndarray, place: Reading) -> np.ndarray:
        """All as much earlier as it comes late."""
        return scene.time - theta[0]

    def laws(self, scene: Scene) -> Sequence[Reading]:
        """One of each: to first order they are the same."""
        return [r for r in self.places(scene) if r.way is PchipInterpolator and r.jet == (scene.jet is not None)]

    def describe(self, scene: Scene, place: Reading) -> str:
        """How late."""
        return "as through a valve that fills a volume" if place.filled else ""


class ClockDrift(ByTheClock):
    """f(t) = f0(t + rate (t - t0)), or, where the clock stops at t1 (or frames are lost), f0(t + rate T) from then on,
    not before f0(t1)."""

    name = "clock_drift"
    sentence = "The clock of the cameras and that of the force do not run alike."
    parameters = (Parameter(name="rate", unit="-", sd=0.01),)

    def widths(self, scene: Scene) -> np.ndarray:
        """About one frame over the whole measurement."""
        return np.array([scene.interval / float(np.ptp(scene.time))])

    def places(self, scene: Scene) -> Sequence[Reading]:
        """All along; or from some moment on, half-way between two frames, where it stopped."""
        along, between = super().places(scene), self._between(scene)
        stops = between[np.linspace(0, len(between) - 1, min(_STOPS + 2, len(between))).astype(int)][1:-1]
        tight = next(r for r in along if r.way is PchipInterpolator)
        return [*along, *(replace(tight, since=float(t)) for t in stops)]

    def near(self, scene: Scene, place: Reading) -> Sequence[Reading]:
        """Other moments nearby, and the other course."""
        if place.since is None:
            return super().near(scene, place)
        reach = 1.5 * np.ptp(scene.time) / _STOPS
        moments = [t for t in self._between(scene).tolist() if abs(t - place.since) < reach]
        every = [replace(place, way=way, since=t) for way in (CubicSpline, PchipInterpolator) for t in moments]
        return [other for other in every if other != place]

    @staticmethod
    def _between(scene: Scene) -> np.ndarray:
        """Half-way from each frame but the first to the next, [s]."""
        return (scene.time[1:-1] + scene.time[2:]) / 2

    def times(self, scene: Scene, theta: np.ndarray, place: Reading) -> np.ndarray:
        """Ever farther off, or as far from some moment on."""
        if place.since is None:
            return scene.time + theta[0] * (scene.time - scene.time[0])
        off = np.maximum(scene.time + theta[0] * np.ptp(scene.time), place.since)
        return np.where(scene.time < place.since, scene.time, off)

    def describe(self, scene: Scene, place: Reading) -> str:
        """Where it stopped."""
        return "" if place.since is None else f"all at once, {place.since - scene.time[0]:.3g} s after the first frame"
