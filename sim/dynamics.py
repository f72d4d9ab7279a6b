"""Motion under inertia and damping: `M y'' + C y' + dE/dy = 0`, every implicit stage a minimisation by Newton.

The integrator is TR-BDF2 (Bank et al. 1985; Hosea and Shampine 1996): a trapezoidal stage over gamma = 2 - sqrt 2 of
the step h, then a BDF2 stage over all of it, both implicit over c = gamma h / 2. It is second order, one-step (any
start, any load, any change of step) and L-stable: stiff contacts cannot ring. A linear mode w never gains energy; a
step takes 3.7e-3 (w h)^4 of its amplitude and the share 0.04 (w h)^2 of its frequency: 0.04 % a period and 0.25 % at
25 steps a period. BDF2 with as many solves takes eight times the amplitude; generalised-alpha lets the energy wobble.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from sim.checks import as_array, require
from sim.energy import Energy
from sim.newton import NewtonOptions, Status, equilibrate
from sim.solvers import KeptSolver, Solver
from sim.terms.handles import Handles
from sim.terms.viscosity import Viscosity, turned_stiffness

_GAMMA = 2 - math.sqrt(2)
_SLOPE = math.sqrt(2) / 4  # weight of the first two slopes in the step; gamma / 2 is that of the third
_DEFECT = ((4 * _SLOPE - 1) / 3, -1 / 3, _GAMMA / 3)  # the weights less those of the third-order companion
_FINEST = 64  # times that the steps asked for may multiply


@dataclass(frozen=True, kw_only=True)
class Damping:
    """Rayleigh damping `C = a M + b K`, a mode of frequency w [rad/s] having the damping ratio a / (2 w) + b w / 2.

    K is the elastic stiffness at rest, turned with every point (`turned_stiffness`). With a constant K a nearly
    incompressible body that bends by a few degrees would already creep instead of swinging.
    """

    mass: float = 0.0  # a [1/s]
    stiffness: float = 0.0  # b [s]

    def __post_init__(self) -> None:
        for name, value in (("mass", self.mass), ("stiffness", self.stiffness)):
            require(0 <= value < math.inf, f"damping by {name}", "be finite and not negative", value)


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A trajectory at the frames' times; from a frame that was not reached on it stands still."""

    time: np.ndarray  # (T,) [s]
    y: np.ndarray  # (T, N, 3) [m]
    velocity: np.ndarray  # (T, N, 3) [m/s]
    status: tuple[Status, ...]
    kinetic: np.ndarray  # (T,) [J]
    total: np.ndarray  # (T,) [J] kinetic plus the frame's own energy
    substeps: np.ndarray  # (T,) int, steps since the frame before
    error: np.ndarray  # (T,) [m] estimated largest error of a position made since the frame before

    @property
    def converged(self) -> bool:
        """Whether every frame was reached."""
        return all(s is Status.CONVERGED for s in self.status)

    @property
    def sentence(self) -> str:
        """What happened, naming the frame that was not reached."""
        if self.converged:
            return f"all {len(self.time)} frames were reached in {self.substeps.sum()} steps"
        first = next(t for t, s in enumerate(self.status) if s is not Status.CONVERGED)
        return (
            f"frame {first} of {len(self.time)} (t = {self.time[first]:.4g} s) was not reached: the solve of one of "
            f"{self.substeps[first]} steps {self.status[first].value}"
        )


