"""The optimiser of the paper: Adam on log mu and log lam of every point, with the implicit adjoint's gradient."""

from collections.abc import Callable

import numpy as np

from sim.adjoint import implicit_gradient
from sim.energy import Energy
from sim.fit import Target
from sim.newton import LinearSolver, NewtonOptions, equilibrate

_BETAS = (0.9, 0.999)


def adam(
    energy: Energy,
    target: Target,
    start: np.ndarray,
    *,
    rate: float,
    newton: NewtonOptions,
    proceed: Callable[[float], bool],
) -> np.ndarray:
    """The log parameters (N, 2) when `proceed(loss)`, asked after every solve, says no.

    Starts from the energy's own material and start (T, N, 3) [m]; every solve starts from the one before.
    """
    solver = LinearSolver.of(energy, newton.linear)
    a, y = np.log(energy.elastic.m), start
    first, second, step = np.zeros_like(a), np.zeros_like(a), 0
    while True:
        moved = energy.with_elastic(energy.elastic.with_parameters(np.exp(a)))
        y = equilibrate(moved, y, options=newton, solver=solver).y
        loss, slope = target.loss(y)
        if not proceed(loss):
            return a
        gradient = np.exp(a) * implicit_gradient(moved, y, slope, solver=solver, tolerance=1e-6)
        step += 1
        first = _BETAS[0] * first + (1 - _BETAS[0]) * gradient
        second = _BETAS[1] * second + (1 - _BETAS[1]) * gradient**2
        size = np.sqrt(second / (1 - _BETAS[1] ** step)) + 1e-300
        a = a - rate * first / (1 - _BETAS[0] ** step) / size
