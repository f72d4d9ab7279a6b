"""Batched Newton: the equilibrium of every frame at once (paper "Quasistatic Simulation")."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Literal

import numpy as np

from sim.checks import as_array, require
from sim.energy import Energy, Tangent
from sim.linear import LIMIT, Operator, Preconditioner, Solve, conjugate_gradients
from sim.solvers import LinearSolver, Solver

_ENOUGH, _LOOSE = 0.3, 0.1  # of the tolerance, that a linear solve may leave, but no more of its right side


class Status(Enum):
    """How a frame's solve ended, in a sentence."""

    CONVERGED = "converged"
    ITERATIONS = "stopped at the iteration limit before reaching the tolerance"
    LINE_SEARCH = "stopped because no step along the Newton direction lowered the energy"
    INVERTED = "stopped because the start state is inside out (J <= 0)"


class NotConverged(RuntimeError):
    """Raised on request when a frame has no equilibrium; carries the last iterate."""

    def __init__(self, equilibrium: "Equilibrium") -> None:
        self.equilibrium = equilibrium
        super().__init__(equilibrium.sentence)


@dataclass(frozen=True, kw_only=True)
class NewtonOptions:
    """tolerance is on |dE/dy| relative to the load of the frame; linear chooses the inner solver."""

    tolerance: float = 1e-8
    iterations: int = 60
    linear: Literal["auto", "two-level", "direct"] = "auto"

    def __post_init__(self) -> None:
        require(0 < self.tolerance < 1, "tolerance", "lie between 0 and 1", self.tolerance)
        require(self.iterations > 0, "iterations", "be positive", self.iterations)


@dataclass(frozen=True, kw_only=True, eq=False)
class Equilibrium:
    """The last iterate of every frame and how its solve ended."""

    y: np.ndarray  # (T, N, 3) [m]
    status: tuple[Status, ...]
    residual: np.ndarray  # (T,) |dE/dy| relative to the load
    iterations: np.ndarray  # (T,) Newton steps

    @property
    def converged(self) -> bool:
        """Whether every frame reached its tolerance."""
        return all(s is Status.CONVERGED for s in self.status)

    @property
    def sentence(self) -> str:
        """What happened, naming the frames that failed."""
        failed = [t for t, s in enumerate(self.status) if s is not Status.CONVERGED]
        if not failed:
            return f"all {len(self.status)} frames converged in at most {self.iterations.max()} steps"
        first = failed[0]
        return (
            f"{len(failed)} of {len(self.status)} frames did not converge; "
            f"frame {first} {self.status[first].value} (residual {self.residual[first]:.1e})"
        )

    def with_frames(self, index: np.ndarray, other: "Equilibrium") -> "Equilibrium":
        """The frames `index` replaced by those of another solve."""
        y, residual, iterations, status = self.y.copy(), self.residual.copy(), self.iterations.copy(), list(self.status)
        y[index], residual[index], iterations[index] = other.y, other.residual, other.iterations
        for n, t in enumerate(index):
            status[t] = other.status[n]
        return Equilibrium(y=y, status=tuple(status), residual=residual, iterations=iterations)

    def require_converged(self) -> "Equilibrium":
        """Itself, or raise NotConverged with its sentence."""
        if not self.converged:
            raise NotConverged(self)
        return self


def equilibrate(
    energy: Energy,
    start: np.ndarray,
    *,
    options: NewtonOptions | None = None,
    solver: Solver | None = None,
    progress: Callable[[int, np.ndarray], None] | None = None,
) -> Equilibrium:
    """Minimise the energy from `start` (T, N, 3) [m], all frames together, converged ones dropping out.

    Exact Hessian first; where conjugate gradients meet negative curvature the frame's step is redone with the
    projected one. The line search halves until min J stays above 0.05 min(1, its value before) and the energy falls
    (Armijo 1e-4). `progress(step, residual)` is called once per step. Deterministic: sums are gathered in fixed order.
    """
    options = options or NewtonOptions()
    solver = solver or LinearSolver.of(energy, options.linear)
    y = as_array("start", start, (None, energy.elastic.cloud.count, 3)).copy()
    y[:, energy.fixed] = energy.elastic.cloud.x[energy.fixed]
    state = _State.at(energy, y)
    status = [Status.ITERATIONS if ok else Status.INVERTED for ok in state.smallest > 0]
    steps = np.zeros(len(y), int)
    precondition, earlier = solver.begun(len(y)), np.arange(len(y))
    for step in range(options.iterations + 1):
        for t in np.flatnonzero(state.residual <= options.tolerance):
            status[t] = Status.CONVERGED
        active = np.array([t for t, s in enumerate(status) if s is Status.ITERATIONS], int)
        if progress is not None:
            progress(step, state.residual)
        if len(active) == 0 or step == options.iterations:
            break
        part = energy.frames(active)
        tangent = part.tangent(state.y[active])
        last = None if precondition is None else precondition.frames(np.searchsorted(earlier, active), tangent)
        precondition, earlier = solver.following(last, part, tangent, state.residual[active]), active
        direction, spent = _direction(part, state.frames(active), tangent, solver, precondition, options.tolerance)
        solver.spent(active, spent)
        stuck = _search(part, state, active, direction)
        steps[active] += 1
        for t in active[stuck]:
            status[t] = Status.LINE_SEARCH if state.residual[t] > 1e3 * options.tolerance else Status.CONVERGED
    return Equilibrium(y=state.y, status=tuple(status), residual=state.residual, iterations=steps)


