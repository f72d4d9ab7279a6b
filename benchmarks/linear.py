"""One Newton step's linear systems: all frames together to 1e-3, beside one direct solve a frame."""

import numpy as np

from benchmarks import scene
from benchmarks.direct import Cholmod, best_direct
from benchmarks.table import Row, skipped
from benchmarks.timing import interleaved, ratio
from sim.linear import conjugate_gradients
from sim.newton import LinearSolver

_FEW = {"CHOLMOD": 2, "SuperLU": 1}  # frames that the peers solve
_GOALS = {"CHOLMOD": 2.0, "SuperLU": 15.0}


def linear_rows(points: int, frames: int, rounds: int) -> list[Row]:
    """One row a direct peer; assembling counts on every side, the analysis of the pattern on none."""
    energy = scene.bar(points, frames)
    y = scene.twisted(energy, frames)
    tangent, right, solver = energy.tangent(y), -energy.gradient(y), LinearSolver.of(energy, "two-level")
    peers = dict([best_direct(energy), ("SuperLU", LinearSolver.of(energy, "direct"))])

    def ours() -> None:
        precondition = solver.preconditioner(tangent)
        assert conjugate_gradients(tangent.product, right, precondition, tolerance=1e-3).converged.all()

    def one_by_one(peer: Cholmod | LinearSolver, count: int) -> None:
        for t in range(count):
            part, b = energy.frames(np.array([t])).tangent(y[t : t + 1]), right[t : t + 1]
            x = peer.preconditioner(part)(b)
            assert np.linalg.norm(part.product(x) - b) <= 1e-8 * np.linalg.norm(b)

    jobs = {name: lambda name=name: one_by_one(peers[name], _FEW[name]) for name in peers}
    seconds = interleaved({"ours": ours, **jobs}, rounds, warm=0)
    own = seconds["ours"] / frames
    size = f"Linear solve to 1e-3, {len(right[0])} points x {frames} frames"
    return [_row(f"{size}: {name} over ours", name, goal, seconds.get(name), own) for name, goal in _GOALS.items()]


def _row(what: str, name: str, goal: float, seconds: np.ndarray | None, own: np.ndarray) -> Row:
    target, few = f">= {goal:g} x", _FEW[name]
    if seconds is None:
        return skipped(what, "cvxopt is not installed", target)
    gain = ratio(seconds / few, own)
    figure = f"{gain:.1f} x ({np.median(seconds) / few:.2f} s a frame, {few} of them, over {np.median(own):.2f} s)"
    return Row(what=what, figure=figure, target=target, reached=gain >= goal)
