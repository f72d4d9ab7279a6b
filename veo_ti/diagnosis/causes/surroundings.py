"""Causes around the object: what it bumps into, and what it stands on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim.terms.contact import Contact
from sim.terms.shapes import Plane
from veo_ti.diagnosis.causes.base import Cause, Change, Measure, Parameter, by_axis
from veo_ti.diagnosis.causes.courses import Course, along_surface, scaled, sideways, turned
from veo_ti.diagnosis.causes.loads import around
from veo_ti.diagnosis.causes.ways import Way, distinct, ways_of
from veo_ti.diagnosis.scene import Scene

_GAPS = (0.3, 0.6)  # of the farthest that the spot goes
_REACH = 4.0  # spacings around a spot within which a wall is felt
_PATCH, _GIVES = 2.0, 0.05  # spacings around, and share of the motion, that a hard wall is pressed over and in by
_FACES = (0.5, 0.75, 0.95)  # of the farthest that any point was seen to go, where a wide wall begins
_WAYS = 8  # directions into wide walls at most
_TURNS = np.deg2rad((12, 4))  # of a wide wall in a closer look
_TURN = np.deg2rad(6)  # of any, half a step on


@dataclass(frozen=True, kw_only=True)
class Wall:
    """A half space in the way: a gap [m] before a spot [m] and felt around it, or wide, before all of the object."""

    spot: tuple[float, float, float]
    way: Way  # in which the object runs into it
    gap: float
    wide: bool = False

    def face(self, x: np.ndarray) -> np.ndarray:
        """A point of it."""
        n = np.array(self.way)
        return (self.gap + ((x @ n).max() if self.wide else np.array(self.spot) @ n)) * n


class HiddenContact(Cause):
    """E_c = sum V_i alpha min(0, d_i)^2 for a wall that is felt near a spot, or for a wide one."""

    name = "hidden_contact"
    sentence = "The object runs into something that nobody modelled."
    parameters = (Parameter(name="stiffness", unit="Pa/m2", sd=1.0, positive=True),)

    def places(self, scene: Scene) -> Sequence[Wall]:
        """Spots over the free surface with walls across their largest motion; wide walls about where motion beyond the
        object's rest was seen to end, first across the ways in which it was kept from going."""
        u = np.linalg.norm(scene.y - scene.cloud.x, axis=2)
        farthest = u.max(axis=0)
        spots = [int(s) for s in scene.spots() if farthest[s] > 0.1 * farthest.max()] or [int(farthest.argmax())]
        ways = {s: _way(scene, s) for s in sorted(spots, key=lambda s: -farthest[s])}
        small = [
            Wall(spot=_at(scene, s), way=ways[s], gap=share * float(farthest[s])) for s in spots for share in _GAPS
        ]
        wide = {way: _wide(scene, way) for way in (*_kept_from(scene), *_pushed(scene), *ways.values())}
        into = distinct([way for way, walls in wide.items() if walls], _WAYS)
        return small + [wall for way in into for wall in wide[way]]

    def near(self, scene: Scene, place: Wall) -> Sequence[Wall]:
        """Nearer and farther walls, there and at some spots around, across the motion now; or leaning a little."""
        gaps = [share * place.gap for share in (0.5, 0.75, 1.0, 1.25, 1.5)]
        if place.wide:
            ways = [on for turn in _TURNS for on in _leaning(scene, place, turn)]
            leaning = [on(place, side) for on in ways for side in (1.0, -1.0)]
            return [replace(w, gap=gap) for w in (place, *leaning) for gap in gaps]
        here = replace(place, way=_way(scene, scene.nearest(place.spot)))
        others = [replace(place, spot=_at(scene, s), way=_way(scene, s)) for s in scene.spots_near(place.spot, 4)]
        return [replace(w, gap=gap) for w in (place, here, *others) for gap in gaps]

    def courses(self, scene: Scene, place: Wall) -> Sequence[Course]:
        """Of gaps, two of ways, and two along the surface where it is felt around a spot."""
        sides = () if place.wide else along_surface(scene, place.spot, scene.cloud.spacing)
        moves = [lambda at, steps, on=on: replace(at, spot=on(at.spot, steps)) for on in sides]
        leaning = _leaning(scene, place, _TURN)
        return (lambda at, steps: replace(at, gap=scaled(at.gap, steps)), *leaning, *moves)

    def measures(self, place: Wall) -> Sequence[Measure]:
        """Its gap, and the way into it."""
        return (Measure("gap", "m", place.gap, scale=True), *by_axis("way", "-", place.way))

    def widths(self, scene: Scene) -> np.ndarray:
        """A hard wall: it bears the largest load, pressed in by a twentieth of the largest motion in a small patch."""
        volume = min(2 / 3 * np.pi * (_PATCH * scene.cloud.spacing) ** 3, float(scene.cloud.volume.sum()))
        farthest = float(np.linalg.norm(scene.y - scene.cloud.x, axis=2).max())
        return np.array([scene.largest_force / (2 * volume * _GIVES * max(farthest, 1e-300))])

    def change(self, scene: Scene, theta: np.ndarray, place: Wall) -> Change:
        """Felt by the points that are outside of it at rest."""
        if theta[0] <= 0:
            return Change()
        x, n, face = scene.cloud.x, np.array(place.way), place.face(scene.cloud.x)
        near = place.wide | (np.linalg.norm(x - place.spot, axis=1) < _REACH * scene.cloud.spacing)
        volume = (near & ((x - face) @ n < 0)) * scene.cloud.volume
        return Change(terms=(Contact(shape=Plane(normal=-n), volume=volume, alpha=float(theta[0]), position=face),))

    def describe(self, scene: Scene, place: Wall) -> str:
        """Where, and how far away."""
        return f"{around(place.spot)}, {1e3 * place.gap:.1f} mm away"


