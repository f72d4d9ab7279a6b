"""Causes in the motion itself: mass that has to be moved, air that has to be pushed aside."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sim.vibration import Vibrations
from veo_ti.diagnosis.causes.base import Carried, Cause, Change, Parameter
from veo_ti.diagnosis.scene import Scene

_RATIOS = (0.02, 0.07, 0.2, 0.6)
_LAWS = {0: "the same for all vibrations", -1: "less for fast ones, as in air", 1: "more for fast ones, as in rubber"}

_BIT = 1e-4  # of a frequency, by which it is changed to see what follows

Response = Callable[[Vibrations, np.ndarray, np.ndarray], np.ndarray]  # modes, u (T, N, 3), time -> coordinates (T, K)
Ring = tuple[float, int]  # the damping ratio of the slowest vibration, the power of frequency it goes by


class Inertia(Cause):
    """M y'' joins the balance of forces: what the lowest vibrations add to the quasi-static motion.

    The damping ratio of a vibration is that of the slowest times `(omega / omega_1)^p`: p = 1 where a drag on the
    material's rate of strain damps, -1 where a drag on velocity does (Rayleigh's two terms), 0 between.
    """

    name = "inertia"
    sentence = "Inertia matters at this speed: the object lags behind its load and rings after it."
    parameters = (Parameter(name="share", unit="of the mass", sd=1.0, positive=True),)
    known = (1.0,)  # the object was weighed
    needs_mass = True
    over_time = "a motion"

    def places(self, scene: Scene) -> Sequence[Ring]:
        """Damping ratios of the slowest vibration, and how those of the others go with frequency."""
        return [(ratio, power) for power in _LAWS for ratio in _RATIOS]

    def near(self, scene: Scene, place: Ring) -> Sequence[Ring]:
        """Damping ratios in between."""
        return [(place[0] * factor, place[1]) for factor in (0.5, 0.7, 1.4, 2.0)]

    def plausible(self, theta: np.ndarray) -> bool:
        """A mass that was weighed is not off by more than the linear vibrations may be."""
        return bool(abs(theta[0] - 1) < 0.12)

    def change(self, scene: Scene, theta: np.ndarray, place: Ring) -> Change:
        """Linear about the rest shape, exact in time for loads that are linear between frames."""
        return _behind(scene, scene.vibrations, _lag(theta[0], place))

    def carried(self, scene: Scene, theta: np.ndarray, place: Ring) -> Carried:
        """The lag of the change, and what other frequencies do to the lag."""
        return _further(scene, scene.vibrations, _lag(theta[0], place))

    def describe(self, scene: Scene, place: Ring) -> str:
        """The slowest vibration and its damping ratio, and how the others are damped."""
        slowest = scene.vibrations.omega[0] / (2 * np.pi)
        return f"with a slowest vibration of {slowest:.3g} Hz, damping ratio {place[0]:.2g}, {_LAWS[place[1]]}"


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
        return _behind(scene, scene.relaxations, _delay(theta[0]))

    def carried(self, scene: Scene, theta: np.ndarray, place: Any) -> Carried:
        """The delay of the change, and what another stiffness does to the delay."""
        return _further(scene, scene.relaxations, _delay(theta[0]))


def _lag(share: float, place: Ring) -> Response:
    def response(modes: Vibrations, u: np.ndarray, time: np.ndarray) -> np.ndarray:
        damping = place[0] * (modes.omega / modes.omega[0]) ** place[1]
        return modes.lag(u, time, inertia=share, damping=damping)

    return response


def _delay(drag: float) -> Response:
    return lambda modes, u, time: modes.delay(u, time, drag=drag)


def _behind(scene: Scene, modes: Vibrations, response: Response) -> Change:
    """What tracking shows of a motion that is followed with a delay."""
    added = modes.motion(response(modes, scene.y - scene.cloud.x, scene.time))
    return Change(observe=lambda y, frames: y + added[frames])


def _further(scene: Scene, modes: Vibrations, response: Response) -> Carried:
    """The response to a change of the motion, which is linear in it, and to a change of each frequency."""
    u, elastic = scene.y - scene.cloud.x, scene.energy.elastic
    ahead, before = (response(replace(modes, omega=s * modes.omega), u, scene.time) for s in (1 + _BIT, 1 - _BIT))
    slope = (ahead - before) / (2 * _BIT * modes.omega)  # of every coordinate with its own frequency, (T, K)

    def further(motion: np.ndarray, frames: np.ndarray, change: np.ndarray) -> np.ndarray:
        since = np.union1d(0, frames)  # it starts at rest in the first frame, seen or not
        started = np.zeros((len(since), *motion.shape[1:]))
        started[len(since) - len(frames) :] = motion
        own = response(modes, started, scene.time[since])[len(since) - len(frames) :]
        return modes.motion(own + slope[frames] * modes.tuning(elastic, change))

    return further
