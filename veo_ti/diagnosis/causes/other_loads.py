"""Causes that make other loads of the nominal ones: the force is not what or where it was said to be."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sim.follower import Following
from sim.sensitivity import Past
from sim.terms.jet import Jet
from veo_ti.diagnosis.causes.base import Cause, Change, Parameter
from veo_ti.diagnosis.causes.loads import added
from veo_ti.diagnosis.scene import Scene

_SEVERAL = 0.1  # of a unit vector: jets whose directions differ by less blow from one side
_UPRIGHT = 0.05  # sine of the angle to the vertical, below which a jet blows up or down, and has no side
_STRENGTHS = {"power": "a power of its strength", "saturation": "a saturation", "dead": "a dead zone"}
_WIDER = 2.0  # of the logarithm of a jet's width: beyond it nothing changes any more
_ALL = 1.2  # of a load; more than all of it turns only as far as the simulation itself is off


class OtherLoads(Cause):
    """A cause that makes other loads of the nominal ones. Of two, one takes what the other makes: f = R(w) f0(t - d) is
    not the sum of what each does alone."""

    needs_load = True
    few = True
    rank = 3

    def loads(self, scene: Scene, theta: np.ndarray, place: Any) -> tuple[np.ndarray, Jet | None]:
        """The forces (T, N, 3) [N] instead of the nominal ones, and the jet that blows them, where one is known."""
        raise NotImplementedError

    def change(self, scene: Scene, theta: np.ndarray, place: Any) -> Change:
        """The difference that it makes."""
        return added(self.loads(scene, theta, place)[0] - scene.forces)

    def told(self, scene: Scene, theta: np.ndarray, place: Any) -> Scene:
        """Under these loads."""
        return scene.under(*self.loads(scene, theta, place))


def _axes(scene: Scene) -> np.ndarray:
    """The nozzle's own axes in every frame, rows (T, 3, 3): to its right, up and ahead, held level."""
    ahead, up = scene.jet.direction, scene.observation.up
    right = np.cross(ahead, up)
    level = np.linalg.norm(right, axis=1, keepdims=True) > _UPRIGHT * np.linalg.norm(up)
    right = np.where(level, right, np.cross(ahead, np.roll(up, 1)))
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return np.stack([right, np.cross(right, ahead), ahead], axis=1)


def _by_the_nozzle(scene: Scene) -> bool:
    """Whether a jet is known that blows in several directions: what is off by the nozzle's axes is then another thing
    than what is off in the room."""
    return scene.jet is not None and np.ptp(scene.jet.direction, axis=0).max() > _SEVERAL


class ForceDirection(OtherLoads):
    """f = R(w) f, or the whole jet turned about its nozzle; by an axis in the room, or by the nozzle's own."""

    name = "force_direction"
    sentence = "The force points elsewhere than it was said to, by the same rotation in every frame."
    parameters = tuple(Parameter(name=f"turn_{a}", unit="rad", sd=0.07) for a in "xyz")
    rank = 2  # of a jet that is shifted, too

    def places(self, scene: Scene) -> Sequence[Any]:
        """Turned on the spot; where the jet is known, also turned about the nozzle, which moves its footprint."""
        known = ("force", "nozzle") if scene.jet is not None else ("force",)
        return (*known, "own") if _by_the_nozzle(scene) else known

    def loads(self, scene: Scene, theta: np.ndarray, place: str) -> tuple[np.ndarray, Jet | None]:
        """Turned."""
        turn, jet = Rotation.from_rotvec(theta @ _axes(scene) if place == "own" else theta), scene.jet
        if place == "force":
            return turn.apply(scene.forces.reshape(-1, 3)).reshape(scene.forces.shape), jet
        turned = replace(jet, direction=turn.apply(jet.direction))
        return scene.reblown(turned), turned

    def elsewhere(self, scene: Scene, place: str) -> str:
        """Without a nozzle to turn about, the force is turned where it acts."""
        return place if scene.jet is not None else "force"

    def describe(self, scene: Scene, place: str) -> str:
        """What is turned."""
        about = "about the nozzle" + (", by its own axes (right, up, ahead)" if place == "own" else "")
        return "turned where it acts" if place == "force" else f"turned {about}"


class ForceOffset(OtherLoads):
    """f(x) = f0(x - dp), dp in the room or, as of a marker that sits askew, by the nozzle's own axes."""

    name = "force_offset"
    sentence = "The force acts beside the place it was said to, by the same shift in every frame."
    parameters = tuple(Parameter(name=f"shift_{a}", unit="m", sd=0.01) for a in "xyz")
    rank = 1

    def places(self, scene: Scene) -> Sequence[str]:
        """In the room; where the jet blows in several directions, also by the nozzle."""
        return ("room", "own") if _by_the_nozzle(scene) else ("room",)

    def loads(self, scene: Scene, theta: np.ndarray, place: str) -> tuple[np.ndarray, Jet | None]:
        """With a jet, its nozzle shifted; else the force field shifted to first order by its own gradient."""
        jet = scene.jet
        if jet is not None:
            shifted = replace(jet, position=jet.position + (theta @ _axes(scene) if place == "own" else theta))
            return scene.reblown(shifted), shifted
        slope = scene.cloud.deformation_gradient(scene.forces + scene.cloud.x) - np.eye(3)
        return scene.forces - slope @ theta, None

    def elsewhere(self, scene: Scene, place: str) -> str:
        """Without a nozzle, in the room."""
        return place if scene.jet is not None else "room"

    def describe(self, scene: Scene, place: str) -> str:
        """By which axes."""
        return "by the nozzle's own axes (right, up, ahead)" if place == "own" else ""


