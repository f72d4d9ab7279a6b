"""Equilibria that depend on those before them: Newton's steps through time, with factors that serve many of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sim.direct import DirectFactors, Layout
from sim.energy import Energy
from sim.newton import Equilibrium, NewtonOptions, Status
from sim.sensitivity import Past, answers_in_turn

_KEEPS = 0.2  # of the way, more than which a step may not leave to go if the factors are to serve again
_FAR = 0.4  # of the way, that a step with fresh factors leaves where what turns is far from its end
_FELL = 0.25  # of a step's share of the way, by which what is left to go has to fall for the step to be taken
_HALVES = 4  # of a step, before there is none
_OPEN = 0.05  # of the smallest J of each frame, that a step must leave

Remembered = Callable[[np.ndarray], tuple[Energy, Callable[[], Sequence[Past]]]]  # of a motion (T, N, 3) [m]


@dataclass(frozen=True, kw_only=True, eq=False)
class Settled:
    """Frames in equilibrium with what they remember, the energy they are in, and factors that serve nearby."""

    equilibrium: Equilibrium
    energy: Energy
    factors: DirectFactors | None


def settle(
    remembered: Remembered, start: np.ndarray, layout: Layout, *, factors: DirectFactors | None = None,
    options: NewtonOptions | None = None, still: float = 0.0, stalled: float = 0.0, patient: bool = True,
) -> Settled:  # fmt: skip
    """The motion that is in equilibrium with what it lets itself remember, from `start` (T, N, 3) [m].

    `remembered` gives the energy at a motion, with what is remembered of it, and how frames pass on their changes. A
    step solves the block triangular system of all frames in turn. It is taken if what is left to go by the same factors
    falls (Deuflhard's natural monotonicity test, Newton Methods for Nonlinear Problems, 3.3): forces may well rise on
    the way of a large turn. The last one is of root mean square below `still` [m]; it may be the one by which that was
    tested. Factors, of a motion nearby, serve until a step with them leaves too much, and more than one with fresh ones
    did (some of what is remembered may not be told). Where no step along the direction leaves less, a tangent is not
    positive definite (what it leads to may be no minimum), or the caller is not `patient` and one with fresh factors
    leaves much, or the first one, with those given, as much as there was, the motion so far is returned, and the status
    of its frames says so. Not where the step would be smaller than `stalled` [m]: strains that take turns in being
    remembered leave no smaller ones.
    """
    options = options or NewtonOptions()
    here, fresh, steps, ending, expected = _State.at(remembered, start), False, 0, Status.ITERATIONS, _KEEPS
    while here.residual.max() > options.tolerance and steps < options.iterations:
        if factors is None:
            factors, fresh = DirectFactors.of(here.energy.tangent(here.y), layout), True
            if not factors.positive.all():
                ending = Status.LINE_SEARCH
                break
        direction = here.way(factors, here.gradient)
        there, following = _searched(remembered, here, factors, direction, _HALVES if fresh else 1)
        left = np.inf if there is None else _size(following) / max(_size(direction), 1e-300)
        steps += 1
        if _size(direction) < still:
            here, ending = there or here, Status.CONVERGED
            break
        if there is not None and _size(following) < still:
            here, ending = there.moved(remembered, following) or there, Status.CONVERGED
            break
        if there is None and fresh:
            ending = Status.CONVERGED if _size(direction) < stalled else Status.LINE_SEARCH
            break
        here = there or here
        if not patient and (left > _FAR if fresh else there is None and steps == 1):
            break
        if fresh:
            expected = max(left, _KEEPS)
        elif left > expected:
            factors = None
        fresh = False
    status = tuple(Status.CONVERGED if r <= options.tolerance else ending for r in here.residual)
    equilibrium = Equilibrium(
        y=here.y, status=status, residual=here.residual, iterations=np.full(len(here.y), steps)
    )  # fmt: skip
    return Settled(equilibrium=equilibrium, energy=here.energy, factors=factors)


def _searched(
    remembered: Remembered, here: "_State", factors: DirectFactors, direction: np.ndarray, tries: int
) -> tuple["_State | None", np.ndarray | None]:
    """The first of ever shorter steps that leaves less to go, and the step by the same slopes that it leaves; else
    None."""
    for k in range(tries):
        there = here.moved(remembered, 0.5**k * direction)
        following = None if there is None else here.way(factors, there.gradient)
        if following is not None and _size(following) < (1 - _FELL * 0.5**k) * _size(direction):
            return there, following
    return None, None


def _size(way: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt((way**2).mean()))


@dataclass(frozen=True, kw_only=True, eq=False)
class _State:
    y: np.ndarray
    energy: Energy
    pasts: Callable[[], Sequence[Past]]
    gradient: np.ndarray
    residual: np.ndarray
    smallest: np.ndarray  # J of each frame

    @classmethod
    def at(cls, remembered: Remembered, y: np.ndarray, smallest: np.ndarray | None = None) -> "_State":
        """smallest: where it is known already."""
        energy, pasts = remembered(y)
        gradient = energy.gradient(y)
        residual = np.linalg.norm(gradient, axis=(1, 2)) / energy.scale(y)
        smallest = _smallest(energy, y) if smallest is None else smallest
        return cls(y=y, energy=energy, pasts=pasts, gradient=gradient, residual=residual, smallest=smallest)

    def moved(self, remembered: Remembered, step: np.ndarray) -> "_State | None":
        """After a step (T, N, 3) [m]; None where that nearly closes a point."""
        y = self.y + step
        smallest = _smallest(self.energy, y)
        upright = (smallest > _OPEN * np.minimum(self.smallest, 1.0)).all()
        return self.at(remembered, y, smallest) if upright else None

    def way(self, factors: DirectFactors, gradient: np.ndarray) -> np.ndarray:
        """Newton's step from a gradient (T, N, 3) [N], by the slopes of this state, (T, N, 3) [m]."""
        return np.concatenate(list(answers_in_turn(self.energy, factors, -gradient[:, None], self.pasts())))


def _smallest(energy: Energy, y: np.ndarray) -> np.ndarray:
    """J, (T,)."""
    return np.linalg.det(energy.elastic.cloud.deformation_gradient(y)).min(axis=1)
