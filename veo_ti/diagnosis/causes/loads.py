"""Causes in the loads: there is a force that nobody knows of."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sim.terms.handles import Handles
from sim.terms.loads import AppliedForce
from veo_ti.diagnosis.causes.base import Cause, Change, Parameter
from veo_ti.diagnosis.scene import Scene

NEAR = 12  # spots of a closer look
_SPREAD = 2.0  # spacings, where nothing else is known
_LEVEL = 0.1  # sine of the slope, up to which a force may be meant to be level
_TILT = 5.0  # standard deviations, by which a tilt may change the strength of gravity


def added(force: np.ndarray) -> Change:
    """A force (T, N, 3) [N] on top of the nominal one."""
    return Change(terms=(AppliedForce(force=force),))


Spot = tuple[int, float]  # a point, and over how many spacings a cause is spread around it


class AtSpot(Cause):
    """A cause that acts somewhere on the free surface, which is scanned."""

    def places(self, scene: Scene) -> Sequence[Spot]:
        """Spots over the free surface."""
        return [(int(s), _SPREAD) for s in scene.spots()]

    def near(self, scene: Scene, place: Spot) -> Sequence[Spot]:
        """Spots around it, and a narrower and wider one there."""
        spot, spread = place
        around = [(int(s), spread) for s in scene.spots_near(spot, NEAR)]
        return [*around, *((spot, factor * spread) for factor in (0.6, 1.4, 2.0))]

    def patch(self, scene: Scene, place: Spot) -> np.ndarray:
        """Weights (N,) of sum 1 around the place."""
        return scene.patch(place[0], place[1] * scene.cloud.spacing)

    def describe(self, scene: Scene, place: Spot) -> str:
        """Where."""
        return at_spot(scene, place[0])


class HiddenForce(AtSpot):
    """A constant force at a spot, absent in the reference pose."""

    name = "hidden_force"
    sentence = "A constant force that nobody recorded pulls at one spot."
    parameters = tuple(Parameter(name=f"force_{a}", unit="N", sd=1.0) for a in "xyz")

    def widths(self, scene: Scene) -> np.ndarray:
        """A fifth of the largest load; without one, what would shear a patch of some spacings by a few per cent."""
        return np.full(3, 0.2 * scene.largest_force)

    def change(self, scene: Scene, theta: np.ndarray, place: Spot) -> Change:
        """Spread around the spot."""
        return added(scene.moving * self.patch(scene, place)[:, None] * theta)


class HiddenTether(AtSpot):
    """E = k/2 |y - x|^2 at a spot."""

    name = "hidden_tether"
    sentence = "An elastic string or an unseen attachment holds one spot where it was at rest."
    parameters = (Parameter(name="stiffness", unit="N/m", sd=1.0, positive=True),)

    def widths(self, scene: Scene) -> np.ndarray:
        """What would hold a patch of some spacings about as stiffly as the material around it."""
        return np.array([10 * float(np.median(scene.mu)) * scene.cloud.spacing])

    def change(self, scene: Scene, theta: np.ndarray, place: Spot) -> Change:
        """Springs spread around the spot."""
        w = self.patch(scene, place)
        held = np.flatnonzero(w)
        return Change(terms=(Handles(points=held, targets=scene.cloud.x[None, held], alpha=0.5 * theta[0] * w[held]),))


class GravityDirection(Cause):
    """f_i = m_i a, absent in the reference pose; |g + a| = |g| where the measurement says what gravity g is."""

    name = "gravity_direction"
    sentence = "The object is tilted against gravity compared with its reference pose."
    parameters = tuple(Parameter(name=f"change_{a}", unit="m/s2", sd=1.0) for a in "xyz")
    needs_mass = True

    def change(self, scene: Scene, theta: np.ndarray, place: Any) -> Change:
        """A change of gravity after the reference frame."""
        return added(scene.moving * scene.mass[:, None] * theta)

    def plausible(self, scene: Scene, theta: np.ndarray, spread: np.ndarray) -> bool:
        """A tilt leaves gravity as strong as it was; a force that only looks like one seldom does."""
        return not _known(scene) or abs(_stronger(scene, theta)) < _TILT * _strength_known(scene, theta, spread)

    def coincidence(self, scene: Scene, theta: np.ndarray, spread: np.ndarray) -> float:
        """Bayes' factor of a force in any direction, of which one as large would make gravity stronger by up to its own
        size, evenly spread, against a tilt, which leaves it as it was, to what is known of it; 1 where a level force
        would, as a tilt by little is one."""
        g, size = scene.observation.gravity, float(np.linalg.norm(theta))
        if not (_known(scene) and size > 0) or abs(float(theta @ g)) <= _LEVEL * size * float(np.linalg.norm(g)):
            return 1.0
        known = max(_strength_known(scene, theta, spread), 1e-300)
        against = min((_stronger(scene, theta) / known) ** 2 / 2, 700.0)  # nats, of which exp has no more
        return float(min(np.sqrt(np.pi / 2) * known / size * np.exp(against), 1.0))


def _known(scene: Scene) -> bool:
    return bool(scene.observation.gravity.any() and scene.observation.force_scale_known)


def _stronger(scene: Scene, theta: np.ndarray) -> float:
    g = scene.observation.gravity
    return float(np.linalg.norm(g + theta) - np.linalg.norm(g))


def _strength_known(scene: Scene, theta: np.ndarray, spread: np.ndarray) -> float:
    """The standard deviation of that."""
    tilted = scene.observation.gravity + theta
    return float(np.linalg.norm(spread * tilted / max(float(np.linalg.norm(tilted)), 1e-300)))


def at_spot(scene: Scene, point: int) -> str:
    """A place in words."""
    x, y, z = 1e3 * scene.cloud.x[point]
    return f"around ({x:.0f}, {y:.0f}, {z:.0f}) mm"
