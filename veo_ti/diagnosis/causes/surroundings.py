"""Causes around the object: what it bumps into, what it stands on, and the weight that its reference pose carries."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sim.laws.reference import LinearStress
from sim.terms.contact import Contact
from sim.terms.shapes import Plane
from veo_ti.diagnosis.causes.base import Cause, Change, Parameter
from veo_ti.diagnosis.causes.loads import added, at_spot
from veo_ti.diagnosis.causes.material import extra
from veo_ti.diagnosis.scene import Scene

_GAPS = (0.3, 0.6)  # of the farthest that the spot goes
_REACH = 4.0  # spacings around a spot within which a wall is felt


class HiddenContact(Cause):
    """E_c = sum V_i alpha min(0, d_i)^2 for a wall near a spot, across its largest motion."""

    name = "hidden_contact"
    sentence = "The object runs into something that nobody modelled."
    parameters = (Parameter(name="stiffness", unit="Pa/m2", sd=1.0, positive=True),)

    def places(self, scene: Scene) -> Sequence[tuple[int, float]]:
        """Spots over the free surface, each with walls at some gaps [m] in the way of its largest motion."""
        u = np.linalg.norm(scene.y - scene.cloud.x, axis=2)
        farthest = u.max(axis=0)
        spots = [int(s) for s in scene.spots() if farthest[s] > 0.1 * farthest.max()]
        return [(s, share * float(farthest[s])) for s in spots for share in _GAPS] or [(int(farthest.argmax()), 0.0)]

    def near(self, scene: Scene, place: tuple[int, float]) -> Sequence[tuple[int, float]]:
        """Nearer and farther walls, there and at some spots around."""
        gaps = [share * place[1] for share in (0.5, 0.75, 1.0, 1.25, 1.5)]
        return [(int(s), gap) for s in (place[0], *scene.spots_near(place[0], 4)) for gap in gaps]

    def widths(self, scene: Scene) -> np.ndarray:
        """A wall about as stiff as the object: pressed in by the largest motion it bears the largest load."""
        volume = min(2 / 3 * np.pi * (_REACH * scene.cloud.spacing) ** 3, float(scene.cloud.volume.sum()))
        farthest = float(np.linalg.norm(scene.y - scene.cloud.x, axis=2).max())
        return np.array([scene.largest_force / (2 * volume * max(farthest, 1e-300))])

    def change(self, scene: Scene, theta: np.ndarray, place: tuple[int, float]) -> Change:
        """A half space felt by the points around the spot that are outside of it at rest."""
        if theta[0] <= 0:
            return Change()
        spot, gap = place
        x, u = scene.cloud.x, scene.y[:, spot] - scene.cloud.x[spot]
        way = u[np.linalg.norm(u, axis=1).argmax()]
        n = way / max(float(np.linalg.norm(way)), 1e-300)
        wall = x[spot] + gap * n
        near = np.linalg.norm(x - x[spot], axis=1) < _REACH * scene.cloud.spacing
        near &= (x - wall) @ n < 0
        volume = near * scene.cloud.volume
        return Change(terms=(Contact(shape=Plane(normal=-n), volume=volume, alpha=float(theta[0]), position=wall),))

    def describe(self, scene: Scene, place: tuple[int, float]) -> str:
        """Where, and how far away."""
        return f"{at_spot(scene, place[0])}, {1e3 * place[1]:.1f} mm away"


class SupportCompliance(Cause):
    """y_seen = y + c_t F + c_r M x (y - base): the support gives under the force F and the moment M on it."""

    name = "support_compliance"
    sentence = "The support gives: the whole object shifts and tilts under its load."
    parameters = (
        Parameter(name="shift", unit="m/N", sd=1e-3, positive=True),
        Parameter(name="tilt", unit="rad/(N m)", sd=1e-1, positive=True),
    )
    needs_load = True

    def untestable(self, scene: Scene) -> str | None:
        """It needs a support."""
        return super().untestable(scene) or (None if scene.energy.fixed.any() else "no point is held by a support")

    def widths(self, scene: Scene) -> np.ndarray:
        """Either moves the object by a tenth of its largest motion under the largest load."""
        moved = 0.1 * float(np.linalg.norm(scene.y - scene.cloud.x, axis=2).max())
        force, moment = self._loads(scene)
        size = float(np.ptp(scene.cloud.x, axis=0).max())
        most = [max(float(np.linalg.norm(v, axis=1).max()), 1e-300) for v in (force, moment)]
        return np.array([moved / most[0], moved / size / most[1]])

    def change(self, scene: Scene, theta: np.ndarray, place: Any) -> Change:
        """Rigid, and small: the load itself does not change."""
        force, moment = self._loads(scene)

        def observe(y: np.ndarray, frames: np.ndarray) -> np.ndarray:
            tilt = np.cross(moment[frames, None], y - self._base(scene))
            return y + theta[0] * force[frames, None] + theta[1] * tilt

        return Change(observe=observe)

    @staticmethod
    def _base(scene: Scene) -> np.ndarray:
        return scene.cloud.x[scene.energy.fixed].mean(axis=0)

    def _loads(self, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
        """Total force (T, 3) [N] and its moment about the base (T, 3) [N m] on the deformed object."""
        arms = scene.y - self._base(scene)
        return scene.forces.sum(axis=1), np.cross(arms, scene.forces).sum(axis=1)


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

    def change(self, scene: Scene, theta: np.ndarray, place: Any) -> Change:
        """The stress of the linear sag, and the weight it balances."""
        F = scene.cloud.deformation_gradient((scene.cloud.x + scene.sag)[None])[0]
        strain = (F + F.swapaxes(1, 2)) / 2 - np.eye(3)
        mu, lam = (scene.energy.elastic.m[:, i, None, None] for i in (0, 1))
        stress = 2 * mu * strain + lam * np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        held = extra(scene, LinearStress, LinearStress.pack(0.0, theta[0] * stress))
        # What this stress does to the discrete rest shape is taken as the weight, so that the reference is in balance.
        weight = np.broadcast_to(held.terms[0].gradient(scene.cloud.x[None]), scene.y.shape)
        return Change(terms=(*held.terms, *added(weight).terms))
