"""Causes in the material's history: what it went through, and how long ago, changes it."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sim.laws.history import at_once, damage, green_strain, viscous_strain
from sim.laws.neo_hookean import NeoHookean
from sim.laws.reference import EigenStrain, InitialStress
from veo_ti.diagnosis.causes.base import Cause, Change, Parameter
from veo_ti.diagnosis.causes.material import extra, strain_energy
from veo_ti.diagnosis.scene import Scene

_SHARP = 16  # power of the strain: how much the larger of two strains alone decides what stays


class StiffnessDrift(Cause):
    """mu, lam become mu, lam (1 + d t / T)."""

    name = "stiffness_drift"
    sentence = "The whole object grows stiffer (or softer) with time, whatever the load."
    parameters = (Parameter(name="drift", unit="1/session", sd=0.15),)
    material = True

    def change(self, scene: Scene, theta: np.ndarray, place: Any) -> Change:
        """Growing evenly from the first frame to the last."""
        t = (scene.time - scene.time[0]) / np.ptp(scene.time)
        weight = theta[0] * np.repeat(t[:, None], scene.cloud.count, axis=1)
        return extra(scene, NeoHookean, scene.energy.elastic.m, weight, stabilised=True)


class Softening(Cause):
    """psi becomes (1 - d D) psi, D = 1 - exp(-max I so far / I0) (Mullins)."""

    name = "softening"
    sentence = "The material grew softer where it was strained before, and stays so."
    parameters = (Parameter(name="damage", unit="-", sd=0.25, positive=True),)
    material = True
    follows = True

    def change(self, scene: Scene, theta: np.ndarray, place: Any) -> Change:
        """The damage that the baseline's motion has done so far; I0 is its 90th percentile over the object."""
        worst = strain_energy(scene).max(axis=0)
        done = damage(scene.F, max(float(np.quantile(worst, 0.9)), 1e-9))
        return extra(scene, NeoHookean, scene.energy.elastic.m, -theta[0] * done, stabilised=True)


class Viscoelasticity(Cause):
    """S += 2 g mu (E - E_v), tau dE_v/dt = E - E_v (standard linear solid)."""

    name = "viscoelasticity"
    sentence = "The material resists fast motion more than slow motion, and creeps after it."
    parameters = (Parameter(name="share", unit="-", sd=0.3, positive=True),)
    material = True
    follows = True
    over_time = "a history"

    def places(self, scene: Scene) -> Sequence[float]:
        """Time constants [s] from one frame to a third of the measurement."""
        return list(np.geomspace(np.median(np.diff(scene.time)), np.ptp(scene.time) / 3, 5))

    def near(self, scene: Scene, place: float) -> Sequence[float]:
        """Time constants in between."""
        return [place * factor for factor in (0.5, 0.7, 1.4, 2.0)]

    def change(self, scene: Scene, theta: np.ndarray, place: float) -> Change:
        """A branch whose viscous strain follows the simulated motion; what it takes of the strain now moves with it."""
        E, taken = green_strain(scene.F), at_once(scene.time, place)[:, None]
        past = viscous_strain(E, scene.time, place) - taken[..., None, None] * E
        c = 2 * theta[0] * scene.mu * (1 - taken)
        return extra(scene, EigenStrain, EigenStrain.pack(c, past / (1 - taken)[..., None, None]))

    def describe(self, scene: Scene, place: float) -> str:
        """The time constant."""
        return f"with a time constant of {place:.3g} s"


class PermanentSet(Cause):
    """S -= 2 mu s E*, with E* the largest strain so far."""

    name = "permanent_set"
    sentence = "Part of the largest deformation so far stays when the load is gone."
    parameters = (Parameter(name="share", unit="-", sd=0.1, positive=True),)
    material = True
    follows = True

    def change(self, scene: Scene, theta: np.ndarray, place: Any) -> Change:
        """An unstressed strain that follows the largest strain each point has seen, the one of the frame itself too.

        Strains are weighted by a high power of their size, so that two of about the same size do not take turns.
        """
        E = green_strain(scene.F)
        size = np.linalg.norm(E, axis=(2, 3))
        weight = (size / np.maximum(size.max(axis=0), 1e-300)) ** _SHARP
        scale = np.maximum.accumulate(size, axis=0) / np.maximum(np.cumsum(weight * size, axis=0), 1e-300)
        own, sums = scale * weight, np.cumsum(weight[..., None, None] * E, axis=0)
        past = scale[..., None, None] * sums - own[..., None, None] * E
        now = extra(scene, EigenStrain, EigenStrain.pack(-2 * theta[0] * scene.mu * own, np.zeros_like(E)))
        before = initial_stress(scene, -2 * theta[0] * scene.mu[:, None, None] * past)
        return Change(terms=(*now.terms, *before.terms))


def initial_stress(scene: Scene, S: np.ndarray) -> Change:
    """A stress (T, N, 3, 3) or (N, 3, 3) [Pa] that nothing relieves."""
    return extra(scene, InitialStress, InitialStress.pack(S))
