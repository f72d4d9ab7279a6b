"""What a cause is: a physical effect with parameters whose null value gives back the baseline exactly."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.sensitivity import Past
from sim.terms.base import Term
from veo_ti.diagnosis.causes.courses import Course
from veo_ti.diagnosis.scene import Scene

_FOLDS = 2.0  # powers of e, by which the distance from the most that a parameter can be may change in one step
_STRAIGHT = 1.0  # of them, up to which that is as straight as the fingerprint says
_FEW = 5  # frames below which nothing can be seen to happen over time


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A number with a unit, zero where the effect is absent; sd is the width of what is physically plausible."""

    name: str
    unit: str
    sd: float
    positive: bool = False
    most: float = np.inf  # which it never reaches: nothing would be left to deform, or a body would turn over


@dataclass(frozen=True)
class Measure:
    """A number that tells a place, such as a coordinate; of a scale how unsure it is, is told in its logarithm."""

    name: str
    unit: str
    value: float
    scale: bool = False

    def interval(self, sd: float) -> tuple[float, float]:
        """The ends of its 95 % interval."""
        reach = 1.96 * sd
        factor = float(np.exp(min(reach / self.value, 700.0))) if self.scale else 1.0
        return (self.value / factor, self.value * factor) if self.scale else (self.value - reach, self.value + reach)


def by_axis(name: str, unit: str, values: Sequence[float]) -> list[Measure]:
    """One for each coordinate of a point or a direction (3,)."""
    return [Measure(f"{name}_{axis}", unit, float(value)) for axis, value in zip("xyz", values, strict=True)]


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """What a cause does at given parameters: terms that join the energy, and what tracking makes of the positions."""

    terms: tuple[Term, ...] = ()
    observe: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None  # y (n, N, 3), frames (n,) -> seen (n, N, 3)


@dataclass(frozen=True, kw_only=True, eq=False)
class Begun:
    """Where a fit begins far from the null."""

    stiffer: float  # than the object was [nats]
    theta: np.ndarray  # (d,)
    y: np.ndarray  # (T, N, 3) [m], the motion there
    steps: float  # of Newton's for all frames, that it took


Carried = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


