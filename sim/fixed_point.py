"""Fixed points of expensive maps by Anderson's mixing, every frame with its own coefficients."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from sim.checks import require


@dataclass(frozen=True, kw_only=True)
class MixingOptions:
    """tolerance: largest change of any number of a state; memory: earlier states that a step combines, 0 for none."""

    tolerance: float
    iterations: int = 30
    memory: int = 4

    def __post_init__(self) -> None:
        require(self.tolerance > 0, "tolerance", "be positive", self.tolerance)
        require(self.iterations > 0, "iterations", "be positive", self.iterations)
        require(self.memory >= 0, "memory", "not be negative", self.memory)


@dataclass(frozen=True, kw_only=True, eq=False)
class FixedPoint:
    """The state of each frame whose image came closest, and how close."""

    x: np.ndarray  # (T, ...)
    change: np.ndarray  # (T,) largest |G(x) - x| of each frame
    iterations: int  # evaluations of the map
    settled: np.ndarray  # (T,) bool, change within the tolerance


def fixed_point(image: Callable[[np.ndarray], np.ndarray], start: np.ndarray, options: MixingOptions) -> FixedPoint:
    """Find x = G(x) for states (T, ...), all frames together, from `start`.

    The next state is the image, then the combination of the last images whose change is least (Anderson 1965). Where
    the image holds a NaN, for want of a value, the frame goes back halfway to its best state.
    """
    x = np.array(start, float)
    tracks = [_Track(memory=options.memory, best=state) for state in x.reshape(len(x), -1).copy()]
    solves = 0
    while solves < options.iterations and not all(track.done for track in tracks):
        images = image(x).reshape(len(x), -1)
        states = zip(tracks, x.reshape(images.shape), images, strict=True)
        x = np.stack([track.follow(state, new, options.tolerance) for track, state, new in states]).reshape(x.shape)
        solves += 1
    best, change = np.stack([t.best for t in tracks]).reshape(x.shape), np.array([t.least for t in tracks])
    return FixedPoint(x=best, change=change, iterations=solves, settled=change <= options.tolerance)


@dataclass(eq=False)
class _Track:
    """The past of one frame; the only mutable thing here."""

    memory: int
    best: np.ndarray
    least: float = np.inf
    done: bool = False
    states: list[np.ndarray] = field(default_factory=list)
    changes: list[np.ndarray] = field(default_factory=list)

    def follow(self, x: np.ndarray, image: np.ndarray, tolerance: float) -> np.ndarray:
        """Take note of G(x) and return the next state; a settled frame stays."""
        change = image - x
        if not np.isfinite(change).all():
            self.states, self.changes = [], []
            self.done = bool((x == self.best).all())  # the start has no image, so there is nowhere to go
            return (x + self.best) / 2
        if np.abs(change).max() < self.least:
            self.best, self.least = x.copy(), float(np.abs(change).max())
        if self.least <= tolerance:
            self.done = True
            return self.best
        self.states = [*self.states, x.copy()][-self.memory - 1 :]
        self.changes = [*self.changes, change][-self.memory - 1 :]
        return x + change - self._mixing()

    def _mixing(self) -> np.ndarray | float:
        if len(self.states) == 1:
            return 0.0
        dx, df = np.diff(self.states, axis=0), np.diff(self.changes, axis=0)
        return np.linalg.lstsq(df.T, self.changes[-1], rcond=1e-8)[0] @ (dx + df)
