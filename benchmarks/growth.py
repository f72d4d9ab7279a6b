"""How cost and iterations grow with the number of points and with the contrast of stiffness."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks import scene
from benchmarks.table import Row
from benchmarks.timing import interleaved, milliseconds
from sim.energy import Tangent
from sim.linear import Preconditioner, Solve, conjugate_gradients
from sim.solvers import LinearSolver

_FRAMES = 2  # solved together; with them the cloud of 50,000 points stays below 2 GB


@dataclass(frozen=True, kw_only=True)
class _System:
    """A Newton step's linear system and how it is solved."""

    tangent: Tangent
    right: np.ndarray
    solver: LinearSolver

    @classmethod
    def of(cls, points: int, contrast: float) -> "_System":
        energy = scene.bar(points, _FRAMES, contrast)
        y = scene.twisted(energy, _FRAMES)
        solver = LinearSolver.of(energy, "two-level")
        return cls(tangent=energy.tangent(y), right=-energy.gradient(y), solver=solver)

    def solve(self, precondition: Preconditioner, tolerance: float) -> Solve:
        return conjugate_gradients(self.tangent.product, self.right, precondition, tolerance=tolerance)


def growth_rows(sizes: Sequence[int], contrasts: Sequence[float], rounds: int) -> list[Row]:
    """A row of costs for each size at the first contrast, then a row of iterations for each contrast."""
    costs, counts = [], {contrast: [] for contrast in contrasts}
    for points in sizes:
        for contrast in contrasts:
            system = _System.of(points, contrast)
            precondition = system.solver.preconditioner(system.tangent)
            if contrast == contrasts[0]:
                costs.append(_cost_row(system, precondition, rounds))
            solve = system.solve(precondition, 1e-8)
            assert solve.converged.all()
            counts[contrast].append((points, int(solve.iterations.max())))
        scene.cloud.cache_clear()
    return costs + [_iterations_row(contrast, found) for contrast, found in counts.items()]


def _cost_row(system: _System, precondition: Preconditioner, rounds: int) -> Row:
    jobs = {
        "product": lambda: system.tangent.product(system.right),
        "build": lambda: system.solver.preconditioner(system.tangent),
        "solve": lambda: system.solve(precondition, 1e-3),
    }
    product, build, solve = (milliseconds(s / _FRAMES) for s in interleaved(jobs, rounds, warm=0).values())
    what = f"Cost of a frame at {len(system.right[0])} points: Hessian product + preconditioner + solve to 1e-3"
    return Row(what=what, figure=f"{product} + {build} + {solve}")


def _iterations_row(contrast: float, counts: list[tuple[int, int]]) -> Row:
    figure = ", ".join(f"{iterations} at {points / 1000:g}k" for points, iterations in counts)
    what = f"Iterations to 1e-8, stiffness contrast {contrast:g}"
    return Row(what=what, figure=figure, target="<= 80", reached=max(i for _, i in counts) <= 80)
