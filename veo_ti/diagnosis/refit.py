"""A cause fitted for real: its parameters, the material and the discretisation together, by nonlinear solves."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim.basis import Basis
from sim.elastic import Elastic
from sim.energy import Energy
from sim.evidence import Normal, Posterior, posterior
from sim.newton import Equilibrium, LinearSolver, NewtonOptions, Status, equilibrate
from veo_ti.diagnosis.causes.base import Cause, Change
from veo_ti.diagnosis.columns import Known, directions_of, moments
from veo_ti.diagnosis.scene import Scene

_STEPS = 5
_LEAST = 0.5  # predicted gain [nats] below which the fit is done
_SHARE = 1e-3  # of the cost, likewise
_CAUTION = 1.5  # largest change of log mu in one step
NEWTON = NewtonOptions(tolerance=1e-5, iterations=20)


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """What stays the same in every refit: the material's basis, all prior variances, the variance of the noise."""

    basis: Basis
    prior: np.ndarray  # (K + E,) of the material's coefficients and of the discretisation columns
    s2: float  # [m2]
    extra: tuple[Known, ...]  # discretisation columns

    def elastic(self, elastic: Elastic, a: np.ndarray) -> Elastic:
        """The elastic energy with the material of coefficients a."""
        lame = self.basis.lame(a)
        return elastic.with_parameters(np.stack([lame.mu, lame.lam], axis=1))


@dataclass(frozen=True, kw_only=True, eq=False)
class Refit:
    """The most probable parameters of a cause (None: of the baseline) and what they are worth."""

    cause: Cause | None
    place: Any
    theta: np.ndarray  # (d,)
    sd: np.ndarray  # (d,)
    scene: Scene  # under the extended energy
    without: Scene  # the same motion, before the cause joined the energy
    coefficients: np.ndarray  # (K + E,), material and discretisation
    evidence: float  # log, up to a constant common to all causes
    converged: bool
    sentence: str

    numerics: np.ndarray  # (T, N, 3) [m], the discretisation's part

    @property
    def simulated(self) -> np.ndarray:
        """Simulated positions as tracking would show them, (T, N, 3) [m]."""
        return _seen(self.scene, _change(self.scene, self.cause, self.theta, self.place))

    @property
    def shown(self) -> np.ndarray:
        """The prediction: simulated positions corrected by the discretisation's part, (T, N, 3) [m]."""
        return self.simulated + self.numerics


def refit(
    scene: Scene,
    model: Model,
    start: np.ndarray,
    *,
    cause: Cause | None = None,
    place: Any = None,
    theta: np.ndarray | None = None,
    progress: Callable[[str], None] | None = None,
) -> Refit:
    """Gauss-Newton over material, discretisation and cause from coefficients start (K + E,) and theta (d,).

    History (viscous strain, damage) follows the previous step's motion. The discretisation enters linearly. A step
    that raises the cost is shortened; where none lowers it, the fit ends as it stands and says so.
    """
    theta = np.zeros(0) if cause is None else np.asarray(theta, float)
    base = scene.energy
    widths = np.zeros(0) if cause is None else cause.widths(scene)
    prior = np.concatenate([model.prior, widths**2])
    solver = LinearSolver.of(base)
    state, cost = _best_start(scene, base, model, solver, cause, place, theta, start, prior)
    for step in range(_STEPS + 1):
        normal = _normal(state, model, cause, place)
        full = np.concatenate([state.coefficients, state.theta])
        found = posterior(normal, prior, np.sqrt(model.s2))
        change = found.mean - full
        gain = 0.5 * change @ (normal.A / model.s2 + np.diag(1 / prior)) @ change
        if gain < max(_LEAST, _SHARE * cost) or step == _STEPS:
            break
        smaller = _lower(state, cost, base, model, solver, cause, place, change, prior)
        if smaller is None:
            break
        state, cost = smaller
        if progress is not None:
            progress(cause.name if cause else "baseline")
    return _result(state, cost, cause, place, found, prior, normal, model, gain)


@dataclass(frozen=True, kw_only=True, eq=False)
class _State:
    scene: Scene
    without: Scene
    coefficients: np.ndarray
    theta: np.ndarray
    equilibrium: Equilibrium


def _change(scene: Scene, cause: Cause | None, theta: np.ndarray, place: Any) -> Change:
    return Change() if cause is None else cause.change(scene, theta, place)


def _seen(scene: Scene, change: Change) -> np.ndarray:
    return scene.y if change.observe is None else change.observe(scene.y, np.arange(len(scene.y)))


def _solved(
    scene: Scene, base: Energy, model: Model, solver: LinearSolver, cause: Cause | None, place: Any,
    coefficients: np.ndarray, theta: np.ndarray,
) -> _State:  # fmt: skip
    K = model.basis.log_mu.shape[1]
    energy = base.with_elastic(model.elastic(base.elastic, coefficients[:K]))
    change = _change(scene.of_material(energy.elastic.m), cause, theta, place)
    extended = replace(energy, terms=(*base.terms, *change.terms))
    equilibrium = equilibrate(extended, scene.y, options=NEWTON, solver=solver)
    return _State(
        scene=scene.moved(extended, equilibrium.y), without=scene.moved(energy, equilibrium.y),
        coefficients=coefficients, theta=theta, equilibrium=equilibrium,
    )  # fmt: skip