@dataclass(eq=False)
class _State:
    """The running iterate of every frame; the only mutable thing here."""

    y: np.ndarray
    energy: np.ndarray
    smallest: np.ndarray
    gradient: np.ndarray
    scale: np.ndarray

    @classmethod
    def at(cls, energy: Energy, y: np.ndarray) -> "_State":
        value, smallest = energy.value(y)
        return cls(y, value, smallest, energy.gradient(y), energy.scale(y))

    @property
    def residual(self) -> np.ndarray:
        return np.sqrt((self.gradient**2).sum(axis=(1, 2))) / self.scale

    def frames(self, index: np.ndarray) -> "_State":
        arrays = (self.y, self.energy, self.smallest, self.gradient, self.scale)
        return _State(*(a[index] for a in arrays))

    def accept(self, index: np.ndarray, new: "_State") -> None:
        self.y[index], self.energy[index], self.smallest[index] = new.y, new.energy, new.smallest
        self.gradient[index] = new.gradient
        self.scale[index] = np.maximum(self.scale[index], new.scale)


def _direction(
    energy: Energy, state: _State, tangent: Tangent, solver: Solver, precondition: Preconditioner,
    tolerance: float,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """The Newton direction (T, N, 3), with the projected Hessian where the exact one is not positive definite, and how
    many steps of conjugate gradients the exact one took (T,). None is more exact than the tolerance asks for."""
    right, enough = -state.gradient, _ENOUGH * tolerance / state.residual
    forcing = np.clip(enough, np.clip(state.residual, 1e-4, 1e-3), _LOOSE)
    solve = _solve(energy, state.y, tangent, right, precondition, forcing, limit=solver.patience)
    late = np.flatnonzero(~(solve.converged | solve.curved))
    if len(late):  # what was kept may be of too different a state
        some = energy.frames(late)
        own = some.tangent(state.y[late])
        fresh = solver.renewed(precondition.frames(late, own), some, own)
        if fresh is not None:
            solve = solve.with_frames(late, _solve(some, state.y[late], own, right[late], fresh, forcing[late]))
    direction = solve.x
    bent = np.flatnonzero(solve.curved | ((direction * state.gradient).sum(axis=(1, 2)) >= 0))
    if len(bent):
        some, project = energy.frames(bent), np.ones(len(bent), bool)
        own = some.tangent(state.y[bent], project)
        fresh = solver.preconditioner(own)
        direction[bent] = _solve(some, state.y[bent], own, right[bent], fresh, forcing[bent], project=project).x
    return direction, solve.iterations


def _solve(
    energy: Energy, y: np.ndarray, tangent: Tangent, right: np.ndarray, precondition: Preconditioner,
    forcing: np.ndarray, *, limit: int = LIMIT, project: np.ndarray | None = None,
) -> Solve:  # fmt: skip
    """Conjugate gradients by the Hessian at y, which go on with fewer frames as others stop."""

    def part(frames: np.ndarray) -> tuple[Operator, Operator]:
        tangent = energy.frames(frames).tangent(y[frames], None if project is None else project[frames])
        return tangent.product, precondition.frames(frames, tangent)

    return conjugate_gradients(tangent.product, right, precondition, tolerance=forcing, limit=limit, part=part)


def _search(energy: Energy, state: _State, active: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Halve each frame's step until it is acceptable and take it; returns where none was, (A,) bool."""
    before = state.frames(active)
    slope = (before.gradient * direction).sum(axis=(1, 2))
    noise = 1e-15 * float(energy.elastic.m[:, 0] @ energy.elastic.cloud.volume)  # psi is rounded relative to mu
    size, waiting = np.ones(len(active)), np.ones(len(active), bool)
    for _ in range(30):
        index = np.flatnonzero(waiting)
        trial = _State.at(energy.frames(index), before.y[index] + size[index, None, None] * direction[index])
        old = before.frames(index)
        safe = trial.smallest > 0.05 * np.minimum(1.0, old.smallest)
        rounding = 1e-12 * np.abs(old.energy) + noise
        lower = trial.energy <= old.energy + 1e-4 * size[index] * slope[index]
        flat = (np.abs(trial.energy - old.energy) <= rounding) & (
            trial.residual * trial.scale < old.residual * old.scale
        )
        good = safe & (lower | flat)
        state.accept(active[index[good]], trial.frames(np.flatnonzero(good)))
        waiting[index[good]] = False
        size[waiting] /= 2
        if not waiting.any():
            break
    return waiting
