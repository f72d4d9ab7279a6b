"""The equilibria of one set of unknowns, with whatever a cause makes follow from the motion itself."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from sim.direct import ROOM, DirectFactors, Layout
from sim.energy import Energy
from sim.newton import NewtonOptions, Status, equilibrate
from sim.sensitivity import Past
from sim.through_time import Settled, settle
from veo_ti.diagnosis.problem import Problem
from veo_ti.diagnosis.scene import Scene

_ROUNDS = 12  # of motion and what follows from it, such as damage
_STILL = 0.1  # of the noise, by which the motion may still change between them, root mean square
_NEAR = 0.3  # of that, for steps all frames at once
_DEPTH = 4  # rounds that are mixed
_FIRST, _CLOSE = 4, 5.0  # rounds at most before such steps, and times the change that ends all, that ends them
_ROUGHLY = NewtonOptions(tolerance=1e-3, iterations=8)  # of each of these
NEWTON = NewtonOptions(tolerance=1e-5, iterations=12)


@dataclass(frozen=True, kw_only=True, eq=False)
class Solved:
    """coefficients (K + E,) and theta (d,), and the motion that they lead to."""

    scene: Scene
    without: Scene  # the same motion, before the cause joined the energy
    coefficients: np.ndarray
    theta: np.ndarray
    found: bool  # whether every frame that trains is in equilibrium
    factors: DirectFactors | None = None  # that serve nearby


def solved(
    problem: Problem, scene: Scene, coefficients: np.ndarray, theta: np.ndarray, factors: DirectFactors | None = None,
    *, most: float = np.inf,
) -> Solved:  # fmt: skip
    """All frames in equilibrium that train, and the others where these depend on them, from the scene's motion on.

    What follows from the motion (viscous strain, damage, set) has to be that of the motion itself. Newton's steps
    through time find it, with the factors of a solve nearby; far from it after a few rounds of solves. Where there was
    no solve nearby and they fail, or so many factors have no room, rounds alone do; they are so slow that a step from a
    solve nearby had better be shorter. A motion on the way that costs over `most` is not followed to its end.
    """
    energy = problem.energy(coefficients)
    still = _STILL * (scene.target.sigma or np.sqrt(problem.model.s2))

    def hopeless(at: Scene) -> bool:
        return most < np.inf and problem.cost(at, coefficients, theta) > most

    nearby, reached, found = factors is not None, scene, False
    at_once = _remembers(problem) and scene.y[..., 0].size <= ROOM
    if at_once:
        reached, found, factors = _through_time(problem, scene, energy, theta, still, factors, hopeless)
    if not (found or (at_once and nearby)):
        reached, found = _in_rounds(problem, reached, energy, theta, still, hopeless)
    elif not found:
        reached = scene
    return Solved(
        scene=reached, without=reached.moved(energy, reached.y), coefficients=coefficients, theta=theta, found=found,
        factors=factors,
    )  # fmt: skip


def _through_time(
    problem: Problem, scene: Scene, energy: Energy, theta: np.ndarray, still: float, factors: DirectFactors | None,
    hopeless: Callable[[Scene], bool],
) -> tuple[Scene, bool, DirectFactors | None]:  # fmt: skip
    """All frames at once, as far as they come.

    Far from it, where a turn makes every step short, rounds come nearer at less cost.
    """
    cause, place = problem.cause, problem.place

    def remembered(y: np.ndarray) -> tuple[Energy, Callable[[], Sequence[Past]]]:
        at = scene.moved(energy, y)
        terms = (*problem.base.terms, *problem.change(at, theta).terms)
        return replace(energy, terms=terms), partial(cause.remembered, at, theta, place)

    layout = Layout.of(problem.base.elastic)

    def to_its_end(start: np.ndarray, **how: Any) -> Settled:
        found = settle(remembered, start, layout=layout, options=NEWTON, still=_NEAR * still, stalled=still, **how)
        problem.model.effort.spend(found.equilibrium.iterations.mean())
        return found

    settled = to_its_end(scene.y, factors=factors, patient=False)
    if not settled.equilibrium.converged:
        at = scene.moved(energy, settled.equilibrium.y)
        nearer, found = _in_rounds(
            problem, at, energy, theta, _CLOSE * still, hopeless, rounds=_FIRST, options=_ROUGHLY
        )
        if found and hopeless(nearer):
            return nearer, True, None
        settled = to_its_end(nearer.y if found else at.y)
    return scene.moved(settled.energy, settled.equilibrium.y), settled.equilibrium.converged, settled.factors


def _in_rounds(
    problem: Problem, scene: Scene, energy: Energy, theta: np.ndarray, still: float, hopeless: Callable[[Scene], bool],
    *, rounds: int = _ROUNDS, options: NewtonOptions = NEWTON,
) -> tuple[Scene, bool]:  # fmt: skip
    """What follows from the motion is taken from the last motion, until the next one is the same: a fixed point.

    By Anderson's mixing, since plain rounds close in as slowly as the history is strong. No more rounds where a frame
    that counts has no equilibrium, or where they are hopeless.
    """
    tried: list[np.ndarray] = []
    reached: list[np.ndarray] = []
    model, remembers, every = problem.model, _remembers(problem), problem.cause is not None and problem.cause.spans
    frames = np.arange(len(scene.y)) if every else np.flatnonzero(scene.train)
    solver = model.through_time if every else model.solver
    for more in reversed(range(rounds if remembers else 1)):
        scene = scene.of_material(energy.elastic)
        change = problem.change(scene, theta)
        extended = replace(energy, terms=(*problem.base.terms, *change.terms))
        there = equilibrate(extended.frames(frames), scene.y[frames], options=options, solver=solver)
        model.effort.spend(there.iterations.mean())
        y = scene.with_frames(frames, there.y)
        at, failed = scene.moved(extended, y), frames[[s is not Status.CONVERGED for s in there.status]]
        tried, reached = [*tried, scene.y][-_DEPTH:], [*reached, y][-_DEPTH:]
        settled, found = np.sqrt(((y - scene.y) ** 2).mean()) < still, not scene.train[failed].any()
        if not more or settled or not found or hopeless(at):
            break
        mixed = at.moved(extended, _mixed(tried, reached))
        scene = mixed if np.linalg.det(mixed.F).min() > 0 else at
    return at, found


def _remembers(problem: Problem) -> bool:
    return problem.cause is not None and problem.cause.follows


def _mixed(tried: Sequence[np.ndarray], reached: Sequence[np.ndarray]) -> np.ndarray:
    """Where to look next for y = g(y), from arguments and values so far (Anderson 1965; Walker & Ni 2011)."""
    if len(tried) == 1:
        return reached[-1]
    left = [(g - y).ravel() for y, g in zip(tried, reached, strict=True)]
    steps = np.stack([left[-1] - f for f in left[:-1]], axis=1)
    gamma = np.linalg.lstsq(steps, left[-1], rcond=None)[0]
    return reached[-1] - sum(c * (reached[-1] - g) for c, g in zip(gamma, reached[:-1], strict=True))
