"""The weight that the reference pose carries."""

from dataclasses import replace
from typing import Any

import numpy as np

from sim.laws.reference import LinearStress
from sim.newton import NewtonOptions, equilibrate
from veo_ti.diagnosis.causes.base import Begun, Cause, Change, Parameter
from veo_ti.diagnosis.causes.loads import added
from veo_ti.diagnosis.causes.material import extra
from veo_ti.diagnosis.scene import Scene

_HARDLY, _SOFTER = 0.005, 0.5  # largest strain by its weight, of the stiffest object that is tried; nats to the next
_MORE = 0.1  # of the weight beyond all of it, in one step
_ROUGHLY = NewtonOptions(tolerance=1e-3, iterations=12)


class Prestress(Cause):
    """The reference pose carries the object's weight: S = S_g in it, with div S_g + rho g = 0."""

    name = "prestress"
    sentence = "The reference pose already sags under its own weight and carries stress."
    parameters = (Parameter(name="share", unit="of the weight", sd=1.0, positive=True),)
    needs_mass = True

    def untestable(self, scene: Scene) -> str | None:
        """It needs the direction of gravity too."""
        reason = super().untestable(scene)
        if reason:
            return reason
        return None if np.any(scene.observation.gravity) else "the measurement names no gravity"

    def anew(self, scene: Scene, place: Any) -> Begun | None:
        """With all of its weight, and softened from a stiff object on as long as that stands, and leaves less and less.

        One that nearly buckles under its weight looks many times as soft without it, and of that stiffness would not
        stand: no way leads there from the null. Every stiffness begins at the motion of the one before.
        """
        strain, theta, frames = np.abs(_sagging(scene)).max(), np.ones(1), np.flatnonzero(scene.train)
        weight, elastic = self.change(scene, theta, place).terms, scene.energy.elastic
        target = scene.target.frames(frames)
        best, least, steps = None, np.inf, 0.0
        y = np.repeat(scene.cloud.x[None], len(frames), axis=0)
        for stiffer in np.arange(np.log(strain / _HARDLY), 0.0, -_SOFTER):
            energy = scene.energy.with_elastic(elastic.with_parameters(np.exp(stiffer) * elastic.m))
            found = equilibrate(replace(energy, terms=(*energy.terms, *weight)).frames(frames), y, options=_ROUGHLY)
            steps += float(found.iterations.mean())
            left = target.rms(found.y)
            if not found.converged or left > least:
                break
            y, least, best = found.y, left, float(stiffer)
        return None if best is None else Begun(stiffer=best, theta=theta, y=scene.with_frames(frames, y), steps=steps)

    def room(self, theta: np.ndarray, place: Any) -> np.ndarray:
        """Up to the whole weight; more only little by little, since a stiffer object that carries more leaves nearly as
        much."""
        return np.maximum(1.0 - theta, _MORE)

    def change(self, scene: Scene, theta: np.ndarray, place: Any) -> Change:
        """The stress of the linear sag, and the weight it balances."""
        strain = _sagging(scene)
        mu, lam = (scene.energy.elastic.m[:, i, None, None] for i in (0, 1))
        stress = 2 * mu * strain + lam * np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        held = extra(scene, LinearStress, LinearStress.pack(0.0, theta[0] * stress))
        # What this stress does to the discrete rest shape is taken as the weight, so that the reference is in balance.
        weight = np.broadcast_to(held.terms[0].gradient(scene.cloud.x[None]), scene.y.shape)
        return Change(terms=(*held.terms, *added(weight).terms))


def _sagging(scene: Scene) -> np.ndarray:
    """The strain (N, 3, 3) of the linear sag."""
    F = scene.cloud.deformation_gradient((scene.cloud.x + scene.sag)[None])[0]
    return (F + F.swapaxes(1, 2)) / 2 - np.eye(3)