def _residual(state: _State, model: Model, cause: Cause | None, place: Any) -> np.ndarray:
    """Observed minus shown, without the discretisation's part, on the frames that train, (T, N, 3)."""
    scene = state.scene
    r = scene.target.residual(_seen(scene, _change(scene, cause, state.theta, place)))
    return r * scene.train[:, None, None]


def _cost(state: _State, model: Model, cause: Cause | None, place: Any, prior: np.ndarray) -> float:
    """Minus the log posterior."""
    found = np.array([status is Status.CONVERGED for status in state.equilibrium.status])
    if not found[state.scene.train].all():
        return np.inf
    counted = (state.scene.target.seen & state.scene.train[:, None])[..., None]
    r = _residual(state, model, cause, place) - _numerics(state.coefficients, model) * counted
    full = np.concatenate([state.coefficients, state.theta])
    return float((r**2).sum() / (2 * model.s2) + (full**2 / prior).sum() / 2)


def _best_start(
    scene: Scene, base: Energy, model: Model, solver: LinearSolver, cause: Cause | None, place: Any,
    theta: np.ndarray, start: np.ndarray, prior: np.ndarray,
) -> tuple[_State, float]:  # fmt: skip
    """The share of the score step that costs least: the first whose equilibria are found and that beats the next."""
    best = None
    for share in (1.0, 0.3, 0.0) if cause is not None else (1.0,):
        state = _solved(scene, base, model, solver, cause, place, start, share * theta)
        cost = _cost(state, model, cause, place, prior)
        if best is not None and best[1] <= cost and np.isfinite(best[1]):
            break
        best = (state, cost)
    return best


def _lower(
    state: _State, cost: float, base: Energy, model: Model, solver: LinearSolver, cause: Cause | None, place: Any,
    change: np.ndarray, prior: np.ndarray,
) -> tuple[_State, float] | None:  # fmt: skip
    """The longest of a few shortened steps that lowers the cost, or None."""
    K, n = model.basis.log_mu.shape[1], len(state.coefficients)
    size = min(1.0, _CAUTION / max(float(np.abs(model.basis.log_mu @ change[:K]).max()), 1e-12))
    for _ in range(4):
        coefficients, theta = state.coefficients + size * change[:n], state.theta + size * change[n:]
        trial = _solved(state.scene, base, model, solver, cause, place, coefficients, theta)
        lower = _cost(trial, model, cause, place, prior)
        if lower < cost:
            return trial, lower
        size /= 3
    return None


def _normal(state: _State, model: Model, cause: Cause | None, place: Any) -> Normal:
    """The linearised data at a state; its unknowns are the coefficients and theta themselves."""
    K, scene = model.basis.log_mu.shape[1], state.scene
    own = [] if cause is None else directions_of(cause, scene, place, state.theta)
    r = _residual(state, model, cause, place)
    companion = (lambda other: cause.change(other, state.theta, place)) if cause and cause.material else None
    found = moments(scene, model.basis, state.coefficients[:K], model.extra, own, companion=companion, residual=r)
    A, b, c, count = found.total
    if len(state.theta):  # z = r + J a + S theta
        at = np.concatenate([np.zeros(len(state.coefficients)), state.theta])
        c += float(2 * at @ b + at @ A @ at)
        b = b + A @ at
    return Normal(A=A, b=b, c=c, count=count)


def _numerics(coefficients: np.ndarray, model: Model) -> np.ndarray:
    """The discretisation's part of the motion, (T, N, 3) [m]."""
    K = model.basis.log_mu.shape[1]
    return sum((c * known.motion for c, known in zip(coefficients[K:], model.extra, strict=True)), 0.0)


def _result(
    state: _State, cost: float, cause: Cause | None, place: Any, found: Posterior, prior: np.ndarray, normal: Normal,
    model: Model, gain: float,
) -> Refit:  # fmt: skip
    """Laplace's evidence: minus the lowest cost of the linearised model, minus half the log of the Occam factor."""
    n = len(state.coefficients)
    misfit = normal.c - 2 * normal.b @ found.mean + found.mean @ normal.A @ found.mean
    lowest = misfit / (2 * model.s2) + (found.mean**2 / prior).sum() / 2
    root = np.sqrt(prior)
    occam = np.linalg.slogdet(np.eye(len(prior)) + root[:, None] * normal.A * root / model.s2)[1] / 2
    done = gain < max(_LEAST, 2 * _SHARE * cost)
    sentence = "converged" if done else f"stopped {gain:.1f} nats before its best"
    return Refit(
        cause=cause, place=place, theta=state.theta, sd=np.sqrt(np.diagonal(found.covariance)[n:]), scene=state.scene,
        without=state.without, numerics=_numerics(found.mean[:n], model),
        coefficients=found.mean[:n], evidence=float(-lowest - occam), converged=bool(done), sentence=sentence,
    )  # fmt: skip