class Cause:
    """One way in which the world may differ from the model. A subclass says its name, its parameters and its change.

    The change is evaluated around a scene, whose motion (frozen) serves whatever depends on history. `places` lists
    what else has to be tried: spots, axes, time constants; their number is paid for in the evidence.
    """

    name = ""
    sentence = ""
    parameters: tuple[Parameter, ...] = ()
    needs_load = False  # whether it is about the nominal forces
    needs_mass = False  # whether the object must have been weighed
    over_time = ""  # what it takes several frames to show, such as a history
    material = False  # whether the change is a law of each point in proportion to its mu, lam: terms that have `each`
    plain = False  # whether a change of the material would take up what is off about its law: a true one leaves noise
    few = False  # whether its places are so few that all others get a closer look, too
    exact = False  # whether what it does is simulated as well as known loads are: steady forces, maps of what is seen
    follows = False  # whether the forces it adds depend on the motion simulated so far, so that each asks for the other
    rank = 9  # of two causes the lower one comes first: the other one takes the loads that it makes

    def change(self, scene: Scene, theta: np.ndarray, place: Any) -> Change:
        """The change at theta (d,); at zero it does nothing."""
        raise NotImplementedError

    def told(self, scene: Scene, theta: np.ndarray, place: Any) -> Scene:
        """The scene as a cause beside this one takes it: under other nominal loads, where this one makes some."""
        return scene

    def companion(self, scene: Scene, theta: np.ndarray, place: Any) -> Change | None:
        """The part of the change that is proportional to the material, or None."""
        return self.change(scene, theta, place) if self.material else None

    def carried(self, scene: Scene, theta: np.ndarray, place: Any) -> Carried | None:
        """How what tracking shows moves on when motion and material change a little, beyond the motion's own change.

        It takes the motion (n, N, 3) [m] of the first n frames, whether they train or not, these frames (n,) and the
        change of (mu, lam), (N, 2) [Pa]; None: not at all, or too little to matter.
        """
        return None

    def remembered(self, scene: Scene, theta: np.ndarray, place: Any) -> tuple[Past, ...]:
        """What it lets frames pass on to later ones."""
        return ()

    def known(self, place: Any) -> np.ndarray | None:
        """Sizes (d,) the parameters have where the cause acts, if that is known."""
        return None

    def untestable(self, scene: Scene) -> str | None:
        """Why this measurement cannot speak about the cause, in a sentence, or None."""
        if self.needs_load and not scene.forces.any():
            return "the measurement names no force"
        if self.needs_mass and scene.mass is None:
            return "the object's mass is not known; weigh it"
        if self.over_time and len(scene.time) < _FEW:
            return f"too few frames to show {self.over_time}"
        return None

    def places(self, scene: Scene) -> Sequence[Any]:
        """What is scanned."""
        return (None,)

    def near(self, scene: Scene, place: Any) -> Sequence[Any]:
        """Other places for a closer look: between `place` and those that were scanned, or all of these again."""
        return [other for other in self.places(scene) if other != place] if self.few else ()

    def courses(self, scene: Scene, place: Any) -> Sequence[Course]:
        """Those on which the place lies, such as that of time constants."""
        return ()

    def measures(self, place: Any) -> Sequence[Measure]:
        """What tells a place that lies on courses in numbers."""
        return ()

    def laws(self, scene: Scene) -> Sequence[Any]:
        """Places that differ so much far from the null that only a fit of each tells which it is."""
        return ()

    def closer(self, scene: Scene, theta: np.ndarray, place: Any) -> tuple[Any, np.ndarray] | None:
        """The place with what a cause that is followed to first order misses at theta, and theta there; None: nothing.

        scene: the one that the cause is part of.
        """
        return None

    def elsewhere(self, scene: Scene, place: Any) -> Any:
        """The place in any measurement of the same object, as a small effect goes."""
        return place

    def begin(self, place: Any) -> tuple[Any, float]:
        """The place at which a fit begins, and how much stiffer the whole object is there [nats]."""
        return place, 0.0

    def anew(self, scene: Scene, place: Any) -> Begun | None:
        """Where a fit begins that crept from the null, in an object that is homogeneous; None: there again."""
        return None

    def describe(self, scene: Scene, place: Any) -> str:
        """The place in words, or nothing."""
        return ""

    @property
    def followed(self) -> bool:
        """Whether it is followed to first order, and `closer` says what that misses."""
        return type(self).closer is not Cause.closer

    @property
    def lags(self) -> bool:
        """Whether it shows as another motion than the simulated one, such as a late one, and pushes nothing."""
        return type(self).carried is not Cause.carried

    @property
    def spans(self) -> bool:
        """Whether what it does in a frame may depend on the motion in others."""
        return self.follows or self.lags

    @property
    def positive(self) -> np.ndarray:
        """Which parameters physics wants positive, (d,)."""
        return np.array([p.positive for p in self.parameters], bool)

    def plausible(self, scene: Scene, theta: np.ndarray, spread: np.ndarray) -> bool:
        """Whether physics allows these parameters (d,), known to `spread` (d,)."""
        return bool((theta[self.positive] > 0).all())

    def interval(self, theta: np.ndarray, spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The ends (d,) of 95 % intervals, `theta -+ 1.96 spread`.

        Of a parameter that physics wants positive, and of which that reaches zero, `theta exp(-+ 1.96 spread / theta)`:
        the interval of its logarithm.
        """
        reach = 1.96 * spread
        scale = self.positive & (theta > 0) & (reach >= theta)
        factor = np.exp(np.divide(reach, theta, out=np.zeros(len(theta)), where=scale))
        return np.where(scale, theta / factor, theta - reach), np.where(scale, theta * factor, theta + reach)

    @property
    def lawful(self) -> bool:
        """Whether its parameters obey a law that those of others would by chance only."""
        return type(self).coincidence is not Cause.coincidence

    def coincidence(self, scene: Scene, theta: np.ndarray, spread: np.ndarray) -> float:
        """How likely parameters (d,), known to `spread` (d,), are by chance, over how likely the law makes them, at
        most 1; 1 without such a law."""
        return 1.0

    def stepped(self, theta: np.ndarray, change: np.ndarray, place: Any) -> np.ndarray:
        """The parameters (d,) after a step, `most - (most - theta) exp(-change / (most - theta))`, which is never met.

        What a share d of the stiffness takes, a stiffness of 1 / (1 - d) gives back: the two are straight against each
        other in the logarithm, along which this walks.
        """
        theta, change = np.asarray(theta, float), np.asarray(change, float)
        most = np.array([p.most for p in self.parameters])
        limited = np.isfinite(most)
        room = np.where(limited, most - theta, 1.0)
        curved = theta - room * np.expm1(np.clip(-change / room, -_FOLDS, _FOLDS))
        return np.where(limited, curved, theta + change)

    def room(self, theta: np.ndarray, place: Any) -> np.ndarray:
        """The largest change (d,) by which such a step goes on about as far as it says."""
        return _STRAIGHT * (np.array([p.most for p in self.parameters]) - theta)

    def widths(self, scene: Scene) -> np.ndarray:
        """Prior standard deviations (d,) of the parameters for this object."""
        return np.array([p.sd for p in self.parameters])
