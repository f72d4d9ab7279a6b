"""A cause fitted for real: its parameters, the material and the discretisation together, by nonlinear solves."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from sim.energy import Energy
from sim.evidence import Normal, Posterior, jackknife, posterior
from sim.newton import LinearSolver
from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.columns import directions_of
from veo_ti.diagnosis.model import Model, Refit, change_of, shown_by
from veo_ti.diagnosis.moments import Fingerprints, moments
from veo_ti.diagnosis.scene import Scene
from veo_ti.diagnosis.solved import Solved, solved

_STEPS = 12
_LEAST = 0.5  # predicted gain [nats] below which the fit is done
_SHARE = 1e-3  # of the cost, likewise
_CAUTION = 1.5  # largest change of log mu in one step
_DAMPED, _MORE, _LEAST_DAMPED = 0.1, 10.0, 1e-2  # of the curvature: at first, times, and less is none
_TRIES = 5  # of a step, ever more damped; and
_TRIES_WITH_OLD = 2  # with old fingerprints
_KEPT = 0.7  # share of the promised gain that a step must bring for its fingerprints to serve again
_PARTS = 8  # runs of frames that are left out in turn to see how sure a parameter is
_T = 2.36 / 1.96  # Student's 97.5 % quantile with seven degrees of freedom over the normal one


def refit(
    scene: Scene,
    model: Model,
    start: np.ndarray,
    *,
    cause: Cause | None = None,
    place: Any = None,
    theta: np.ndarray | None = None,
    shift: np.ndarray | None = None,
    progress: Callable[[str], None] | None = None,
) -> Refit:
    """Gauss-Newton over material, discretisation and cause from coefficients start (K + E,) and theta (d,).

    shift (K + E,): how the coefficients move together with theta, to first order; the step is then shortened until it
    costs less than none. History (viscous strain, damage, set) belongs to the motion that it leads to, in the slopes
    too. The discretisation enters linearly. A step that raises the cost or leads to no equilibrium is damped, what the
    data determine least most (Levenberg & Marquardt). The fingerprints serve several steps; they are renewed where a
    step with old ones brings less than it promised.
    """
    theta = np.zeros(0) if cause is None else np.asarray(theta, float)
    base = scene.energy
    widths = np.zeros(0) if cause is None else cause.widths(scene)
    prior = np.concatenate([model.prior, widths**2])
    solver = LinearSolver.of(base)
    state, cost = _best_start(scene, base, model, solver, cause, place, theta, start, shift, prior)
    line, fresh, damping = _linearised(state, model, cause, place), True, 0.0
    for step in range(_STEPS + 1):
        normal = line.normal(state, model, cause, place)
        full = np.concatenate([state.coefficients, state.theta])
        found = posterior(normal, prior, np.sqrt(model.s2))
        change = found.mean - full
        curvature = normal.A / model.s2 + np.diag(1 / prior)
        gain = 0.5 * change @ curvature @ change
        if gain < max(_LEAST, _SHARE * cost) or step == _STEPS:
            break
        tries = _TRIES if fresh else _TRIES_WITH_OLD
        smaller, promised, damping = _lower(
            state, cost, base, model, solver, cause, place, change, curvature, prior, damping, tries
        )
        if smaller is None and fresh:
            break
        kept = smaller is not None and cost - smaller[1] > _KEPT * promised
        state, cost = smaller or (state, cost)
        if not kept:
            line = _linearised(state, model, cause, place)
        fresh = not kept
        if progress is not None:
            progress(cause.name if cause else "baseline")
    return _result(state, cost, cause, place, found, prior, normal, line.kept, model, gain)


def _residual(scene: Scene, cause: Cause | None, place: Any, theta: np.ndarray) -> np.ndarray:
    """Observed minus shown, without the discretisation's part, on the frames that train, (T, N, 3)."""
    r = scene.target.residual(shown_by(scene, change_of(scene, cause, theta, place)))
    return r * scene.train[:, None, None]


def _cost(state: Solved, model: Model, cause: Cause | None, place: Any, prior: np.ndarray) -> float:
    """Minus the log posterior; infinite where an equilibrium that counts was not found."""
    if not state.found:
        return np.inf
    return _cost_of(state.scene, state.theta, state.coefficients, model, cause, place, prior)


def _cost_of(
    scene: Scene, theta: np.ndarray, coefficients: np.ndarray, model: Model, cause: Cause | None, place: Any,
    prior: np.ndarray,
) -> float:  # fmt: skip
    counted = (scene.target.seen & scene.train[:, None])[..., None]
    r = _residual(scene, cause, place, theta) - _numerics(coefficients, model) * counted
    full = np.concatenate([coefficients, theta])
    return float((r**2).sum() / (2 * model.s2) + (full**2 / prior).sum() / 2)


