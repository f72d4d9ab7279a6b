"""Two causes at once: one that was found, and another beside it, the parameters of both free."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from sim.sensitivity import Past
from veo_ti.diagnosis.causes.base import Carried, Cause, Change
from veo_ti.diagnosis.causes.courses import Course
from veo_ti.diagnosis.scene import Scene

Places = tuple[Any, Any]  # of the cause that was found, of the one beside it


class Beside(Cause):
    """What two causes do together, under the second one's name; the parameters are the first one's, then its own."""

    def __init__(self, found: Cause, other: Cause) -> None:
        self.found, self.other = found, other
        self.name, self.sentence = other.name, other.sentence
        self.parameters = (*found.parameters, *other.parameters)
        self.follows = found.follows or other.follows

    @property
    def parts(self) -> tuple[tuple[Cause, slice], ...]:
        """Both causes with their parameters' places in theta."""
        n = len(self.found.parameters)
        return (self.found, slice(0, n)), (self.other, slice(n, len(self.parameters)))

    @property
    def exact(self) -> bool:
        """Where both are."""
        return self.found.exact and self.other.exact

    @property
    def followed(self) -> bool:
        """Where either is."""
        return any(cause.followed for cause, _ in self.parts)

    @property
    def lags(self) -> bool:
        """Where both do."""
        return self.found.lags and self.other.lags

    @property
    def spans(self) -> bool:
        """Where either does."""
        return self.found.spans or self.other.spans

    def _placed(self, place: Places) -> Iterator[tuple[Cause, slice, Any]]:
        for (cause, own), at in zip(self.parts, place, strict=True):
            yield cause, own, at

    def _in_turn(self, place: Places) -> list[tuple[Cause, slice, Any]]:
        return sorted(self._placed(place), key=lambda part: part[0].rank)

    def change(self, scene: Scene, theta: np.ndarray, place: Places) -> Change:
        """Both changes, the second one's of what the first one makes of the loads; what tracking makes of the positions
        comes one after the other."""
        (one, own, at), (then, rest, there) = self._in_turn(place)
        told = one.told(scene, theta[own], at)
        return _joined([one.change(scene, theta[own], at), then.change(told, theta[rest], there)])

    def told(self, scene: Scene, theta: np.ndarray, place: Places) -> Scene:
        """By one after the other."""
        for cause, own, at in self._in_turn(place):
            scene = cause.told(scene, theta[own], at)
        return scene

    def companion(self, scene: Scene, theta: np.ndarray, place: Places) -> Change | None:
        """Of those that have one."""
        each = [cause.companion(scene, theta[own], at) for cause, own, at in self._placed(place)]
        some = [c for c in each if c is not None]
        return _joined(some) if some else None

    def carried(self, scene: Scene, theta: np.ndarray, place: Places) -> Carried | None:
        """The sum, to first order."""
        each = [cause.carried(scene, theta[own], at) for cause, own, at in self._placed(place)]
        some = [c for c in each if c is not None]
        return (lambda *moved: sum(c(*moved) for c in some)) if some else None

    def remembered(self, scene: Scene, theta: np.ndarray, place: Places) -> tuple[Past, ...]:
        """By both, the second one's of what the first one makes of the loads."""
        found: tuple[Past, ...] = ()
        for cause, own, at in self._in_turn(place):
            found += tuple(cause.remembered(scene, theta[own], at))
            scene = cause.told(scene, theta[own], at)
        return found

    def stepped(self, theta: np.ndarray, change: np.ndarray, place: Places) -> np.ndarray:
        """Each as it steps alone."""
        return np.concatenate([cause.stepped(theta[own], change[own], at) for cause, own, at in self._placed(place)])

    def room(self, theta: np.ndarray, place: Places) -> np.ndarray:
        """Of each."""
        return np.concatenate([cause.room(theta[own], at) for cause, own, at in self._placed(place)])

    def near(self, scene: Scene, place: Places) -> Sequence[Places]:
        """One of both moved, unless it is one that lags."""
        first, second = place
        moved = [] if self.found.lags else [(to, second) for to in self.found.near(scene, first)]
        return moved if self.other.lags else moved + [(first, to) for to in self.other.near(scene, second)]

    def courses(self, scene: Scene, place: Places) -> Sequence[Course]:
        """Of each, the other one where it is."""
        first, second = place
        own: list[Course] = [lambda at, s, on=on: (on(at[0], s), at[1]) for on in self.found.courses(scene, first)]
        return own + [lambda at, s, on=on: (at[0], on(at[1], s)) for on in self.other.courses(scene, second)]

    def closer(self, scene: Scene, theta: np.ndarray, place: Places) -> tuple[Places, np.ndarray] | None:
        """Of each: the first one, too, goes on from another motion than alone."""
        each = [(own, at, cause.closer(scene, theta[own], at)) for cause, own, at in self._placed(place)]
        if all(further is None for *_, further in each):
            return None
        places, sizes = zip(*(further or (at, theta[own]) for own, at, further in each), strict=True)
        return places, np.concatenate(sizes)

    def places(self, scene: Scene) -> Sequence[Places]:
        """None: both have been placed."""
        return ()

    def describe(self, scene: Scene, place: Places) -> str:
        """The second one's place in words."""
        return self.other.describe(scene, place[1])

    def plausible(self, scene: Scene, theta: np.ndarray, spread: np.ndarray) -> bool:
        """Both are."""
        return all(cause.plausible(scene, theta[own], spread[own]) for cause, own in self.parts)

    def coincidence(self, scene: Scene, theta: np.ndarray, spread: np.ndarray) -> float:
        """Of the second one."""
        own = self.parts[1][1]
        return self.other.coincidence(scene, theta[own], spread[own])

    def widths(self, scene: Scene) -> np.ndarray:
        """Both ones'."""
        return np.concatenate([cause.widths(scene) for cause, _ in self.parts])


def _joined(changes: Sequence[Change]) -> Change:
    seen = [c.observe for c in changes if c.observe is not None]
    return Change(terms=tuple(term for c in changes for term in c.terms), observe=_chained(seen) if seen else None)


def _chained(
    seen: Sequence[Callable[[np.ndarray, np.ndarray], np.ndarray]],
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    def observe(y: np.ndarray, frames: np.ndarray) -> np.ndarray:
        for one in seen:
            y = one(y, frames)
        return y

    return observe
