"""Causes in the loads: the force is not what, where or when it was said to be, or there is one that nobody knows of."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sim.terms.handles import Handles
from sim.terms.jet import Jet
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


class OtherLoads(Cause):
    """A cause that makes other loads of the nominal ones. Of two, one takes what the other makes: f = R(w) f0(t - d) is
    not the sum of what each does alone."""

    needs_load = True
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


class ForceDirection(OtherLoads):
    """f = R(w) f, or the whole jet turned about its nozzle."""

    name = "force_direction"
    sentence = "The force points elsewhere than it was said to, by the same rotation in every frame."
    parameters = tuple(Parameter(name=f"turn_{a}", unit="rad", sd=0.07) for a in "xyz")
    rank = 2  # of a jet that is shifted, too

    def places(self, scene: Scene) -> Sequence[Any]:
        """Turned on the spot; where the jet is known, also turned about the nozzle, which moves its footprint."""
        return ("force", "nozzle") if scene.jet is not None else ("force",)

    def loads(self, scene: Scene, theta: np.ndarray, place: str) -> tuple[np.ndarray, Jet | None]:
        """Turned."""
        turn, jet = Rotation.from_rotvec(theta), scene.jet
        if place == "force":
            return turn.apply(scene.forces.reshape(-1, 3)).reshape(scene.forces.shape), jet
        turned = replace(jet, direction=turn.apply(jet.direction))
        return scene.reblown(turned), turned

    def elsewhere(self, scene: Scene, place: str) -> str:
        """Without a nozzle to turn about, the force is turned where it acts."""
        return place if scene.jet is not None else "force"

    def describe(self, scene: Scene, place: str) -> str:
        """What is turned."""
        return "turned where it acts" if place == "force" else "turned about the nozzle"


class ForceOffset(OtherLoads):
    """f(x) = f0(x - dp)."""

    name = "force_offset"
    sentence = "The force acts beside the place it was said to, by the same shift in every frame."
    parameters = tuple(Parameter(name=f"shift_{a}", unit="m", sd=0.01) for a in "xyz")
    rank = 1

    def loads(self, scene: Scene, theta: np.ndarray, place: Any) -> tuple[np.ndarray, Jet | None]:
        """With a jet, its nozzle shifted; else the force field shifted to first order by its own gradient."""
        jet = scene.jet
        if jet is not None:
            shifted = replace(jet, position=jet.position + theta)
            return scene.reblown(shifted), shifted
        slope = scene.cloud.deformation_gradient(scene.forces + scene.cloud.x) - np.eye(3)
        return scene.forces - slope @ theta, None


class ForceMagnitude(OtherLoads):
    """f = f0 s^n, or f0 / (s + (1 - s) exp(n)), which saturates; s = |F| / F_max, |F| the total of a frame."""

    name = "force_magnitude"
    sentence = "The force is not proportional to its nominal strength: weak ones or strong ones are off."
    parameters = (Parameter(name="exponent", unit="-", sd=0.3),)

    def untestable(self, scene: Scene) -> str | None:
        """One load level cannot show it."""
        load = scene.total_force[scene.total_force > 0]
        if len(load) == 0 or load.max() < 1.5 * np.percentile(load, 10):
            return "all frames carry about the same load; measure at several levels"
        return None

    def places(self, scene: Scene) -> Sequence[str]:
        """A power of the strength is off most where it is weak, a saturation also where it is strong."""
        return ("power", "saturation")

    def near(self, scene: Scene, place: str) -> Sequence[str]:
        """The other law: far from the null they differ more than at it."""
        return [law for law in self.places(scene) if law != place]

    def loads(self, scene: Scene, theta: np.ndarray, place: str) -> tuple[np.ndarray, Jet | None]:
        """Scaled frame by frame."""
        share = scene.total_force / scene.total_force.max()
        if place == "power":
            factor = np.maximum(share, 1e-3) ** theta[0]
        else:
            factor = 1 / (share + (1 - share) * np.exp(theta[0]))
        return np.where(share > 0, factor, 1.0)[:, None, None] * scene.forces, scene.jet

    def describe(self, scene: Scene, place: str) -> str:
        """By which law."""
        return "by a power of its strength" if place == "power" else "by a saturation"


class FollowerLoad(OtherLoads):
    """f = (1 - w) f0 + w cof(F) f0."""

    name = "follower_load"
    sentence = "The force turns and spreads with the surface it acts on instead of keeping its direction."
    parameters = (Parameter(name="share", unit="-", sd=0.5, positive=True),)
    follows = True
    rank = 4  # it carries what comes at a frame

    def loads(self, scene: Scene, theta: np.ndarray, place: Any) -> tuple[np.ndarray, Jet | None]:
        """Carried along by the deformation of the baseline's motion."""
        J = np.linalg.det(scene.F)[..., None, None]
        carried = np.einsum("tnba,tnb->tna", np.linalg.inv(scene.F) * J, scene.forces)
        return scene.forces + theta[0] * (carried - scene.forces), scene.jet


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
        if not _known(scene):
            return True
        tilted = scene.observation.gravity + theta
        across = tilted / max(float(np.linalg.norm(tilted)), 1e-300)
        return abs(_stronger(scene, theta)) < _TILT * float(np.linalg.norm(spread * across))

    def coincidence(self, scene: Scene, theta: np.ndarray) -> float:
        """Of forces in any direction, the share that leaves gravity as strong as nearly; 1 where a level force would.

        Their parts along a line are evenly spread, so it is `| |g + a| - |g| | / |a|`. A tilt by little is a level
        force.
        """
        g, size = scene.observation.gravity, float(np.linalg.norm(theta))
        if not (_known(scene) and size > 0):
            return 1.0
        slope = abs(float(theta @ g)) / (size * float(np.linalg.norm(g)))
        return min(abs(_stronger(scene, theta)) / size, 1.0) if slope > _LEVEL else 1.0


def _known(scene: Scene) -> bool:
    return bool(scene.observation.gravity.any() and scene.observation.force_scale_known)


def _stronger(scene: Scene, theta: np.ndarray) -> float:
    g = scene.observation.gravity
    return float(np.linalg.norm(g + theta) - np.linalg.norm(g))


def at_spot(scene: Scene, point: int) -> str:
    """A place in words."""
    x, y, z = 1e3 * scene.cloud.x[point]
    return f"around ({x:.0f}, {y:.0f}, {z:.0f}) mm"
