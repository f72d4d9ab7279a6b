"""Learning the material from observed equilibria by Gauss-Newton (paper "Material Reconstruction")."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sim.adjoint import gradient_check
from sim.basis import Basis, FitOptions
from sim.checks import require
from sim.direct import Layout, solve_directly
from sim.energy import Energy
from sim.evidence import Normal, best_hyperparameters, design_effect, in_parts, independent, posterior, spread
from sim.lame import Lame
from sim.newton import Equilibrium, NewtonOptions, equilibrate
from sim.resolution import changed_forces
from sim.sensitivity import sensitivities
from sim.solvers import KeptSolver, Solver
from sim.target import Target

_DIFFER = 0.05  # share of their square in which loads differ between frames, to be told by that
_MOST = 0.2  # of the motion, that another discretisation may change
_PARTS = 5  # of the frames, each left out in turn to see how well the others tell it


@dataclass(frozen=True, kw_only=True, eq=False)
class FitState:
    """Everything needed to go on: coefficients, hyperparameters, states, the course of the objective."""

    a: np.ndarray  # (K,) coefficients
    length: float  # prior correlation length [m]
    amplitude: float  # prior standard deviation of log mu
    sigma: float  # noise [m]
    y: np.ndarray  # (T, N, 3)
    objective: tuple[float, ...]  # after each step, with the data counted as in that step
    done: bool = False
    before: tuple[float, float] = (np.inf, np.inf)  # length and amplitude of the prior one choice ago; and whether
    settled: bool = False  # no other is looked for: two were chosen in turn


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A learnt material, what the data said about each point, and how the fit went."""

    lame: Lame
    state: FitState
    equilibrium: Equilibrium
    log_mu_sd: np.ndarray  # (N,) standard deviation of log mu, prior and discretisation unknown too; `evidence.spread`
    resolution_sd: np.ndarray  # (N,) the part of it that the discretisation makes
    determined: np.ndarray  # (N,) 0: only the prior speaks, 1: only the data; see `_determined`
    mean_sd: float  # posterior standard deviation of the mean of log mu
    centre: float  # log mu where the coefficients vanish
    sentence: str


def fit(
    energy: Energy,
    target: Target,
    start: np.ndarray,
    *,
    mu: float,
    options: FitOptions | None = None,
    guess: np.ndarray | None = None,
    state: FitState | None = None,
    progress: Callable[[FitState], None] | None = None,
) -> Fit:
    """The most probable material given observed equilibria.

    energy: loads and supports; its own material is only replaced. start (T, N, 3) [m]: where the first solve begins.
    mu [Pa]: first guess of the shear modulus; guess (K,): coefficients of an earlier fit around the same mu.
    Minimises `|r|^2 / 2 sigma^2 + a^T G^-1 a / 2` over the coefficients of a smooth field, with explicit sensitivities;
    the prior's length and amplitude and, where unknown, the noise maximise the linearised evidence, so the field
    becomes no rougher than the noise allows; data count by how independent they are (`sim.evidence.independent`).
    `progress` sees the state after every step; pass one back in to resume.
    """
    options = options or FitOptions()
    basis = Basis.of(energy.elastic.cloud, options, mu)
    solver = KeptSolver.of(energy, len(target.y), options.newton.linear)
    state = state or _first_state(energy, target, start, basis, solver, guess)
    frames = None
    while not state.done:
        frames = normal_equations(energy, target, basis, state)
        state = _step(energy, target, basis, solver, state, frames)
        if progress is not None:
            progress(state)
    return _result(energy, target, basis, solver, state, frames)


def guess_modulus(energy: Energy, target: Target, mu: float = 1e4) -> float:
    """A first shear modulus [Pa]: the one whose linear response to the loads best matches the observed motion.

    Where the loads differ, their differences match those of the motion: nothing that pushes all the time enters.
    Raises ValueError when no frame is loaded: motion without loads tells no modulus.
    """
    cloud = energy.elastic.cloud
    lame = Lame.from_young(np.full(cloud.count, 2.8 * mu), 0.4)
    energy = energy.with_elastic(type(energy.elastic).neo_hookean(cloud, lame))
    rest = np.repeat(cloud.x[None], len(target.y), axis=0)
    right = -energy.gradient(rest)
    require(bool(right.any()), "loads", "act on a point that may move in at least one frame of the fit", "none")
    largest = np.argmax((right**2).sum(axis=(1, 2)), keepdims=True)
    tangent = energy.frames(largest).tangent(rest[:1])
    u = solve_directly(tangent, Layout.of(energy.elastic), right[None])[0]
    u, d = np.where(target.seen[..., None], u, 0.0), target.residual(rest)
    apart = target.differing(u)
    if (apart**2).sum() > _DIFFER * (u**2).sum():
        u, d = apart, target.differing(d)
    scale = (u * d).sum() / (u**2).sum()
    return mu / max(float(scale), 1e-6)


