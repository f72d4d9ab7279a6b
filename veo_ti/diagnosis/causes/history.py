"""Causes in the material's history: what it went through, and how long ago, changes it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from sim.laws.history import green_strain, largest, viscous
from sim.laws.neo_hookean import NeoHookean
from sim.recollection import Damaged, Passing, PassingSoftening, Recollection, SoftenedBelow
from sim.sensitivity import Past
from veo_ti.diagnosis.causes.base import Cause, Change, Measure, Parameter
from veo_ti.diagnosis.causes.courses import Course, scaled
from veo_ti.diagnosis.causes.material import extra, strain_energy
from veo_ti.diagnosis.scene import Scene

_SCALES = (0.2, 1.0)  # of the largest loads, at which half the damage is done
_BETWEEN = (0.5, 0.7, 1.4, 2.0)  # of a time constant, for a closer look
_YIELDS = (0.0, 0.2, 0.5)  # of the largest strains
_FURTHER = (0.25, *_BETWEEN, 4.0)  # of a scale, of which only two are scanned
_SETTLING = 3.0  # time constants in a measurement
# Of the stiffness: with more damage stress would fall as strain grows (`sim.laws.softening`); below the largest load
_UPRIGHT = {"damage": 8 / 9, "soon": 0.69, "below": 0.999}  # it never does.


class StiffnessDrift(Cause):
    """mu, lam become mu, lam (1 + d t / T), or settle: (1 + d (1 - exp(-k t / T)) / (1 - exp(-k)))."""

    name = "stiffness_drift"
    sentence = "The whole object grows stiffer (or softer) with time, whatever the load."
    parameters = (Parameter(name="drift", unit="1/session", sd=0.15),)
    material = True

    def places(self, scene: Scene) -> Sequence[float]:
        """k: evenly, or for the most part in the first third."""
        return (0.0, _SETTLING)

    def near(self, scene: Scene, place: float) -> Sequence[float]:
        """Sooner, later, and the other one."""
        return (place / 2, 2 * place, 0.0) if place else (_SETTLING / 2, _SETTLING)

    def change(self, scene: Scene, theta: np.ndarray, place: float) -> Change:
        """From nothing in the first frame to all of it in the last."""
        t = (scene.time - scene.time[0]) / np.ptp(scene.time)
        grown = np.expm1(-place * t) / np.expm1(-place) if place else t
        weight = theta[0] * np.repeat(grown[:, None], scene.cloud.count, axis=1)
        return extra(scene, NeoHookean, scene.energy.elastic.m, weight, stabilised=True)

    def describe(self, scene: Scene, place: float) -> str:
        """How soon."""
        return f"settling with a time constant of {np.ptp(scene.time) / place:.3g} s" if place else "evenly"


@dataclass(frozen=True)
class Mullins:
    """How soon a material softens: I0, and by which law."""

    scale: float
    law: str = "damage"

    @property
    def half(self) -> float:
        """The shear energy at which half of it is done, over mu; or that below the largest at which it is there."""
        return self.scale / 2 * {"damage": 1.0, "soon": np.log(2), "below": np.arctanh(0.5)}[self.law]


class Softening(Cause):
    """psi becomes (1 - d D) psi, D = I / (I + I0), or 1 - exp(-I / I0), with I the largest so far (Mullins); or shear
    stress falls by d tanh((I - I_now) / I0): below the largest load only."""

    name = "softening"
    sentence = "The material grew softer where it was strained before, and stays so."
    parameters = (Parameter(name="damage", unit="-", sd=0.25, positive=True, most=1.0),)
    material = True
    follows = True

    def places(self, scene: Scene) -> Sequence[Mullins]:
        """I0, shares of the 90th percentile over the object of the largest I before any refit; by all laws."""
        worst = max(float(np.quantile(strain_energy(scene).max(axis=0), 0.9)), 1e-9)
        return [Mullins(share * worst, law) for law in ("damage", "soon", "below") for share in _SCALES]

    def near(self, scene: Scene, place: Mullins) -> Sequence[Mullins]:
        """Scales in between and beyond; by the other law of damage those at which about as much is done."""
        scales = [replace(place, scale=place.scale * factor) for factor in _FURTHER]
        if place.law == "below":
            return scales
        law, factor = ("damage", 0.5) if place.law == "soon" else ("soon", 2.0)
        return scales + [Mullins(factor * place.scale * f, law) for f in (1.0, *_BETWEEN)]

    def courses(self, scene: Scene, place: Mullins) -> Sequence[Course]:
        """Of scales."""
        return (lambda start, steps: replace(start, scale=scaled(start.scale, steps)),)

    def measures(self, place: Mullins) -> Sequence[Measure]:
        """The scale."""
        return (Measure("half_done_at", "of mu", place.half, scale=True),)

    def stepped(self, theta: np.ndarray, change: np.ndarray, place: Mullins) -> np.ndarray:
        """No further than stress rises with strain."""
        return np.minimum(super().stepped(theta, change, place), _UPRIGHT[place.law])

    def room(self, theta: np.ndarray, place: Mullins) -> np.ndarray:
        """Up to there."""
        return np.minimum(super().room(theta, place), (1 - theta) * np.log((1 - theta) / (1 - _UPRIGHT[place.law])))

    def change(self, scene: Scene, theta: np.ndarray, place: Mullins) -> Change:
        """What the simulated motion has softened so far."""
        return Change(terms=self._softened(scene, theta, place).terms())

    def remembered(self, scene: Scene, theta: np.ndarray, place: Mullins) -> tuple[Past, ...]:
        """The largest load."""
        return (PassingSoftening(self._softened(scene, theta, place)),)

    @staticmethod
    def _softened(scene: Scene, theta: np.ndarray, place: Mullins) -> Damaged | SoftenedBelow:
        what = SoftenedBelow if place.law == "below" else partial(Damaged, soon=place.law == "soon")
        return what(elastic=scene.energy.elastic, y=scene.y, F=scene.F, share=theta[0], scale=place.scale)

    def describe(self, scene: Scene, place: Mullins) -> str:
        """How much it takes."""
        if place.law == "below":
            return f"below the largest load only, half of it there at a shear energy {place.half:.2g} mu lower"
        done = f"half of it done at a shear energy of {place.half:.2g} mu"
        return done + (", nineteen twentieths at four times that" if place.law == "soon" else "")


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
        return list(np.geomspace(scene.interval, np.ptp(scene.time) / 3, 5))

    def near(self, scene: Scene, place: float) -> Sequence[float]:
        """Time constants in between."""
        return [place * factor for factor in _BETWEEN]

    def courses(self, scene: Scene, place: float) -> Sequence[Course]:
        """Of time constants."""
        return (scaled,)

    def measures(self, place: float) -> Sequence[Measure]:
        """The time constant."""
        return (Measure("time_constant", "s", place, scale=True),)

    def change(self, scene: Scene, theta: np.ndarray, place: float) -> Change:
        """A branch whose viscous strain follows the simulated motion; what it takes of the strain now moves with it."""
        return Change(terms=self._strain(scene, place).terms(theta[0] * scene.mu, elastic=1.0))

    def remembered(self, scene: Scene, theta: np.ndarray, place: float) -> tuple[Past, ...]:
        """The viscous strain."""
        return (Passing(self._strain(scene, place), theta[0] * scene.mu),)

    def _strain(self, scene: Scene, place: float) -> Recollection:
        return scene.recollection((self.name, place), lambda: viscous(scene.time, place))

    def describe(self, scene: Scene, place: float) -> str:
        """The time constant."""
        return f"with a time constant of {place:.3g} s"


class PermanentSet(Cause):
    """S -= 2 mu s <1 - e0 / |E*|> E*, with E* the largest strain so far; the yield strain e0 may be none."""

    name = "permanent_set"
    sentence = "Part of the largest deformation so far stays when the load is gone."
    parameters = (Parameter(name="share", unit="-", sd=0.1, positive=True, most=1.0),)
    material = True
    follows = True

    def places(self, scene: Scene) -> Sequence[float]:
        """No yield strain; or a share of the largest strains."""
        size = np.linalg.norm(green_strain(scene.F), axis=(2, 3)).max(axis=0)
        return [share * float(np.quantile(size, 0.9)) for share in _YIELDS]

    def near(self, scene: Scene, place: float) -> Sequence[float]:
        """Strains in between, or none."""
        return [place * factor for factor in _BETWEEN] + [0.0] if place else self.places(scene)[1:]

    def courses(self, scene: Scene, place: float) -> Sequence[Course]:
        """Of yield strains."""
        return (scaled,) if place else ()

    def measures(self, place: float) -> Sequence[Measure]:
        """The yield strain."""
        return (Measure("yield_strain", "-", place, scale=True),) if place else ()

    def change(self, scene: Scene, theta: np.ndarray, place: float) -> Change:
        """An unstressed strain that follows the largest strain each point has seen, the one of the frame itself too."""
        return Change(terms=self._strain(scene, place).terms(theta[0] * scene.mu))

    def remembered(self, scene: Scene, theta: np.ndarray, place: float) -> tuple[Past, ...]:
        """The largest strain."""
        return (Passing(self._strain(scene, place), theta[0] * scene.mu),)

    def _strain(self, scene: Scene, place: float) -> Recollection:
        return scene.recollection((self.name, place), lambda: largest(green_strain(scene.F), place))

    def describe(self, scene: Scene, place: float) -> str:
        """What it takes."""
        return f"beyond a strain of {place:.2g}" if place else ""
