"""Gradients of a loss on the equilibrium in the material: the implicit adjoint, and the paper's truncated sum."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sim.energy import Energy
from sim.linear import conjugate_gradients
from sim.newton import NewtonOptions, equilibrate
from sim.solvers import LinearSolver, Solver

Loss = Callable[[np.ndarray], tuple[float, np.ndarray]]  # y (T, N, 3) -> value and derivative (T, N, 3)


def implicit_gradient(
    energy: Energy, y: np.ndarray, slope: np.ndarray, *, solver: Solver | None = None, tolerance: float = 1e-8
) -> np.ndarray:
    """dL/dm (N, P) at the equilibrium y for a loss with dL/dy = slope (T, N, 3).

    `w = -H^-1 dL/dy`, `dL/dm_i = w . d(dE/dy)/dm_i`, with the exact Hessian: the projected one of Newton's fallback
    gives a wrong direction.
    """
    solver = solver or LinearSolver.of(energy)
    tangent = energy.tangent(y)
    right = energy.free(-np.array(slope))
    w = conjugate_gradients(tangent.product, right, solver.preconditioner(tangent), tolerance=tolerance).x
    return energy.elastic.parameter_gradient(y, w)


def truncated_gradient(
    energy: Energy, start: np.ndarray, slope: np.ndarray, *, options: NewtonOptions | None = None
) -> np.ndarray:
    """The paper's approximation (Eq. devLoss and following) for a Newton solve from `start`, (N, P).

    It sums `-dH_k^-1/dm gradE_k - H_k^-1 dgradE_k/dm` over the Newton steps k and neglects how step k depends on step
    k - 1, which is the part that would cancel the growth: the sum is several times too long. For comparison only.
    """
    options = options or NewtonOptions()
    solver = LinearSolver.of(energy, options.linear)
    one_step = replace(options, iterations=1)
    y, total = start.copy(), np.zeros_like(energy.elastic.m)
    right = energy.free(-np.array(slope))
    for _ in range(options.iterations):
        gradient = energy.gradient(y)
        if (np.sqrt((gradient**2).sum(axis=(1, 2))) <= options.tolerance * energy.load(y)).all():
            break
        tangent = energy.tangent(y)
        precondition = solver.preconditioner(tangent)
        w = conjugate_gradients(tangent.product, right, precondition, tolerance=1e-8).x
        d = conjugate_gradients(tangent.product, -gradient, precondition, tolerance=1e-8).x
        total += energy.elastic.parameter_gradient(y, w) + _hessian_part(energy, y, w, d)
        y = equilibrate(energy, y, options=one_step, solver=solver).y
    return total


def _hessian_part(energy: Energy, y: np.ndarray, w: np.ndarray, d: np.ndarray) -> np.ndarray:
    """w . dH/dm d, (N, P): the derivative of the parameter gradient along d, by central differences."""
    h = 1e-5 * energy.elastic.cloud.spacing / max(float(np.abs(d).max()), 1e-300)
    ahead, behind = (energy.elastic.parameter_gradient(y + s * h * d, w) for s in (1, -1))
    return (ahead - behind) / (2 * h)


def gradient_check(
    energy: Energy, y: np.ndarray, loss: Loss, *, seed: int = 0, step: float = 2e-3, solver: Solver | None = None
) -> float:
    """Relative error of the adjoint against fourth-order central differences of the loss, along a random one of log m.

    Solves the equilibrium four times more, to 1e-10.
    """
    m = energy.elastic.m
    direction = np.random.default_rng(seed).standard_normal(m.shape)
    solver = solver or LinearSolver.of(energy)
    tight = NewtonOptions(tolerance=1e-10)

    def value(h: float) -> float:
        moved = energy.with_elastic(energy.elastic.with_parameters(m * np.exp(h * direction)))
        return loss(equilibrate(moved, y, options=tight, solver=solver).y)[0]

    y = equilibrate(energy, y, options=tight, solver=solver).y
    adjoint = float((implicit_gradient(energy, y, loss(y)[1], solver=solver) * m * direction).sum())
    near, far = (value(h) - value(-h) for h in (step, 2 * step))
    difference = (8 * near - far) / (12 * step)
    return abs(adjoint - difference) / max(abs(difference), 1e-300)