def _solve(energy: Energy, lame: Lame, start: np.ndarray, solver: Solver, newton: NewtonOptions) -> Equilibrium:
    m = np.stack([lame.mu, lame.lam], axis=1)
    return equilibrate(energy.with_elastic(energy.elastic.with_parameters(m)), start, options=newton, solver=solver)


def _first_state(
    energy: Energy, target: Target, start: np.ndarray, basis: Basis, solver: Solver, guess: np.ndarray | None
) -> FitState:
    a = np.zeros(basis.log_mu.shape[1]) if guess is None else guess
    y = _solve(energy, basis.lame(a), start, solver, basis.options.newton).y
    sigma = target.sigma or target.rms(y)
    state = FitState(a=a, length=basis.size / 8, amplitude=0.7, sigma=sigma, y=y, objective=())
    return replace(state, objective=(_objective(target, basis, state),))


def _objective(target: Target, basis: Basis, state: FitState, factor: float = 1.0) -> float:
    """Minus the log posterior, the data counted as 1/factor as many."""
    data = (target.residual(state.y) ** 2).sum() / (2 * state.sigma**2) + target.count * np.log(state.sigma)
    return float(data / factor + (state.a**2 / basis.prior(state.length, state.amplitude)).sum() / 2)


def normal_equations(
    energy: Energy, target: Target, basis: Basis, state: FitState, more: np.ndarray | None = None
) -> list[Normal]:
    """The linearised data of each frame at a state: A = J^T J, b = J^T (r + J a), c = |r + J a|^2.

    more (T, L, N, 3) [N]: what the loads would change by with L parameters that follow the coefficients, now zero.
    """
    lame, moved = basis.lame(state.a), energy.with_elastic(basis.elastic(energy.elastic, state.a))
    residual, frames = target.residual(state.y), []
    for t, S in enumerate(sensitivities(moved, state.y, basis.directions(lame), more=more)):
        J = S[:, target.seen[t]].reshape(len(S), -1)
        z = residual[t, target.seen[t]].ravel() + state.a @ J[: len(state.a)]
        frames.append(Normal(A=J @ J.T, b=J @ z, c=float(z @ z), count=z.size))
    return frames


def _step(
    energy: Energy, target: Target, basis: Basis, solver: Solver, state: FitState, frames: list[Normal]
) -> FitState:
    """One Gauss-Newton step with hyperparameters re-estimated, shortened until the objective falls.

    While the residual is far above the noise the data count less (sigma is at least half the residual), which keeps
    directions that only the noise would decide from running ahead of the linearisation.
    """
    parts, factor = _counted(target, basis, state, frames)
    state = best_hyperparameters(parts, basis, state, target.sigma, floor=0.5 * target.rms(state.y))
    before = _objective(target, basis, state, factor)
    change = posterior(Normal.sum(parts), basis.prior(state.length, state.amplitude), state.sigma).mean - state.a
    largest = max(np.abs(basis.log_mu @ change).max(), np.abs(basis.log_ratio @ change).max(), 1e-12)
    size = min(1.0, basis.options.step / largest)
    for _ in range(6):
        a = state.a + size * change
        y = _solve(energy, basis.lame(a), state.y, solver, basis.options.newton)
        trial = replace(state, a=a, y=y.y)
        after = _objective(target, basis, trial, factor)
        if y.converged and after < before:
            enough = (
                before - after < basis.options.gain * target.count / factor
                or len(state.objective) >= basis.options.iterations
            )
            return replace(trial, objective=(*state.objective, after), done=enough)
        size /= 3
    return replace(state, done=True)


