"""Causes in the object's build: where it is not connected as it looks, and what hangs on it."""

from collections.abc import Sequence

import numpy as np

from sim.laws.neo_hookean import NeoHookean
from veo_ti.diagnosis.causes.base import Cause, Change, Parameter
from veo_ti.diagnosis.causes.loads import AtSpot, Patch, added, around
from veo_ti.diagnosis.causes.material import extra
from veo_ti.diagnosis.causes.ways import Way, in_words
from veo_ti.diagnosis.scene import Scene

_SPOTS = 24  # where a cut may begin
_REACHES = (3.0, 5.0)  # spacings that it goes deep
_LEAST = 1.0  # nats of stiffness that a cut must have lost: less is a soft place
_BODY = 6.0  # spacings around a spot that show how the body runs there

Cut = tuple[int, Way, float]  # spot, normal, reach [m]


class Disconnection(Cause):
    """mu, lam become mu, lam exp(-loss w), w one on a disc of the normal n around a spot, a spacing thick."""

    name = "disconnection"
    sentence = "The object is not connected where it looks connected: a crack, or two parts that only touch."
    parameters = (Parameter(name="loss", unit="nats of stiffness", sd=2.0, positive=True),)
    material = True

    def places(self, scene: Scene) -> Sequence[Cut]:
        """Cuts that begin at spots of the free surface, along the planes across and along the body there."""
        reaches = [share * scene.cloud.spacing for share in _REACHES]
        return [(int(s), n, reach) for s in scene.spots(_SPOTS) for n in _axes(scene, int(s)) for reach in reaches]

    def near(self, scene: Scene, place: Cut) -> Sequence[Cut]:
        """Spots around it, deeper and shallower."""
        spot, n, reach = place
        spots = (spot, *(int(s) for s in scene.spots_near(scene.cloud.x[spot], 8)))
        return [(s, n, share * reach) for s in spots for share in (0.7, 1.0, 1.4)]

    def plausible(self, scene: Scene, theta: np.ndarray, spread: np.ndarray) -> bool:
        """A cut leaves little."""
        return bool(theta[0] > _LEAST)

    def change(self, scene: Scene, theta: np.ndarray, place: Cut) -> Change:
        """Soft where the links across the cut are."""
        spot, n, reach = place
        d = scene.cloud.x - scene.cloud.x[spot]
        off = d @ np.array(n)
        deep = np.sqrt(np.maximum((d**2).sum(axis=1) - off**2, 0.0))
        w = np.exp(-0.5 * (off / (0.5 * scene.cloud.spacing)) ** 2) * (deep < reach)
        return extra(scene, NeoHookean, scene.energy.elastic.m, np.expm1(-theta[0] * w)[None], stabilised=True)

    def describe(self, scene: Scene, place: Cut) -> str:
        """Where, and in which plane."""
        spot, n, reach = place
        return f"{around(scene.cloud.x[spot])}, {1e3 * reach:.0f} mm deep, across {in_words(n)}"


class AddedMass(AtSpot):
    """f = m w (g - y'') at a spot; of the weight only what is absent in the reference pose."""

    name = "added_mass"
    sentence = "A mass that nobody weighed hangs on one spot: its weight pulls, and it has to be moved."
    parameters = (Parameter(name="mass", unit="kg", sd=1e-2, positive=True),)
    over_time = "a motion"
    follows = True

    def untestable(self, scene: Scene) -> str | None:
        """Without gravity in the measurement it is told by its inertia only, and that takes weighing the object."""
        known = np.any(scene.observation.gravity) or scene.mass is not None
        return super().untestable(scene) or (None if known else "neither gravity nor the object's mass is given")

    def widths(self, scene: Scene) -> np.ndarray:
        """A weight, or an inertia, of a fifth of the largest load."""
        fastest = np.linalg.norm(self._pull(scene), axis=2).max()
        return np.array([0.2 * scene.largest_force / max(float(fastest), 1e-300)])

    def change(self, scene: Scene, theta: np.ndarray, place: Patch) -> Change:
        """Spread around the spot; it follows the baseline's motion."""
        return added(theta[0] * self.patch(scene, place)[:, None] * self._pull(scene))

    @staticmethod
    def _pull(scene: Scene) -> np.ndarray:
        """Gravity minus acceleration (T, N, 3) [m/s2], zero in the reference frame."""
        acceleration = np.gradient(np.gradient(scene.y, scene.time, axis=0), scene.time, axis=0)
        return scene.moving * (scene.observation.gravity - acceleration)


def _axes(scene: Scene, spot: int) -> list[Way]:
    """The directions in which the body around a spot is longest, middle and thinnest."""
    x = scene.cloud.x
    near = x[np.linalg.norm(x - x[spot], axis=1) < _BODY * scene.cloud.spacing]
    return [tuple(float(c) for c in n) for n in np.linalg.svd(near - near.mean(axis=0), full_matrices=False)[2]]