class ForceFootprint(OtherLoads):
    """sigma = sigma0 exp(w), at the same force on a wall."""

    name = "force_footprint"
    sentence = "The jet is wider (or narrower) than it was said to be."
    parameters = (Parameter(name="log_width", unit="-", sd=0.3),)
    rank = 1

    def untestable(self, scene: Scene) -> str | None:
        """Only of a jet."""
        known = scene.jet is not None
        return super().untestable(scene) or (None if known else "it is not known where a jet blows from")

    def loads(self, scene: Scene, theta: np.ndarray, place: Any) -> tuple[np.ndarray, Jet | None]:
        """By a jet of another width."""
        if scene.jet is None:  # as in an experiment that nobody has made yet
            return scene.forces, None
        width = scene.jet.footprint * float(np.exp(np.clip(theta[0], -_WIDER, _WIDER)))
        wider = replace(scene.jet, footprint=width)
        return scene.reblown(wider), wider


class OfTheJet(OtherLoads):
    """Other loads by one of several laws, of the jet or of the forces: places have a `jet` that says of which."""

    def elsewhere(self, scene: Scene, place: Any) -> Any:
        """Of the forces where no jet is known."""
        return replace(place, jet=place.jet and scene.jet is not None)


@dataclass(frozen=True)
class Strength:
    """How a force is not proportional: by a power of its strength, a saturation or a dead zone; of the jet's, or of the
    total."""

    law: str
    jet: bool


class ForceMagnitude(OfTheJet):
    """f = f0 s^n, or f0 / (s + (1 - s) exp(n)), which saturates, or f0 <1 - (1 - s) exp(n)> / s, of which weak ones
    are nothing; s = F / F_max, F of the jet or a frame's total."""

    name = "force_magnitude"
    sentence = "The force is not proportional to its nominal strength: weak ones or strong ones are off."
    parameters = (Parameter(name="exponent", unit="-", sd=0.3),)

    def untestable(self, scene: Scene) -> str | None:
        """One load level cannot show it."""
        load = scene.total_force[scene.total_force > 0]
        if len(load) == 0 or load.max() < 1.5 * np.percentile(load, 10):
            return "all frames carry about the same load; measure at several levels"
        return None

    def places(self, scene: Scene) -> Sequence[Strength]:
        """A power is off most where the force is weak, a saturation also where it is strong, a dead zone by as much
        wherever it is. A valve does it to the jet, however much of that the object meets."""
        whose = (True, False) if scene.jet is not None and scene.jet.force.any() else (False,)
        return [Strength(law, jet) for jet in whose for law in _STRENGTHS]

    def laws(self, scene: Scene) -> Sequence[Strength]:
        """All."""
        return self.places(scene)

    def loads(self, scene: Scene, theta: np.ndarray, place: Strength) -> tuple[np.ndarray, Jet | None]:
        """Scaled frame by frame."""
        force = scene.jet.force if place.jet else scene.total_force
        share = np.maximum(force / force.max(), 0.0)
        weaker = (1 - share) * np.exp(theta[0])
        if place.law == "power":
            factor = np.maximum(share, 1e-3) ** theta[0]
        elif place.law == "saturation":
            factor = 1 / (share + weaker)
        else:
            factor = np.maximum(1 - weaker, 0.0) / np.maximum(share, 1e-3)
        return np.where(share > 0, factor, 1.0)[:, None, None] * scene.forces, scene.jet

    def describe(self, scene: Scene, place: Strength) -> str:
        """By which law."""
        return f"by {_STRENGTHS[place.law]}" + (" of the jet" if place.jet else "")


class FollowerLoad(OtherLoads):
    """f = (1 - w) f0 + w cof(F) f0."""

    name = "follower_load"
    sentence = "The force turns and spreads with the surface it acts on instead of keeping its direction."
    parameters = (Parameter(name="share", unit="-", sd=0.5, positive=True, most=_ALL),)
    follows = True
    rank = 4  # it carries what comes at a frame

    def loads(self, scene: Scene, theta: np.ndarray, place: Any) -> tuple[np.ndarray, Jet | None]:
        """Carried along by the deformation of the baseline's motion."""
        there = Following(cloud=scene.cloud, F=scene.F, nominal=scene.forces).there
        return scene.forces + theta[0] * (there - scene.forces), scene.jet

    def remembered(self, scene: Scene, theta: np.ndarray, place: Any) -> tuple[Past, ...]:
        """How it turns on."""
        return (Following(cloud=scene.cloud, F=scene.F, nominal=theta[0] * scene.forces),)