def simulate(
    energy: Energy,
    *,
    time: np.ndarray,
    mass: np.ndarray,
    added_mass: np.ndarray | None = None,
    start: np.ndarray | None = None,
    velocity: np.ndarray | None = None,
    substeps: int | Literal["auto"] = 1,
    accuracy: float | None = None,
    damping: Damping | None = None,
    options: NewtonOptions | None = None,
) -> Motion:
    """Integrate `(M + M_added) y'' + C y' + dE/dy = 0` over the energy's frames at time (T,) [s].

    Applied forces and handles are interpolated between frames, other terms are those of the later one. mass and
    added_mass (N,) [kg] are lumped (density times `RestCloud.volume`) and have no weight: gravity is a load. start
    (N, 3) [m] and velocity (N, 3) [m/s] at time[0]: by default the rest pose, standing still. substeps: steps from
    frame to frame, twice as many where Newton fails; "auto" takes as many as keep the estimated error that each frame
    adds below accuracy [m], by default a thousandth of the mean spacing. Deterministic to the bit.
    Raises ValueError for times that do not increase, masses that are not positive, and shapes that do not fit.
    """
    time = as_array("time", time, (None,))
    require(len(time) > 0 and bool((np.diff(time) > 0).all()), "time", "increase from frame to frame", time.tolist())
    auto = substeps == "auto"
    number = auto or (isinstance(substeps, (int, np.integer)) and substeps > 0)
    require(number, "substeps", "be a positive whole number or 'auto'", repr(substeps))
    require(accuracy is None or accuracy > 0, "accuracy", "be positive", accuracy)
    steps, allowed = (1, accuracy or 1e-3 * energy.elastic.cloud.spacing) if auto else (int(substeps), math.inf)
    body = _Body(
        energy=energy, mass=_masses(energy.elastic.cloud.count, mass, added_mass), damping=damping or Damping(),
        options=options or NewtonOptions(), allowed=allowed, finest=_FINEST * steps,
    )  # fmt: skip
    states = [body.start(start, velocity)]
    _require_frames(energy, states[0].y, len(time))
    for frame, span in enumerate(np.diff(time)):
        steps = body.advised(states[-1]) if auto and frame else steps
        states.append(body.cross(frame, float(span), steps, states[-1]))
    return body.motion(time, states)


def _masses(count: int, mass: np.ndarray, added: np.ndarray | None) -> np.ndarray:
    """Lumped masses (N, 1) [kg]."""
    mass = as_array("mass", mass, (count,))
    require(bool((mass > 0).all()), "mass", "be positive at every point", mass.min())
    added = np.zeros(count) if added is None else as_array("added_mass", added, (count,))
    require(bool((added >= 0).all()), "added_mass", "not be negative", added.min())
    return (mass + added)[:, None]


def _require_frames(energy: Energy, y: np.ndarray, frames: int) -> None:
    try:
        energy.load(np.repeat(y, frames, axis=0))
    except ValueError:  # arrays of other lengths do not broadcast
        require(False, "time", "have one entry for each frame of the energy's terms", frames)


@dataclass(frozen=True, kw_only=True, eq=False)
class _State:
    """Position, velocity and acceleration, (1, N, 3) each, and how they were reached."""

    y: np.ndarray
    v: np.ndarray
    a: np.ndarray
    status: Status = Status.CONVERGED
    steps: int = 0
    error: float = 0.0  # [m]


