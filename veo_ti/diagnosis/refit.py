"""A cause fitted for real: its parameters, the material and the discretisation together, by nonlinear solves."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim.direct import DirectFactors
from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.fitted import Refit
from veo_ti.diagnosis.model import Model
from veo_ti.diagnosis.problem import Problem
from veo_ti.diagnosis.scene import Scene
from veo_ti.diagnosis.solved import Solved, solved
from veo_ti.diagnosis.way import LEAST, SHARE, Reached, Way, cost_of

_STEPS = 12
_ROUGH = 1e-2  # share of the cost, a predicted gain below which a rough fit is done
_STALLED = 0.5  # of that, less than which a step may not bring with fresh fingerprints
_SLOW, _CREEPING = 0.01, 3  # of the cost, that a step may bring at least; and times less, after which the fit ends;
_ROUGHLY_SLOW = 0.03  # of a rough one
_CAUTION = 1.5  # largest change of log mu in one step
_DAMPED, _MORE = 1e-2, 10.0  # of the curvature, less than which is none; and times
_SHORTER = 0.3  # of a step that leads to no equilibrium
_TRIES = 5  # of a step, ever more damped or shorter; and
_TRIES_WITH_OLD = 2  # with old fingerprints
_PROMISED = 1.25  # times what its whole way promises, that a fit may bring
_HOPELESS = 3.0  # times the cost, more than which no trial on its way that ends below it costs
_NEAR = 10.0  # times the cost, more than which a step may not bring too little to be bent
_KEPT = 0.7  # share of the promised gain that a step must bring for its fingerprints to serve again, and for less care


def refit(
    scene: Scene,
    model: Model,
    start: np.ndarray,
    *,
    cause: Cause | None = None,
    place: Any = None,
    theta: np.ndarray | None = None,
    shift: np.ndarray | None = None,
    since: np.ndarray | None = None,
    rough: bool = False,
    most: float = np.inf,
    onward: Refit | None = None,
) -> Refit:
    """Gauss-Newton over material, discretisation and cause from coefficients start (K + E,) and theta (d,).

    shift (K + E,): how the coefficients move together with theta, to first order; the step is then shortened until
    it costs less than none. since (d,): theta before a move from another place, to which theta and shift belong; it is
    made unless it leads to no equilibrium. History (viscous strain, damage, set) belongs to the motion that it leads
    to, in the slopes too. The discretisation enters linearly. A step that raises the cost is damped, what the data
    determine least most (Levenberg & Marquardt), and one that leads to no equilibrium shortened; one that brings far
    less than it promised is bent where the way is. The fingerprints serve several steps; they are renewed where a step
    with old ones brings less than it promised. A fit that creeps, as next to an instability, ends unconverged, though
    not by old ones. rough: to a hundredth of the cost. most: of the cost, known to be had elsewhere; given up where not
    even a quarter more than the whole way promises leads there. onward: a fit of the same that ended where this one
    starts, whose fingerprints serve again where they are of the same points.
    """
    theta = np.zeros(0) if cause is None else np.asarray(theta, float)
    problem, name = Problem.of(scene, model, cause, place), "" if cause is None else cause.name
    asked = np.concatenate([start, theta, [np.log(model.s2)]])
    known = model.checkpoints.next(name, asked)
    if known is not None:
        return Reached.again(problem, scene, known).result
    state, cost = _best_start(problem, scene, start, theta, shift, since)
    fresh = onward is None or not onward.serves(scene)
    end = Reached.of(problem, state) if fresh else Reached.onward(problem, state, onward)
    care, slow = _Care(), 0
    for made in range(_STEPS + 1):
        way, least = end.way, max(LEAST, (_ROUGH if rough else SHARE) * cost)
        hopeless = fresh and cost - _PROMISED * way.gain > most
        if way.gain < least or way.broken(cost) or made == _STEPS or slow == _CREEPING or hopeless:
            break
        smaller, told, care = _lower(end, cost, care, least, fresh=fresh)
        brought = 0.0 if smaller is None else cost - smaller[1]
        slow += 0 < brought < (_ROUGHLY_SLOW if rough else _SLOW) * cost
        doubtful = slow == _CREEPING and not fresh
        slow -= doubtful
        stalled = brought < _STALLED * least
        if stalled and fresh:
            break
        state, cost = smaller or (state, cost)
        fresh = stalled or doubtful or not told
        end = Reached.of(problem, state) if fresh else replace(end, state=state)
    model.checkpoints.keep(name, asked, end.arrays)
    return end.result


def _best_start(
    problem: Problem, scene: Scene, start: np.ndarray, theta: np.ndarray, shift: np.ndarray | None,
    since: np.ndarray | None,
) -> tuple[Solved, float]:  # fmt: skip
    """The longest of a few shares of the score step that costs less than no step, or all of a move; no step where none
    does."""
    if shift is None:
        state = solved(problem, scene, start, theta)
        return state, cost_of(problem, state)
    longest = problem.within(shift, _CAUTION)
    if since is None:
        shares, before = (longest, 0.3 * longest, 0.1 * longest, 0.0), np.zeros(len(theta))
        enough = Problem.of(scene, problem.model).cost(scene, start, np.zeros(0))
    else:
        shares, before, enough = (longest, 0.0), since, np.inf
    for share in shares:
        begun = problem.stepped(before, share * (theta - before))
        if problem.turned(begun, before):
            continue
        state = solved(problem, scene, start + share * shift, begun, most=_HOPELESS * enough)
        cost = cost_of(problem, state)
        if cost < enough:
            break
    return state, cost


@dataclass(frozen=True, kw_only=True)
class _Care:
    """How a step is held back: by damping, and to a share of what is left of it."""

    damping: float = 0.0
    share: float = 1.0

    def step(self, way: Way) -> np.ndarray:
        """So much of the way."""
        return self.share * way.damped(self.damping, _CAUTION)

    @property
    def shorter(self) -> "_Care":
        """After a step to no equilibrium. Damping would first hold back what the data determine least, as what a cause
        does together with the material."""
        return replace(self, share=_SHORTER * self.share)

    @property
    def damped(self) -> "_Care":
        """More, after a step that raised the cost."""
        return replace(self, damping=max(_DAMPED, _MORE * self.damping))

    @property
    def less(self) -> "_Care":
        """Since a step brought what it promised."""
        damping = self.damping / _MORE if self.damping >= _MORE * _DAMPED else 0.0
        return _Care(damping=damping, share=min(1.0, self.share / _SHORTER))


def _lower(
    end: Reached, cost: float, care: _Care, least: float, *, fresh: bool
) -> tuple[tuple[Solved, float] | None, bool, _Care]:  # fmt: skip
    """Where the first of a few ever more careful steps that lowers the cost leads, or None; whether it alone brought
    most of what it promised; how careful to begin with next: as much where less was too little, or brought less.

    Where fresh fingerprints told at least so much more [nats] than a step brings, it is bent as well.
    """
    bends = fresh
    for k in range(_TRIES if fresh else _TRIES_WITH_OLD):
        step = care.step(end.way)
        trial, lower = _tried(end, cost, step, end.state.factors)
        promised, whole = end.way.promised(step), lower
        told = _as_told(promised, cost - lower)
        if bends and not told and least < promised - cost + lower < _NEAR * cost:
            trial, lower = _bent(end, cost, step, trial, lower)
            bends = lower < whole
        if lower < cost:
            easy = k == 0 and _as_told(promised, cost - lower)
            return (trial, lower), told, care.less if easy else care
        care = care.shorter if trial is not None and lower == np.inf else care.damped
    return None, False, care


def _as_told(promised: float, brought: float) -> bool:
    """Whether a step brought most of what it promised."""
    return not brought < _KEPT * promised


def _bent(end: Reached, cost: float, step: np.ndarray, there: Solved, lower: float) -> tuple[Solved, float]:
    """The end of a step, or of one that also goes where its end says that the way bends (geodesic acceleration,
    Transtrum & Sethna 2012), if that costs less. If not, the fingerprints tell something else than what happens: then
    the part of the step that a parabola through its slope and its end says to be best, if that does."""
    line, way = end.line, end.way
    bent = way.bent(step, line.normal(there.scene, there.coefficients, there.theta), line.problem.model.s2)
    trial, cheaper = _tried(end, cost, bent, there.factors)
    if not cheaper < lower and lower < cost:
        slope = way.slope(step)
        trial, cheaper = _tried(end, cost, slope / (2 * (slope - cost + lower)) * step, there.factors)
    return (trial, cheaper) if cheaper < lower else (there, lower)


def _tried(end: Reached, cost: float, step: np.ndarray, factors: DirectFactors | None) -> tuple[Solved | None, float]:
    """A step and its cost; none where it turns what must not turn. Newton's method begins where the fingerprints say
    that it leads."""
    problem, state = end.line.problem, end.state
    n = len(state.coefficients)
    theta = problem.stepped(state.theta, step[n:])
    if problem.turned(theta, state.theta):
        return None, np.inf
    begun = end.line.ahead(state.scene, np.concatenate([step[:n], theta - state.theta]))
    trial = solved(problem, begun, state.coefficients + step[:n], theta, factors, most=_HOPELESS * cost)
    return trial, cost_of(problem, trial)
