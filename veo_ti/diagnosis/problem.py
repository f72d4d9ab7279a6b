"""What a refit varies, its residual and its cost, and how they answer to a little of everything."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim.energy import Energy
from sim.evidence import Normal
from veo_ti.diagnosis.causes.base import Cause, Change
from veo_ti.diagnosis.columns import directions_of
from veo_ti.diagnosis.effort import LINEARISATION
from veo_ti.diagnosis.model import Model, change_of, shown_by
from veo_ti.diagnosis.moments import Along, Fingerprints, moments
from veo_ti.diagnosis.scene import Scene

_OPEN = 0.3  # of the smallest J of each frame, that a first-order motion must leave


def farthest(log_mu: np.ndarray, step: np.ndarray) -> float:
    """The largest change of log mu by a step of all unknowns, of which the first are those that log_mu (N, K) adds."""
    return float(np.abs(log_mu @ step[: log_mu.shape[1]]).max())


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """Material, discretisation and a cause at a place (None: the baseline) are looked for, under a prior.

    The unknowns are the coefficients (K + E,) of the model and the cause's theta (d,).
    """

    model: Model
    base: Energy  # without the cause
    cause: Cause | None
    place: Any
    prior: np.ndarray  # (K + E + d,) variances

    @classmethod
    def of(cls, scene: Scene, model: Model, cause: Cause | None = None, place: Any = None) -> "Problem":
        """For a scene, whose energy the cause has not joined yet."""
        widths = np.zeros(0) if cause is None else cause.widths(scene)
        prior = np.concatenate([model.prior, widths**2])
        return cls(model=model, base=scene.energy, cause=cause, place=place, prior=prior)

    @property
    def materials(self) -> int:
        """Coefficients of the material, K."""
        return self.model.basis.log_mu.shape[1]

    def energy(self, coefficients: np.ndarray) -> Energy:
        """With the material of these coefficients, without the cause."""
        return self.base.with_elastic(self.model.basis.elastic(self.base.elastic, coefficients[: self.materials]))

    def change(self, scene: Scene, theta: np.ndarray) -> Change:
        """What the cause does."""
        return change_of(scene, self.cause, theta, self.place)

    def stepped(self, theta: np.ndarray, change: np.ndarray) -> np.ndarray:
        """The cause's parameters (d,) after a step."""
        return theta if self.cause is None else self.cause.stepped(theta, change, self.place)

    def room(self, theta: np.ndarray) -> np.ndarray:
        """The largest change of all unknowns (K + E + d,), which only parameters of the cause bound."""
        own = np.zeros(0) if self.cause is None else self.cause.room(theta, self.place)
        return np.concatenate([np.full(len(self.prior) - len(own), np.inf), own])

    def turned(self, theta: np.ndarray, before: np.ndarray) -> bool:
        """Whether a parameter that physics wants positive ceased to be: such a body may have no equilibrium at all."""
        return self.cause is not None and bool(((theta <= 0) & (before > 0) & self.cause.positive).any())

    def within(self, step: np.ndarray, most: float) -> float:
        """The share, up to one, of a step of all unknowns that changes no log mu by more than `most`."""
        return min(1.0, most / max(farthest(self.model.basis.log_mu, step), 1e-12))

    def numerics(self, coefficients: np.ndarray) -> np.ndarray:
        """The discretisation's part of the motion, (T, N, 3) [m]."""
        parts = zip(coefficients[self.materials :], self.model.extra, strict=True)
        return sum((c * known.motion for c, known in parts), 0.0)

    def residual(self, scene: Scene, theta: np.ndarray) -> np.ndarray:
        """Observed minus shown, without the discretisation's part, on the frames that train, (T, N, 3) [m]."""
        r = scene.target.residual(shown_by(scene, self.change(scene, theta)))
        return r * scene.train[:, None, None]

    def cost(self, scene: Scene, coefficients: np.ndarray, theta: np.ndarray) -> float:
        """Minus the log posterior of the motion that the unknowns lead to."""
        counted = (scene.target.seen & scene.train[:, None])[..., None]
        r = self.residual(scene, theta) - self.numerics(coefficients) * counted
        full = np.concatenate([coefficients, theta])
        return float((r**2).sum() / (2 * self.model.s2) + (full**2 / self.prior).sum() / 2)

    def around(self, coefficients: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Where the residual is linearised: it still holds the discretisation's part."""
        at = np.concatenate([coefficients, theta])
        at[self.materials : len(coefficients)] = 0.0
        return at

    def linearised(self, scene: Scene, coefficients: np.ndarray, theta: np.ndarray) -> "Line":
        """Fresh fingerprints."""
        self.model.effort.spend(LINEARISATION)
        cause, place = self.cause, self.place
        own = [] if cause is None else directions_of(cause, scene, place, theta)
        found = moments(
            scene, self.model.basis, coefficients[: self.materials], self.model.extra, own,
            along=Along.with_cause(cause, scene, theta, place), keep=True,
        )  # fmt: skip
        return Line(problem=self, A=found.normal.A, kept=found.kept)


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """Fingerprints that were solved for at one state and serve nearby."""

    problem: Problem
    A: np.ndarray
    kept: Fingerprints

    def first(self, rows: int) -> "Line":
        """Of the first unknowns only."""
        return replace(self, A=self.A[:rows, :rows], kept=self.kept.first(rows))

    def ahead(self, scene: Scene, change: np.ndarray) -> Scene:
        """The scene with the motion that a change of all unknowns leads to, to first order; without it in frames that
        it would turn inside out or nearly so."""
        y = scene.y.copy()
        for t, S in zip(self.kept.frames, self.kept.motions, strict=True):
            y[t] += np.tensordot(change.astype(np.float32), S, 1)
        there, smallest = scene.moved(scene.energy, y), np.linalg.det(scene.F).min(axis=1)
        open_ = np.linalg.det(there.F).min(axis=1) > _OPEN * np.minimum(smallest, 1.0)
        return there if open_.all() else scene.moved(scene.energy, np.where(open_[:, None, None], y, scene.y))

    def normal(self, scene: Scene, coefficients: np.ndarray, theta: np.ndarray) -> Normal:
        """The data linearised around a motion; the unknowns are the coefficients and theta themselves."""
        at, residual = self.problem.around(coefficients, theta), self.problem.residual(scene, theta)
        return self.kept.normal(self.A, residual, scene.target.seen, at)
