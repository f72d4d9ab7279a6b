"""Linear solves with the Hessian, all frames at once: conjugate gradients with a choice of preconditioner."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sim.energy import Tangent

LIMIT = 400  # steps of conjugate gradients, unless told otherwise


class Preconditioner(Protocol):
    """An approximate inverse of a tangent, symmetric and positive definite in every frame."""

    @property
    def positive(self) -> np.ndarray:
        """The frames (T,) where it is that: one made at a state that is not stable may be indefinite."""

    def __call__(self, r: np.ndarray) -> np.ndarray:
        """z ~ H^-1 r, (T, N, 3)."""

    def frames(self, index: np.ndarray, tangent: Tangent) -> "Preconditioner":
        """The preconditioner of the chosen frames, which may go on at another tangent of theirs."""


@dataclass(frozen=True, kw_only=True)
class Solve:
    """A batched solve: x (T, N, 3), iterations, converged and curved (a direction with p.Hp <= 0), (T,) each."""

    x: np.ndarray
    iterations: np.ndarray
    converged: np.ndarray
    curved: np.ndarray

    def with_frames(self, index: np.ndarray, other: "Solve") -> "Solve":
        """The frames `index` replaced by those of another solve."""
        arrays = {name: own.copy() for name, own in vars(self).items()}
        for name, own in arrays.items():
            own[index] = getattr(other, name)
        return Solve(**arrays)


Operator = Callable[[np.ndarray], np.ndarray]


def conjugate_gradients(
    product: Operator,
    right: np.ndarray,
    precondition: Operator,
    *,
    tolerance: float | np.ndarray = 1e-8,
    limit: int = LIMIT,
    part: Callable[[np.ndarray], tuple[Operator, Operator]] | None = None,
) -> Solve:
    """Solve H x = right (T, N, 3) to |residual| <= tolerance |right| in every frame.

    A frame stops when it converges or when it meets a direction of negative curvature, where x keeps its last value
    (for the first direction, the preconditioned right side). part(frames) gives product and preconditioner of some
    frames: those that go on when half of them have stopped, as where a few are next to an instability.
    """
    x, r = np.zeros_like(right), right.copy()
    z = precondition(r)
    p, rz = z.copy(), _dots(r, z)
    goal = tolerance * np.sqrt(_dots(right, right))
    iterations, curved = np.zeros(len(right), int), np.zeros(len(right), bool)
    converged = np.sqrt(_dots(r, r)) <= goal
    swept = np.arange(len(right))  # the frames of r, z, p, rz and goal
    for step in range(limit):
        active = ~(converged | curved)[swept]
        if not active.any():
            break
        if part is not None and 2 * active.sum() <= len(swept):
            swept, r, z, p, rz, goal = (array[active] for array in (swept, r, z, p, rz, goal))
            active = active[active]
            product, precondition = part(swept)
        if step:
            z = precondition(r)
            following = _dots(r, z)
            p = z + (following / np.where(rz > 0, rz, 1.0))[:, None, None] * p
            rz = following
        q = product(p)
        curvature = _dots(p, q)
        bent = active & ((curvature <= 0) | (rz <= 0))
        if step == 0:
            x[swept[bent]] = z[bent]
        curved[swept[bent]] = True
        a = np.where(active & ~bent, rz / np.where(curvature > 0, curvature, 1.0), 0.0)
        x[swept] += a[:, None, None] * p
        r -= a[:, None, None] * q
        iterations[swept] += active
        converged[swept] |= np.sqrt(_dots(r, r)) <= goal
    return Solve(x=x, iterations=iterations, converged=converged, curved=curved)


def _dots(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("tna,tna->t", a, b)