@dataclass(frozen=True, kw_only=True, eq=False)
class _StageEnergy(Energy):
    """The energy of a stage, whose residual is relative to every term's own size: inertia and loads nearly cancel."""

    floor: float  # [N] rounding of the positions, over the tolerance

    def load(self, y: np.ndarray) -> np.ndarray:
        """Sum of the terms' sizes, (1,) [N]."""
        forces = (self.free(np.array(term.gradient(y))) for term in self.terms)
        return self.floor + sum(np.sqrt((f**2).sum(axis=(1, 2))) for f in forces)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Body:
    """What stays the same over a motion."""

    energy: Energy
    mass: np.ndarray  # (N, 1) [kg]
    damping: Damping
    options: NewtonOptions
    allowed: float  # [m]
    finest: int

    def start(self, y: np.ndarray | None, v: np.ndarray | None) -> _State:
        """The start state, checked, with its acceleration under the first frame's loads."""
        first, x = self.energy.frames(np.array([0])), self.energy.elastic.cloud.x
        y = np.where(self.energy.fixed[:, None], x, x if y is None else as_array("start", y, x.shape))[None]
        v = self.energy.free(np.zeros_like(y) if v is None else as_array("velocity", v, x.shape)[None].copy())
        smallest = float(self.energy.elastic.value(y)[1][0])
        require(smallest > 0, "start", "be nowhere inside out (J > 0)", f"J = {smallest:.3g}")
        drag = self.damping.mass * self.mass * v
        drag += turned_stiffness(self.energy.elastic, y, self.damping.stiffness).product(v)
        return _State(y=y, v=v, a=self.energy.free(-(first.gradient(y) + drag) / self.mass))

    def cross(self, frame: int, span: float, steps: int, state: _State) -> _State:
        """From a frame to the next, with more steps where Newton fails or the error is larger than allowed."""
        if state.status is not Status.CONVERGED:
            return state
        while True:
            end = self._attempt(frame, span, steps, state)
            reached = end.status is Status.CONVERGED
            if (reached and end.error <= self.allowed) or steps >= self.finest:
                return end if reached else replace(end, y=state.y, v=np.zeros_like(state.v), error=0.0)
            steps = min(self.finest, max(steps + 1, self.advised(end)) if reached else 2 * steps)

    def advised(self, state: _State) -> int:
        """The number of steps whose error would just be allowed: the error falls with its square."""
        return max(1, min(self.finest, math.ceil(1.1 * state.steps * math.sqrt(state.error / self.allowed))))

    def motion(self, time: np.ndarray, states: Sequence[_State]) -> Motion:
        """The states of the frames with their energies."""
        y, v = (np.concatenate([getattr(s, name) for s in states]) for name in ("y", "v"))
        kinetic = 0.5 * (self.mass * v**2).sum(axis=(1, 2))
        return Motion(
            time=time, y=y, velocity=v, status=tuple(s.status for s in states), kinetic=kinetic,
            total=kinetic + self.energy.value(y)[0], substeps=np.array([s.steps for s in states]),
            error=np.array([s.error for s in states]),
        )  # fmt: skip

    def _attempt(self, frame: int, span: float, steps: int, state: _State) -> _State:
        """`steps` equal steps, up to the first that fails."""
        error = 0.0
        for step in range(steps):
            mid, end = (self.energy.between(frame, (step + share) / steps) for share in (_GAMMA, 1))
            state = self._step(mid, end, span / steps, state)
            error += state.error
            if state.status is not Status.CONVERGED:
                break
        return replace(state, steps=steps, error=error)

    def _step(self, mid: Energy, end: Energy, h: float, state: _State) -> _State:
        """One TR-BDF2 step: slopes (v, a) at the start and at the ends of both stages."""
        c, w = _GAMMA * h / 2, _SLOPE * h
        first = self._stage(mid, c, replace(state, y=state.y + c * state.v, v=state.v + c * state.a), state.y)
        if first.status is not Status.CONVERGED:
            return first
        base = replace(first, y=state.y + w * (state.v + first.v), v=state.v + w * (state.a + first.a))
        last = self._stage(end, c, base, first.y)
        defect = sum(weight * s.v for weight, s in zip(_DEFECT, (state, first, last), strict=True))
        return replace(last, error=h * float(np.linalg.norm(defect, axis=2).max()))

    def _stage(self, energy: Energy, c: float, base: _State, near: np.ndarray) -> _State:
        """Solve y = base.y + c v, v = base.v + c a, M a = -dE/dy - C v, from the guess a = base.a or else from `near`.

        With y alone unknown it is the minimum of `E + (1 + a c)/(2 c^2) |y - base.y - c base.v / (1 + a c)|_M^2
        + b/(2 c) |y - base.y|_K^2` with a, b of the damping: inertia holds every point like a handle.
        """
        guess, drag = base.y + c * base.v + c**2 * base.a, 1 + self.damping.mass * c
        alpha, targets = drag / (2 * c**2) * self.mass[:, 0], base.y + c / drag * base.v
        terms = [*energy.terms, Handles(points=np.arange(len(alpha)), targets=targets, alpha=alpha)]
        if self.damping.stiffness > 0:
            K = turned_stiffness(energy.elastic, guess, self.damping.stiffness / c)
            terms.append(Viscosity(K=K, origin=base.y))
        floor = 4 * np.finfo(float).eps * np.linalg.norm(2 * alpha[:, None] * near) / self.options.tolerance
        problem = _StageEnergy(elastic=energy.elastic, terms=tuple(terms), fixed=energy.fixed, floor=float(floor))
        for start in (guess, near):
            found = equilibrate(problem, start, options=self.options, solver=self._solver)
            if found.converged:
                break
        v = (found.y - base.y) / c
        return _State(y=found.y, v=v, a=(v - base.v) / c, status=found.status[0])

    @cached_property
    def _solver(self) -> Solver:
        return KeptSolver.of(self.energy, 1, self.options.linear)
