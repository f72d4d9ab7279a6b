"""What solves Newton's linear systems: preconditioners of every frame, fresh ones or ones that are kept."""

from dataclasses import dataclass, replace

import numpy as np

from sim.checks import require
from sim.direct import ROOM, DirectFactors, Layout
from sim.energy import Energy, Tangent
from sim.linear import LIMIT, Preconditioner
from sim.twolevel import Aggregates, TwoLevel

_NEAR = 0.3  # of the load: residual below which a two-level preconditioner follows the state
_CLOSE = 0.03  # below which a frame's last factors serve again; farther out they may hide that it has since buckled
_SMALL = 800  # points, up to which one sparse factor a frame takes no longer than the two-level preconditioner
_LASTING = 6000  # points, up to which factors that serve many solves take less time
_WORN = 10  # steps of conjugate gradients that tell that a factor is out of date, and
_PATIENT = 25  # about as many as take as long as a factor, after which no more are made with one


class Memoryless:
    """What a solver does between the steps of Newton's method that keeps nothing from one to the next."""

    @property
    def patience(self) -> int:
        """Steps of conjugate gradients, after which they end."""
        return LIMIT

    def renewed(self, last: Preconditioner, energy: Energy, tangent: Tangent) -> None:
        """Nothing better than what was tried in vain."""

    def begun(self, count: int) -> None:
        """Nothing is known of so many frames when a solve begins."""

    def spent(self, frames: np.ndarray, steps: np.ndarray) -> None:
        """Nothing is learnt from the steps (F,) of conjugate gradients that frames (F,) took."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearSolver(Memoryless):
    """Makes preconditioners for tangents of one cloud; what depends on the rest state only is made once."""

    layout: Layout
    aggregates: Aggregates
    direct: float  # points of all frames together, up to which they are factorised
    exact: bool = False  # whether that is done in double precision

    @classmethod
    def of(cls, energy: Energy, linear: str = "auto") -> "LinearSolver":
        """ "auto" factorises small clouds and takes the two-level preconditioner for the others."""
        cloud, pattern = energy.elastic.cloud, energy.elastic.pattern
        direct = {"direct": np.inf, "auto": ROOM if cloud.count <= _SMALL else 0, "two-level": 0}[linear]
        aggregates = Aggregates.of(cloud, pattern, energy.fixed)
        return cls(layout=Layout.of(energy.elastic), aggregates=aggregates, direct=direct)

    def preconditioner(self, tangent: Tangent) -> Preconditioner:
        """A fresh preconditioner at the tangent's own state."""
        few = tangent.y[..., 0].size <= self.direct
        if not few:
            return TwoLevel.of(tangent, self.aggregates)
        return DirectFactors.of(tangent, self.layout, exact=self.exact)

    def following(
        self, last: Preconditioner | None, energy: Energy, tangent: Tangent, residual: np.ndarray
    ) -> Preconditioner:
        """Of the next step, at residuals (T,): the last one, as far as its frames are near their solution."""
        if isinstance(last, TwoLevel) and residual.max() < _NEAR:
            return last.moved(tangent)
        if not isinstance(last, DirectFactors):
            return self.preconditioner(tangent)
        stale = np.flatnonzero((residual >= _CLOSE) | ~last.positive)
        if len(stale) == 0:
            return last
        return last.renewed(stale, self.preconditioner(_of_frames(stale, energy, tangent)))


@dataclass(eq=False)
class KeptSolver:
    """A `LinearSolver` that keeps each frame's preconditioner until it is worn, for problems that follow one another.

    A factor of another state serves as long as conjugate gradients are quick with it. Where they meet negative
    curvature, the projected Hessian gets a factor of its own.
    """

    solver: LinearSolver
    held: Preconditioner | None  # where any was needed so far
    steps: np.ndarray  # (T,) of conjugate gradients, that each frame took last

    @classmethod
    def of(cls, energy: Energy, frames: int, linear: str = "auto") -> "Solver":
        """ "auto" factorises all but large clouds; where so many factors have no room nothing is kept.

        One frame, as in the steps of a motion, is factorised in double precision: what a motion conserves it then
        conserves to rounding.
        """
        count = energy.elastic.cloud.count
        direct = linear == "direct" or (linear == "auto" and count <= _LASTING)
        if frames > 1 and not (direct and frames * count <= ROOM):
            return LinearSolver.of(energy, linear)
        solver = replace(LinearSolver.of(energy, "direct" if direct else linear), exact=frames == 1)
        return cls(solver=solver, held=None, steps=np.zeros(frames, int))

    @property
    def _factorises(self) -> bool:
        return self.solver.direct == np.inf

    def preconditioner(self, tangent: Tangent) -> Preconditioner:
        """A fresh one, which is not kept."""
        return self.solver.preconditioner(tangent)

    @property
    def patience(self) -> int:
        """Steps of conjugate gradients, after which a factor is made anew: one of another body may take hundreds."""
        return _PATIENT if self._factorises else LIMIT

    def renewed(self, last: "_Held", energy: Energy, tangent: Tangent) -> "_Held | None":
        """Factors of these frames made anew."""
        if not self._factorises:
            return None
        self.steps[last.index] = _WORN + 1
        return self.following(last, energy, tangent, self.steps)

    def begun(self, count: int) -> "_Held":
        """What is kept of all frames when a solve begins."""
        require(count == len(self.steps), "frames", f"be the {len(self.steps)} of the solver", count)
        return _Held(kept=self, index=np.arange(count))

    def spent(self, frames: np.ndarray, steps: np.ndarray) -> None:
        """The steps (F,) of conjugate gradients that frames (F,) took."""
        self.steps[frames] = steps

    def following(self, last: "_Held", energy: Energy, tangent: Tangent, residual: np.ndarray) -> "_Held":
        """The same, worn ones made anew at the tangent of these frames."""
        stale = np.flatnonzero((self.steps[last.index] > _WORN) | ~last.positive)
        if len(stale):
            fresh = self.solver.preconditioner(_of_frames(stale, energy, tangent))
            if len(stale) == len(self.steps):
                self.held = fresh
            else:
                before = self.held or DirectFactors.none(len(self.steps), self.solver.layout)
                self.held = before.renewed(last.index[stale], fresh)
            self.steps[last.index[stale]] = 0
        return last


@dataclass(frozen=True, kw_only=True, eq=False)
class _Held:
    """The kept preconditioners of some frames (F,)."""

    kept: KeptSolver
    index: np.ndarray

    def frames(self, index: np.ndarray, tangent: Tangent) -> "_Held":
        """Of some of these, whose tangent factors do not need."""
        return replace(self, index=self.index[index])

    @property
    def positive(self) -> np.ndarray:
        """Of these (F,)."""
        return np.zeros(len(self.index), bool) if self.kept.held is None else self._own.positive

    def __call__(self, r: np.ndarray) -> np.ndarray:
        """z ~ H^-1 r, (F, N, 3)."""
        return self._own(r)

    @property
    def _own(self) -> Preconditioner:
        held = self.kept.held
        return held if len(self.index) == len(self.kept.steps) else held.frames(self.index)


def _of_frames(index: np.ndarray, energy: Energy, tangent: Tangent) -> Tangent:
    """The tangent of some of its frames."""
    return tangent if len(index) == len(tangent.y) else energy.frames(index).tangent(tangent.y[index])


Solver = LinearSolver | KeptSolver