def _leaning(scene: Scene, wall: Wall, angle: float) -> list[Course]:
    """Two courses of walls that lean, by an angle [rad] a step."""
    ways = turned(wall.way, angle, sideways(scene, wall.spot))
    return [lambda at, steps, on=on: replace(at, way=on(at.way, steps)) for on in ways]


def _way(scene: Scene, spot: int) -> Way:
    """Of a spot's largest motion."""
    u = scene.y[:, spot] - scene.cloud.x[spot]
    way = u[np.linalg.norm(u, axis=1).argmax()]
    return tuple((way / max(float(np.linalg.norm(way)), 1e-300)).tolist())


def _kept_from(scene: Scene) -> list[Way]:
    """Where the simulation goes beyond what was seen: against the largest residual of every frame, largest first."""
    r = scene.residual * scene.train[:, None, None]
    worst = np.linalg.norm(r, axis=2).argmax(axis=1)
    return ways_of(-r[np.arange(len(r)), worst])


def _pushed(scene: Scene) -> list[Way]:
    """Where each frame's load pushes, the strongest first."""
    return ways_of(scene.forces.sum(axis=1) * scene.train[:, None])


def _wide(scene: Scene, way: Way) -> list[Wall]:
    """Walls across a way, before the farthest that any point was seen to go."""
    n = np.array(way)
    along = (scene.y + scene.residual)[scene.train] @ n
    frame, spot = np.unravel_index(along.argmax(), along.shape)
    beyond = float(along[frame, spot] - (scene.cloud.x @ n).max())
    if beyond <= 0:
        return []
    return [Wall(spot=_at(scene, int(spot)), way=way, gap=share * beyond, wide=True) for share in _FACES]


def _at(scene: Scene, point: int) -> tuple[float, float, float]:
    return tuple(scene.cloud.x[point].tolist())


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
        most = [max(float(np.linalg.norm(v, axis=1).max()), 1e-300) for v in (force, moment)]
        return np.array([moved / most[0], moved / scene.extent / most[1]])

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
