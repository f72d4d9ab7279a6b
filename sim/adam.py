"""The optimiser of the paper: Adam on log mu and log lam of every point (paper "Material Reconstruction")."""

from collections.abc import Callable

import numpy as np

from sim.adjoint import implicit_gradient, truncated_gradient
from sim.energy import Energy
from sim.lame import Lame
from sim.newton import NewtonOptions, equilibrate
from sim.solvers import LinearSolver
from sim.target import Target

_BETAS = (0.9, 0.999)


def fit_adam(
    energy: Energy,
    target: Target,
    start: np.ndarray,
    *,
    proceed: Callable[[float], bool],
    rate: float = 0.1,
    truncated: bool = False,
    newton: NewtonOptions | None = None,
) -> Lame:
    """The material when `proceed(loss)`, asked after every solve, says no: for comparison, see `sim.fit.fit`.

    Starts from the energy's own material and start (T, N, 3) [m]; every solve starts from the one before. There is no
    prior and no stopping rule but `proceed`: run long enough, it fits the noise. truncated: the paper's gradient, which
    leaves the derivative of the solve's own path out, instead of the exact one.
    """
    newton = newton or NewtonOptions(tolerance=1e-5)
    solver = LinearSolver.of(energy, newton.linear)
    a, y = np.log(energy.elastic.m), start
    first, second, step = np.zeros_like(a), np.zeros_like(a), 0
    while True:
        moved, before = energy.with_elastic(energy.elastic.with_parameters(np.exp(a))), y
        y = equilibrate(moved, before, options=newton, solver=solver).y
        loss, slope = target.loss(y)
        if not proceed(loss):
            return Lame(mu=np.exp(a[:, 0]), lam=np.exp(a[:, 1]))
        if truncated:
            by_parameter = truncated_gradient(moved, before, slope, options=newton)
        else:
            by_parameter = implicit_gradient(moved, y, slope, solver=solver, tolerance=1e-6)
        gradient, step = np.exp(a) * by_parameter, step + 1
        first = _BETAS[0] * first + (1 - _BETAS[0]) * gradient
        second = _BETAS[1] * second + (1 - _BETAS[1]) * gradient**2
        size = np.sqrt(second / (1 - _BETAS[1] ** step)) + 1e-300
        a = a - rate * first / (1 - _BETAS[0] ** step) / size
