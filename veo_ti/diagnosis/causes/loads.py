"""Causes in the loads: there is a force that nobody knows of."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.terms.handles import Handles, Strings
from sim.terms.loads import AppliedForce
from veo_ti.diagnosis.causes.base import Cause, Change, Measure, Parameter, by_axis
from veo_ti.diagnosis.causes.courses import Course, along_surface, scaled, sideways, turned
from veo_ti.diagnosis.causes.ways import ALL_AROUND, Way, in_words
from veo_ti.diagnosis.scene import Scene

_SPREAD = 2.0  # spacings, where nothing else is known
_TURN = np.deg2rad(15)  # of a string, half a step on
_LEVEL = 0.1  # sine of the slope, up to which a force may be meant to be level
_TILT = 5.0  # standard deviations, by which a tilt may change the strength of gravity


def added(force: np.ndarray) -> Change:
    """A force (T, N, 3) [N] on top of the nominal one."""
    return Change(terms=(AppliedForce(force=force),))


@dataclass(frozen=True, kw_only=True)
class Patch:
    """A place on the surface, around which a cause is spread."""

    centre: tuple[float, float, float]  # [m]
    radius: float  # [m], of a Gaussian


class AtSpot(Cause):
    """A cause that acts somewhere on the free surface, which is scanned."""

    def places(self, scene: Scene) -> Sequence[Patch]:
        """Spots over the free surface."""
        radius = _SPREAD * scene.cloud.spacing
        return [Patch(centre=tuple(x), radius=radius) for x in scene.cloud.x[scene.spots()].tolist()]

    def near(self, scene: Scene, place: Patch) -> Sequence[Patch]:
        """All spots: what pulls on either side of a thin object does nearly the same. A narrower and wider one."""
        spots = scene.cloud.x[scene.spots()].tolist()
        wider = [replace(place, radius=factor * place.radius) for factor in (0.6, 1.4, 2.0)]
        return [*(replace(place, centre=tuple(x)) for x in spots), *wider]

    def courses(self, scene: Scene, place: Patch) -> Sequence[Course]:
        """Two along the surface, by a radius, and one of radii."""
        sides = along_surface(scene, place.centre, place.radius)
        along = [lambda at, steps, on=on: replace(at, centre=on(at.centre, steps)) for on in sides]
        return (*along, lambda at, steps: replace(at, radius=scaled(at.radius, steps)))

    def measures(self, place: Patch) -> Sequence[Measure]:
        """Its centre and its radius."""
        return (*by_axis("spot", "m", place.centre), Measure("radius", "m", place.radius, scale=True))

    def patch(self, scene: Scene, place: Patch) -> np.ndarray:
        """Weights (N,) of sum 1 around the place."""
        return scene.patch(place.centre, place.radius)

    def describe(self, scene: Scene, place: Patch) -> str:
        """Where."""
        return around(place.centre)


class HiddenForce(AtSpot):
    """A constant force at a spot, absent in the reference pose."""

    name = "hidden_force"
    sentence = "A constant force that nobody recorded pulls at one spot."
    exact = True
    parameters = tuple(Parameter(name=f"force_{a}", unit="N", sd=1.0) for a in "xyz")

    def widths(self, scene: Scene) -> np.ndarray:
        """A fifth of the largest load; without one, what would shear a patch of some spacings by a few per cent."""
        return np.full(3, 0.2 * scene.largest_force)

    def change(self, scene: Scene, theta: np.ndarray, place: Patch) -> Change:
        """Spread around the spot."""
        return added(scene.moving * self.patch(scene, place)[:, None] * theta)


@dataclass(frozen=True, kw_only=True)
class Tied(Patch):
    """Where something is tied: held from all sides, or by a string that leads that way to its other end."""

    way: Way | None = None
    length: float = 0.0  # [m], of the string


class HiddenTether(AtSpot):
    """E = k/2 |y - x|^2 at a spot, or k/2 <|y - a| - |x - a|>^2 by a string to an anchor a, which only pulls."""

    name = "hidden_tether"
    sentence = "An elastic string or an unseen attachment holds one spot where it was at rest."
    parameters = (Parameter(name="stiffness", unit="N/m", sd=1.0, positive=True),)

    def widths(self, scene: Scene) -> np.ndarray:
        """What would hold a patch of some spacings about as stiffly as the material around it."""
        return np.array([10 * float(np.median(scene.mu)) * scene.cloud.spacing])

    def places(self, scene: Scene) -> Sequence[Tied]:
        """Held from all sides, or by a string, about as long as the object, that leads where it would undo most."""
        held = [Tied(centre=patch.centre, radius=patch.radius) for patch in super().places(scene)]
        return [*held, *(replace(at, way=way, length=scene.extent) for at in held for way in _pulled(scene, at))]

    def near(self, scene: Scene, place: Tied) -> Sequence[Tied]:
        """The same tie elsewhere; instead of a string those that lead all other ways from there, or springs."""
        ways = () if place.way is None else (None, *ALL_AROUND)
        return [*super().near(scene, place), *(replace(place, way=way) for way in ways)]

    def courses(self, scene: Scene, place: Tied) -> Sequence[Course]:
        """A string may lead to either side, and to nearer or farther, too."""
        courses = super().courses(scene, place)
        if place.way is None:
            return courses
        ways = turned(place.way, _TURN, sideways(scene, place.centre))
        leading = [lambda at, steps, on=on: replace(at, way=on(at.way, steps)) for on in ways]
        return (*courses, *leading, lambda at, steps: replace(at, length=scaled(at.length, steps)))

    def measures(self, place: Tied) -> Sequence[Measure]:
        """Its spot, and where a string leads."""
        return (*super().measures(place), *(by_axis("way", "-", place.way) if place.way else ()))

    def change(self, scene: Scene, theta: np.ndarray, place: Tied) -> Change:
        """Springs spread around the spot, or strings."""
        w, x = self.patch(scene, place), scene.cloud.x
        held = np.flatnonzero(w)
        alpha = 0.5 * theta[0] * w[held]
        if place.way is None:
            return Change(terms=(Handles(points=held, targets=x[None, held], alpha=alpha),))
        anchor = np.array(place.centre) + place.length * np.array(place.way)
        length = np.linalg.norm(x[held] - anchor, axis=1)
        return Change(terms=(Strings(points=held, anchor=anchor, length=length, alpha=alpha),))

    def describe(self, scene: Scene, place: Tied) -> str:
        """Where, and by what."""
        if place.way is None:
            return super().describe(scene, place)
        return f"{super().describe(scene, place)}, by a string towards {in_words(place.way)}"


def _pulled(scene: Scene, place: Tied) -> list[Way]:
    """The way in which a string at a spot would undo most of the residual, over how hard it pulls, if any would."""
    spot, ways = scene.nearest(place.centre), np.array(ALL_AROUND)
    taut = np.maximum((scene.cloud.x[spot] - scene.y[:, spot]) @ ways.T, 0.0)
    undone = (taut * (scene.undone[:, spot] @ ways.T)).sum(axis=0)
    worth = undone / np.maximum(np.linalg.norm(taut, axis=0), 1e-300)
    return [ALL_AROUND[int(worth.argmax())]] if worth.max() > 0 else []


class Growing(Cause):
    """A cause that is absent in the reference pose, and there at once after it, or more and more."""

    few = True

    def places(self, scene: Scene) -> Sequence[str]:
        """At once, or with time."""
        return ("at once", "with time")

    def grown(self, scene: Scene, place: str) -> np.ndarray:
        """How much of it is there, (T, 1, 1): one after the reference frame, or t / T."""
        time = scene.time - scene.time[0]
        return (time / time[-1])[:, None, None] if place == "with time" else scene.moving

    def describe(self, scene: Scene, place: str) -> str:
        """Since when."""
        return "more and more, up to the last frame" if place == "with time" else "since the reference frame"


class GravityDirection(Growing):
    """f_i = m_i a, absent in the reference pose; |g + a| = |g| where the measurement says what gravity g is."""

    name = "gravity_direction"
    sentence = "The object is tilted against gravity compared with its reference pose."
    exact = True
    parameters = tuple(Parameter(name=f"change_{a}", unit="m/s2", sd=1.0) for a in "xyz")
    needs_mass = True

    def change(self, scene: Scene, theta: np.ndarray, place: str) -> Change:
        """A change of gravity after the reference frame; one that grows turns it, where it is known."""
        w, g = self.grown(scene, place), scene.observation.gravity if _known(scene) else np.zeros(3)
        between = g + w * theta
        size = (1 - w) * np.linalg.norm(g) + w * np.linalg.norm(g + theta)
        turned = size * between / np.maximum(np.linalg.norm(between, axis=2, keepdims=True), 1e-300)
        return added((turned - g) * scene.mass[:, None])

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


def around(centre: Sequence[float]) -> str:
    """A place [m] in words."""
    x, y, z = 1e3 * np.asarray(centre)
    return f"around ({x:.0f}, {y:.0f}, {z:.0f}) mm"