def _counted(target: Target, basis: Basis, state: FitState, frames: list[Normal]) -> tuple[list[Normal], float]:
    """The data in parts, counted as 1/factor as many, and that factor: see `sim.evidence.independent`."""
    parts, prior = in_parts(frames, _PARTS), basis.prior(state.length, state.amplitude)
    least = design_effect(target.residual(state.y), target.seen, basis.field.modes[:, 1:])
    factor = independent(parts, prior, state.sigma, least)
    return [part.thinned(factor) for part in parts], factor


def _result(
    energy: Energy, target: Target, basis: Basis, solver: Solver, state: FitState, frames: list[Normal] | None
) -> Fit:
    lame = basis.lame(state.a)
    equilibrium = _solve(energy, lame, state.y, solver, basis.options.newton)
    wrong = None
    if basis.options.modes:
        frames, wrong = _with_resolution(energy, target, basis, state)
    elif frames is None:
        frames = normal_equations(energy, target, basis, state)
    parts, factor = _counted(target, basis, state, frames)
    prior, normal = basis.prior(state.length, state.amplitude), Normal.sum(parts)
    covariance = posterior(normal, prior, state.sigma).covariance
    priors, wrong = [prior, *basis.priors()], None if wrong is None else wrong / factor
    alone, resolution = spread(parts, priors, state.sigma, basis.log_mu, wrong)
    steps = len(state.objective) - 1
    limit = steps >= basis.options.iterations
    reason = "stopped at the iteration limit" if limit else "ended because a further step gained next to nothing"
    return Fit(
        lame=lame, state=state, equilibrium=equilibrium, log_mu_sd=np.hypot(alone, resolution),
        resolution_sd=resolution, determined=_determined(basis, normal, state.sigma),
        mean_sd=float(np.sqrt(covariance[0, 0])), centre=basis.centre,
        sentence=f"{reason}, after {steps} steps; {equilibrium.sentence}",
    )  # fmt: skip


def _with_resolution(
    energy: Energy, target: Target, basis: Basis, state: FitState
) -> tuple[list[Normal], np.ndarray]:
    """The data of each frame at the end, and J^T D (K, L) for what other discretisations change.

    One standard deviation is all of that change, at most a fifth of the motion: beyond it the first order says nothing.
    """
    K, u = len(state.a), np.where(target.seen[..., None], state.y - energy.elastic.cloud.x, 0.0)
    frames = normal_equations(
        energy, target, basis, state, changed_forces(basis.elastic(energy.elastic, state.a), state.y)
    )
    both = sum(frame.A for frame in frames)
    size = np.sqrt(np.diagonal(both)[K:] / max(float((u**2).sum()), 1e-300))
    own = [Normal(A=f.A[:K, :K], b=f.b[:K], c=f.c, count=f.count) for f in frames]
    return own, both[:K, K:] * np.minimum(1.0, _MOST / np.maximum(size, 1e-300))


def _determined(basis: Basis, normal: Normal, sigma: float) -> np.ndarray:
    """Share of the variance of log mu (N,) that the data remove from one and the same prior for every object.

    That prior lets stiffness vary by a factor of e^0.5 over an eighth of the object's size. The one that the fit chose
    would not do: where it found a homogeneous object, it calls a point that no load ever strained well known.
    """
    prior = basis.prior(basis.size / 8, 0.5)
    before = (basis.log_mu[:, 1:] ** 2 * prior[1:]).sum(axis=1) if basis.options.modes else prior[:1]
    covariance = posterior(normal, prior, sigma).covariance
    return np.clip(1 - np.einsum("nk,kl,nl->n", basis.log_mu, covariance, basis.log_mu) / before, 0, 1)


def check_gradient(energy: Energy, target: Target, result: Fit) -> float:
    """Adjoint against finite differences at the fitted material, on the most deformed frame."""
    motion = ((result.equilibrium.y - energy.elastic.cloud.x) ** 2).sum(axis=(1, 2))
    index = np.array([np.argmax(motion)])
    m = np.stack([result.lame.mu, result.lame.lam], axis=1)
    part = energy.frames(index).with_elastic(energy.elastic.with_parameters(m))
    some = Target(y=target.y[index], seen=target.seen[index])
    y = result.equilibrium.y[index]
    return gradient_check(part, y, some.loss, solver=KeptSolver.of(part, 1, "direct"))
