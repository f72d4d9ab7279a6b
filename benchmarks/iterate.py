"""One iterate of an optimiser, a warm solve and the adjoint, beside cold solves: ours, and exact Newton by frames."""

from dataclasses import dataclass

import numpy as np

from benchmarks import scene
from benchmarks.direct import best_direct
from benchmarks.table import Row
from benchmarks.timing import interleaved
from sim.adjoint import gradient_check, implicit_gradient
from sim.newton import Equilibrium, NewtonOptions, equilibrate
from sim.solvers import KeptSolver, LinearSolver

_CHANGE = 0.05  # standard deviation of the change of log mu and log lam at every point: a late step of a fit
_LOOSE = NewtonOptions(tolerance=1e-5)  # what the fit asks for
_FEW = 2  # frames that the peer solves


@dataclass(frozen=True, kw_only=True)
class _Measured:
    """Seconds a frame and Newton steps of every job, under its name."""

    size: str
    peer: str
    seconds: dict[str, float]
    steps: dict[str, int]

    def times(self, what: str, job: str, goal: float | None = None) -> Row:
        """The peer over one of our jobs."""
        peer, ours = self.seconds["exact"], self.seconds[job]
        figure = (
            f"{peer / ours:.1f} x ({peer:.2f} s a frame, {_FEW} of them, over {ours:.2f} s in {self.steps[job]} steps)"
        )
        target, reached = (f">= {goal:g} x", peer / ours >= goal) if goal else ("", None)
        return Row(what=f"{what}, {self.size}: {self.peer}, over ours", figure=figure, target=target, reached=reached)

    def share(self, of: str, job: str, goal: float | None = None) -> Row:
        """The adjoint as a share of a solve."""
        part = self.seconds["adjoint"] / self.seconds[job]
        figure = f"{part:.1%} ({self.seconds['adjoint']:.2f} s a frame of {self.seconds[job]:.2f} s)"
        target, reached = (f"<= {goal:.0%}", part <= goal) if goal else ("", None)
        return Row(what=f"Adjoint, {self.size}: share of {of}", figure=figure, target=target, reached=reached)


def iterate_rows(points: int, frames: int) -> list[Row]:
    """Cold, warm and adjoint of all frames together; the peer, to which the targets refer, takes a few in turn."""
    found = _measure(points, frames)
    changed = f"material changed by {_CHANGE:.0%}"
    return [
        found.times("Cold solve to 1e-8", "cold"),
        found.times(f"Warm solve to 1e-8, {changed}", "warm", 10),
        found.times(f"Warm solve to {_LOOSE.tolerance:g}, as the fit asks, {changed}", "loose"),
        found.times("The same with factors kept from the solves before", "kept"),
        found.share(found.peer, "exact", 0.1),
        found.share("our own cold solve", "cold"),
    ]


def _measure(points: int, frames: int) -> _Measured:
    energy = scene.bar(points, frames)
    rest, solver = scene.at_rest(energy, frames), LinearSolver.of(energy, "two-level")
    name, direct = best_direct(energy)
    m = energy.elastic.m * np.exp(_CHANGE * np.random.default_rng(0).standard_normal((len(rest[0]), 2)))
    changed = energy.with_elastic(energy.elastic.with_parameters(m))
    found: dict[str, Equilibrium] = {}
    keeper, before = KeptSolver.of(energy, frames), rest
    for material in (energy, changed, energy):  # solves that follow one another
        before = equilibrate(material, before, options=_LOOSE, solver=keeper).require_converged().y

    def exact() -> None:
        for t in np.linspace(0, frames - 1, _FEW).astype(int):
            equilibrate(energy.frames(np.array([t])), rest[:1], solver=direct).require_converged()

    def cold() -> None:
        found["cold"] = equilibrate(energy, rest, solver=solver).require_converged()

    def warm() -> None:
        found["warm"] = equilibrate(changed, found["cold"].y, solver=solver).require_converged()

    def loose() -> None:
        found["loose"] = equilibrate(changed, found["cold"].y, options=_LOOSE, solver=solver).require_converged()

    def kept() -> None:
        found["kept"] = equilibrate(changed, before, options=_LOOSE, solver=keeper).require_converged()

    def adjoint() -> None:
        y = found["cold"].y
        implicit_gradient(energy, y, 2 * (y - rest), solver=solver)

    jobs = {"exact": exact, "cold": cold, "warm": warm, "loose": loose, "kept": kept, "adjoint": adjoint}
    seconds = {job: s[0] / (_FEW if job == "exact" else frames) for job, s in interleaved(jobs, 1, warm=0).items()}
    return _Measured(
        size=f"{len(rest[0])} points x {frames} frames",
        peer=f"exact Newton with {name} from rest to 1e-8, a frame at a time",
        seconds=seconds,
        steps={job: int(equilibrium.iterations.max()) for job, equilibrium in found.items()},
    )


def check_rows(points: int, frames: int) -> list[Row]:
    """The adjoint against finite differences, at the equilibrium of a bar."""
    energy = scene.bar(points, frames)
    rest = scene.at_rest(energy, frames)

    def loss(y: np.ndarray) -> tuple[float, np.ndarray]:
        return float(((y - rest) ** 2).sum()), 2 * (y - rest)

    error = gradient_check(energy, equilibrate(energy, rest).require_converged().y, loss)
    what = f"Adjoint, {len(rest[0])} points x {frames} frames: relative error against finite differences"
    return [Row(what=what, figure=f"{error:.1e}", target="<= 1e-6", reached=error <= 1e-6)]
