"""Directions in which the observed positions may be off: what a cause adds, and what our discretisation does."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim.resolution import changed_forces
from sim.sensitivity import responses
from veo_ti.diagnosis.causes.base import Cause, Change
from veo_ti.diagnosis.scene import Scene

_STEP = 1e-3  # of a parameter's width: changes are linear in it or nearly so
_SHARE = 0.3  # of the step to another cloud that ours may be off by
_MOST = 0.03  # of the motion: beyond it the first order says nothing


@dataclass(frozen=True, kw_only=True, eq=False)
class Direction:
    """One way in which the observed positions may be off, per unit of a coefficient: as a force, as a move, or both."""

    change: Change
    scale: float  # the coefficient's value that `change` was made with

    def forces(self, scene: Scene, index: np.ndarray) -> np.ndarray:
        """The added force (n, N, 3) [N] per unit."""
        y = scene.y[index]
        return -sum((t.frames(index).gradient(y) for t in self.change.terms), np.zeros_like(y)) / self.scale

    def moves(self, scene: Scene, index: np.ndarray) -> np.ndarray:
        """The added motion (n, N, 3) [m] per unit that needs no equilibrium."""
        y = scene.y[index]
        return (self.change.observe(y, index) - y) / self.scale if self.change.observe else np.zeros_like(y)


def directions_of(cause: Cause, scene: Scene, place: Any, theta: np.ndarray | None = None) -> list[Direction]:
    """One direction a parameter: around theta, or at the null, where a cause of known size is taken at that size."""
    widths = cause.widths(scene)
    if theta is None:
        known = cause.known(place)
        steps = _STEP * widths if known is None else known
        return [
            Direction(change=cause.change(scene, step * axis, place), scale=step)
            for step, axis in zip(steps, np.eye(len(steps)), strict=True)
        ]
    return [_around(cause, scene, place, theta, i, _STEP * width) for i, width in enumerate(widths)]


def _around(cause: Cause, scene: Scene, place: Any, theta: np.ndarray, i: int, step: float) -> Direction:
    axis = step * np.eye(len(theta))[i]
    behind, ahead = (cause.change(scene, theta + s * axis, place) for s in (-1, 1))
    return between(behind, ahead, 2 * step)


def between(behind: Change, ahead: Change, scale: float = 1.0) -> Direction:
    """From one change to another, which differ by so much of a coefficient."""
    terms = (*ahead.terms, *(Negated(term=t) for t in behind.terms))
    observe = None
    if ahead.observe is not None or behind.observe is not None:
        one, other = (change.observe or (lambda y, frames: y) for change in (behind, ahead))

        def observe(y: np.ndarray, frames: np.ndarray) -> np.ndarray:
            return y + other(y, frames) - one(y, frames)

    return Direction(change=Change(terms=terms, observe=observe), scale=scale)


@dataclass(frozen=True, kw_only=True, eq=False)
class Negated:
    """The gradient of a term with the opposite sign."""

    term: Any

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """-dE/dy, (T, N, 3) [N]."""
        return -self.term.gradient(y)

    def frames(self, index: np.ndarray) -> "Negated":
        """For the chosen frames only."""
        return replace(self, term=self.term.frames(index))


@dataclass(frozen=True, kw_only=True, eq=False)
class Known:
    """A direction that was solved for before: its motion (T, N, 3) [m]."""

    motion: np.ndarray
    whole: float = 0.0  # how large first order says it is, of the motion

    def forces(self, scene: Scene, index: np.ndarray) -> np.ndarray:
        """None."""
        return np.zeros_like(self.motion[index])

    def moves(self, scene: Scene, index: np.ndarray) -> np.ndarray:
        """The motion itself."""
        return self.motion[index]


def discretisation(scene: Scene) -> tuple[Known, ...]:
    """How the motion changes with another choice of neighbours or stabilisation, to first order: the shape of our
    error, each column in the size that is to be expected."""
    changed = _SHARE * changed_forces(scene.energy.elastic, scene.y)
    motion = np.stack(list(responses(scene.energy, scene.y, lambda index: changed[index])), axis=1)
    moved = max(float(np.linalg.norm(scene.y - scene.cloud.x)), 1e-300)
    wholes = [float(np.linalg.norm(m)) / moved for m in motion]
    return tuple(
        Known(motion=m * min(1.0, _MOST / max(whole, 1e-300)), whole=whole)
        for m, whole in zip(motion, wholes, strict=True)
    )  # fmt: skip
