"""Causes in the material: another law than the Neo-Hookean one."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim.laws import extra as laws
from sim.laws.extra import Fibre, GentStiffening, VolumetricChange, YeohStiffening
from sim.terms.material import ExtraLaw
from veo_ti.diagnosis.causes.base import Cause, Change, Measure, Parameter, by_axis
from veo_ti.diagnosis.causes.courses import Course, across, turned
from veo_ti.diagnosis.causes.ways import in_words
from veo_ti.diagnosis.scene import Scene

AXES = 30
_BETWEEN = 0.17  # [rad] from one axis half the way to the next


def extra(
    scene: Scene, law: Any, m: np.ndarray, weight: np.ndarray | None = None, *, stabilised: bool = False
) -> Change:
    """One more law beside the base material."""
    stencil = scene.energy.elastic.stencil
    term = ExtraLaw(stencil=stencil, law=law, m=m, weight=weight, stabilised=stabilised)
    return Change(terms=(term,))


def strain_energy(scene: Scene) -> np.ndarray:
    """I = I_c - 3 - 2 ln J of the simulated motion, (T, N): twice the shear energy over mu."""
    J = np.linalg.det(scene.F)
    return (scene.F**2).sum(axis=(2, 3)) - 3 - 2 * np.log(np.maximum(J, 1e-3))


@dataclass(frozen=True, kw_only=True)
class Stiffening:
    """By which law a material stiffens; levels: the strain I_0 at which it levels off, or None."""

    law: str
    levels: float | None = None


class StrainStiffening(Cause):
    """psi += mu beta / 2 I^2, I = I_c - 3 - 2 ln J (Yeoh's second term), or Gent's law, which begins alike and locks at
    I = 1 / (2 beta).

    To first order it levels off, `2 mu beta I / (1 + I/I_0) B` for the stress, at a place I_0 that hardly any point's
    strain exceeds: the few that are strained ten times as much would drown all others, and stiffer ones never are.
    """

    name = "strain_stiffening"
    sentence = "The material grows stiffer where it is strained."
    parameters = (Parameter(name="beta", unit="-", sd=5.0, positive=True),)
    material = True
    plain = True

    def widths(self, scene: Scene) -> np.ndarray:
        """A tangent about three times as stiff where the strain is among the largest twentieth."""
        return np.array([1 / self._large(scene)])

    def places(self, scene: Scene) -> Sequence[Stiffening]:
        """Levelled off, where the two laws are one."""
        return self.laws(scene)[:1]

    def laws(self, scene: Scene) -> Sequence[Stiffening]:
        """Both."""
        return [Stiffening(law=law, levels=self._large(scene)) for law in ("yeoh", "gent")]

    def begin(self, place: Stiffening) -> tuple[Stiffening, float]:
        """A refit follows the law itself."""
        return replace(place, levels=None), 0.0

    def elsewhere(self, scene: Scene, place: Stiffening) -> Stiffening:
        """Levelled off at the strains of that measurement."""
        return replace(place, levels=self._large(scene))

    def plausible(self, scene: Scene, theta: np.ndarray, spread: np.ndarray) -> bool:
        """A stress up to seven times as high there: what grows stiffer by more at once is something that closes."""
        return bool(0 < theta[0] < 3 * self.widths(scene)[0])

    def change(self, scene: Scene, theta: np.ndarray, place: Stiffening) -> Change:
        """The same beta everywhere."""
        levelled = None if place.levels is None else 1 / (1 + strain_energy(scene) / place.levels)
        locks = place.law == "gent" and levelled is None
        law, strength = (GentStiffening, 2 * theta[0]) if locks else (YeohStiffening, theta[0])
        return extra(scene, law, np.stack([scene.mu, np.full_like(scene.mu, strength)], axis=1), levelled)

    def describe(self, scene: Scene, place: Stiffening) -> str:
        """By which law."""
        return {"yeoh": "by Yeoh's law", "gent": "by Gent's law, which locks"}[place.law]

    def _large(self, scene: Scene) -> float:
        """The strain that a twentieth exceeds."""
        return max(float(np.quantile(strain_energy(scene), 0.95)), 1e-6)


class VolumetricLaw(Cause):
    """lam/2 (J - 1)^2 becomes lam/2 [(1 - w)(J - 1)^2 + w ln^2 J]."""

    name = "volumetric_law"
    sentence = "The material resists a change of volume by another law than lam/2 (J - 1)^2."
    parameters = (Parameter(name="share", unit="-", sd=1.0),)
    material = True

    def change(self, scene: Scene, theta: np.ndarray, place: Any) -> Change:
        """The same share everywhere."""
        lam = scene.energy.elastic.m[:, 1]
        return extra(scene, VolumetricChange, np.stack([lam, np.full_like(lam, theta[0])], axis=1))


class TensionCompression(Cause):
    """psi += mu alpha / 3 (tr E)^3, E the Green strain."""

    name = "tension_compression"
    sentence = "The material is stiffer where it is pulled than where it is pressed, or the reverse, as foams are."
    parameters = (Parameter(name="alpha", unit="-", sd=5.0),)
    material = True

    def widths(self, scene: Scene) -> np.ndarray:
        """A modulus that is another one by half where the strain is among the largest twentieth."""
        size = np.abs((scene.F**2).sum(axis=(2, 3)) - 3) / 2
        return np.array([0.5 / max(float(np.quantile(size, 0.95)), 1e-6)])

    def change(self, scene: Scene, theta: np.ndarray, place: Any) -> Change:
        """The same alpha everywhere."""
        return extra(scene, laws.TensionCompression, np.stack([scene.mu, np.full_like(scene.mu, theta[0])], axis=1))


@dataclass(frozen=True, kw_only=True)
class Family:
    """Fibres along an axis, which push where they are pressed, or buckle."""

    axis: tuple[float, ...]
    pushes: bool = True


class FibreAnisotropy(Cause):
    """psi += mu k / 2 (|F a|^2 - 1)^2, everywhere or only where |F a| > 1."""

    name = "fibre_anisotropy"
    sentence = "The material is stiffer along one direction, as with fibres."
    parameters = (Parameter(name="stiffness", unit="-", sd=1.0, positive=True),)
    material = True

    def places(self, scene: Scene) -> Sequence[Family]:
        """Both kinds along axes spread over the half sphere (Fibonacci points)."""
        i = np.arange(AXES) + 0.5
        z, turn = 1 - i / AXES, np.pi * (1 + 5**0.5) * i
        axes = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)
        return [Family(axis=tuple(axis), pushes=pushes) for pushes in (True, False) for axis in axes.tolist()]

    def near(self, scene: Scene, place: Family) -> Sequence[Family]:
        """Axes in a ring around it, half as far as the next one; and the other kind."""
        turns, (one, other) = np.pi * np.arange(8) / 4, across(place.axis)
        ring = place.axis + _BETWEEN * (np.cos(turns)[:, None] * one + np.sin(turns)[:, None] * other)
        axes = (ring / np.linalg.norm(ring, axis=1)[:, None]).tolist()
        return [*(replace(place, axis=tuple(axis)) for axis in axes), replace(place, pushes=not place.pushes)]

    def courses(self, scene: Scene, place: Family) -> Sequence[Course]:
        """Axes that turn about two others."""
        return [
            lambda at, steps, on=on: replace(at, axis=on(at.axis, steps)) for on in turned(place.axis, _BETWEEN)
        ]  # fmt: skip

    def measures(self, place: Family) -> Sequence[Measure]:
        """The axis."""
        return by_axis("axis", "-", place.axis)

    def change(self, scene: Scene, theta: np.ndarray, place: Family) -> Change:
        """One family of fibres."""
        alike = np.tile([theta[0], *place.axis, float(place.pushes)], (len(scene.mu), 1))
        return extra(scene, Fibre, np.concatenate([scene.mu[:, None], alike], axis=1))

    def describe(self, scene: Scene, place: Family) -> str:
        """The axis, and which kind."""
        return f"along {in_words(place.axis)}" + ("" if place.pushes else ", which buckle where they are pressed")
