"""Loads that grow slowly: the equilibria of a path, each found from the one before."""

import numpy as np

from sim.energy import Energy
from sim.newton import Equilibrium, NewtonOptions, equilibrate
from sim.solvers import LinearSolver


def equilibrate_gradually(
    energy: Energy, start: np.ndarray, count: int, *, options: NewtonOptions | None = None
) -> Equilibrium:
    """As `equilibrate` for `count` frames, where each begins at the pose that the one before ended in.

    start (N, 3) [m]: where the first begins. Of several equilibria, as there are where a body buckles or is pushed
    aside, these are the ones that a slow motion leads to; it also gets there in fewer steps than from far away.
    A frame that found none is where the next one begins all the same, and its status says so.
    """
    options = options or NewtonOptions()
    solver, y, found = LinearSolver.of(energy, options.linear), start[None], []
    for t in range(count):
        found.append(equilibrate(energy.frames(np.array([t])), y, options=options, solver=solver))
        y = found[-1].y
    return Equilibrium(
        y=np.concatenate([e.y for e in found]), status=tuple(e.status[0] for e in found),
        residual=np.concatenate([e.residual for e in found]), iterations=np.concatenate([e.iterations for e in found]),
    )  # fmt: skip