def _best_start(
    scene: Scene, base: Energy, model: Model, solver: LinearSolver, cause: Cause | None, place: Any,
    theta: np.ndarray, start: np.ndarray, shift: np.ndarray | None, prior: np.ndarray,
) -> tuple[Solved, float]:  # fmt: skip
    """The longest of a few shares of the score step that costs less than no step; no step where none does."""
    if shift is None:
        state = solved(scene, base, model, solver, cause, place, start, theta)
        return state, _cost(state, model, cause, place, prior)
    most = float(np.abs(model.basis.log_mu @ shift[: model.basis.log_mu.shape[1]]).max())
    longest = min(1.0, _CAUTION / max(most, 1e-12))
    without = _cost_of(scene, np.zeros(0), start, model, None, None, model.prior)
    for share in (longest, 0.3 * longest, 0.1 * longest, 0.0):
        begun = _stepped(cause, np.zeros(len(theta)), share * theta)
        state = solved(scene, base, model, solver, cause, place, start + share * shift, begun)
        cost = _cost(state, model, cause, place, prior)
        if cost < without:
            break
    return state, cost


def _stepped(cause: Cause | None, theta: np.ndarray, change: np.ndarray) -> np.ndarray:
    return theta if cause is None else cause.stepped(theta, change)


def _lower(
    state: Solved, cost: float, base: Energy, model: Model, solver: LinearSolver, cause: Cause | None, place: Any,
    change: np.ndarray, curvature: np.ndarray, prior: np.ndarray, damping: float, tries: int,
) -> tuple[tuple[Solved, float] | None, float, float]:  # fmt: skip
    """The least damped of a few steps that lowers the cost, or None; what it promised; the damping to begin with next.

    That is the same where less was too little, else less: a step that leads to no equilibrium is slow to find out.
    """
    K, n = model.basis.log_mu.shape[1], len(state.coefficients)
    for k in range(tries):
        scaled = curvature + damping * np.diag(np.diagonal(curvature))
        step = np.linalg.solve(scaled, curvature @ change) if damping else change
        step = step * min(1.0, _CAUTION / max(float(np.abs(model.basis.log_mu @ step[:K]).max()), 1e-12))
        theta = _stepped(cause, state.theta, step[n:])
        trial = solved(
            state.scene, base, model, solver, cause, place, state.coefficients + step[:n], theta, state.factors
        )
        lower = _cost(trial, model, cause, place, prior)
        if lower < cost:
            less = damping / _MORE if damping / _MORE >= _LEAST_DAMPED else 0.0
            promised = float(step @ curvature @ (change - step / 2))
            return (trial, lower), promised, damping if k else less
        damping = max(_DAMPED, _MORE * damping)
    return None, 0.0, damping


@dataclass(frozen=True, kw_only=True, eq=False)
class _Line:
    """Fingerprints that were solved for at one state and serve nearby."""

    A: np.ndarray
    kept: Fingerprints

    def normal(self, state: Solved, model: Model, cause: Cause | None, place: Any) -> Normal:
        """The data linearised around a state; the unknowns are the coefficients and theta themselves."""
        at = _around(state, model)
        seen = state.scene.target.seen
        return self.kept.normal(self.A, _residual(state.scene, cause, place, state.theta), seen, at)


def _around(state: Solved, model: Model) -> np.ndarray:
    at = np.concatenate([state.coefficients, state.theta])
    at[model.basis.log_mu.shape[1] : len(state.coefficients)] = 0.0  # the residual still holds their part
    return at


def _linearised(state: Solved, model: Model, cause: Cause | None, place: Any) -> _Line:
    """Fresh fingerprints."""
    K, scene = model.basis.log_mu.shape[1], state.scene
    own = [] if cause is None else directions_of(cause, scene, place, state.theta)
    companion = None
    if cause is not None and cause.companion(scene, state.theta, place) is not None:
        companion = partial(cause.companion, theta=state.theta, place=place)
    carried = None if cause is None else cause.carried(scene, state.theta, place)
    remembered = () if cause is None else cause.remembered(scene, state.theta, place)
    found = moments(
        scene, model.basis, state.coefficients[:K], model.extra, own, companion=companion, carried=carried,
        remembered=remembered, keep=True,
    )  # fmt: skip
    return _Line(A=found.normal.A, kept=found.kept)


def _numerics(coefficients: np.ndarray, model: Model) -> np.ndarray:
    """The discretisation's part of the motion, (T, N, 3) [m]."""
    K = model.basis.log_mu.shape[1]
    return sum((c * known.motion for c, known in zip(coefficients[K:], model.extra, strict=True)), 0.0)


def _result(
    state: Solved, cost: float, cause: Cause | None, place: Any, found: Posterior, prior: np.ndarray, normal: Normal,
    kept: Fingerprints, model: Model, gain: float,
) -> Refit:  # fmt: skip
    n, seen = len(state.coefficients), state.scene.target.seen
    parts = kept.parts(_residual(state.scene, cause, place, state.theta), seen, _around(state, model), _PARTS)
    sd = np.maximum(np.sqrt(np.diagonal(found.covariance)), _T * jackknife(parts, prior, np.sqrt(model.s2)))
    done = gain < max(_LEAST, 2 * _SHARE * cost)
    return Refit(
        cause=cause, place=place, theta=state.theta, sd=sd[n:], scene=state.scene,
        without=state.without, coefficients=found.mean[:n], normal=normal, prior=prior,
        around=_around(state, model), kept=kept,
        short=float(gain), converged=bool(done), numerics=_numerics(found.mean[:n], model),
        sentence="converged" if done else f"stopped {gain:.1f} nats before its best",
    )  # fmt: skip
