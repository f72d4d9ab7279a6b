"""Batched Newton: the equilibrium of every frame at once (paper "Quasistatic Simulation")."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Literal

import numpy as np

from sim.checks import as_array, require
from sim.energy import Energy, Tangent
from sim.linear import ROOM, DirectFactors, Layout, Preconditioner, conjugate_gradients
from sim.twolevel import Aggregates, TwoLevel

_NEAR = 0.3  # of the load: residual below which a two-level preconditioner follows the state
_CLOSE = 0.03  # below which a frame's last factors serve again; farther out they may hide that it has since buckled
_SMALL = 800  # points, up to which one sparse factor a frame takes no longer than the two-level preconditioner


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


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearSolver:
    """Makes preconditioners for tangents of one cloud; what depends on the rest state only is kept."""

    layout: Layout
    aggregates: Aggregates
    direct: float  # points of all frames together, up to which they are factorised
    kept: Preconditioner | None = None  # of one state, for all others

    @classmethod
    def of(cls, energy: Energy, linear: str = "auto") -> "LinearSolver":
        """ "auto" factorises small clouds and takes the two-level preconditioner for the others."""
        cloud, pattern = energy.elastic.cloud, energy.elastic.pattern
        direct = {"direct": np.inf, "auto": ROOM if cloud.count <= _SMALL else 0, "two-level": 0}[linear]
        aggregates = Aggregates.of(cloud, pattern, energy.fixed)
        return cls(layout=Layout.of(energy.elastic), aggregates=aggregates, direct=direct)

    def preconditioner(self, tangent: Tangent) -> Preconditioner:
        """A fresh preconditioner at the tangent's own state, unless one is kept."""
        if self.kept is not None:
            return self.kept
        few = tangent.y[..., 0].size <= self.direct
        return DirectFactors.of(tangent, self.layout) if few else TwoLevel.of(tangent, self.aggregates)

    def following(
        self, last: Preconditioner | None, energy: Energy, tangent: Tangent, residual: np.ndarray
    ) -> Preconditioner:
        """Of the next step, at residuals (T,): the last one, as far as its frames are near their solution."""
        if isinstance(last, TwoLevel) and residual.max() < _NEAR:
            return last.moved(tangent)
        if not isinstance(last, DirectFactors) or self.kept is not None:
            return self.preconditioner(tangent)
        stale = np.flatnonzero((residual >= _CLOSE) | ~last.positive)
        if len(stale) == 0:
            return last
        some = tangent if len(stale) == len(residual) else energy.frames(stale).tangent(tangent.y[stale])
        return last.renewed(stale, DirectFactors.of(some, self.layout))

    def near(self, tangent: Tangent) -> "LinearSolver":
        """The same with the preconditioner of this state kept: for a single frame's solves that stay near it."""
        return replace(self, kept=self.preconditioner(tangent))


def equilibrate(
    energy: Energy,
    start: np.ndarray,
    *,
    options: NewtonOptions | None = None,
    solver: LinearSolver | None = None,
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
    precondition, earlier = None, np.zeros(0, int)
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
        last = None if precondition is None else precondition.frames(np.searchsorted(earlier, active))
        precondition, earlier = solver.following(last, part, tangent, state.residual[active]), active
        direction = _direction(part, state.frames(active), tangent, solver, precondition)
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
    energy: Energy, state: _State, tangent: Tangent, solver: LinearSolver, precondition: Preconditioner
) -> np.ndarray:
    """The Newton direction (T, N, 3), with the projected Hessian where the exact one is not positive definite."""
    forcing = np.clip(state.residual, 1e-4, 1e-3)
    solve = conjugate_gradients(tangent.product, -state.gradient, precondition, tolerance=forcing)
    direction = solve.x
    bent = np.flatnonzero(solve.curved | ((direction * state.gradient).sum(axis=(1, 2)) >= 0))
    if len(bent):
        some, project = energy.frames(bent), np.ones(len(bent), bool)
        tangent = some.tangent(state.y[bent], project)
        right = -state.gradient[bent]
        again = conjugate_gradients(
            tangent.product, right, solver.preconditioner(tangent), tolerance=forcing[bent], limit=400
        )
        direction[bent] = again.x
    return direction


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
