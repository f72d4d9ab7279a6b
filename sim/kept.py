"""A preconditioner that serves many solves in a row, for problems that follow one another in small steps."""

from dataclasses import dataclass

import numpy as np

from sim.energy import Energy, Tangent
from sim.linear import Preconditioner
from sim.newton import LinearSolver

_DIRECT = 6000  # points up to which "auto" factorises: one factor serves many steps in time
_WORN = 16  # steps of conjugate gradients that tell that a factor is out of date


@dataclass(eq=False)
class KeptSolver:
    """A `LinearSolver` for one frame that keeps its preconditioner until it is worn.

    It is also renewed at every projected Hessian, one that is not positive definite having gone before.
    """

    solver: LinearSolver
    inverse: Preconditioner | None = None
    calls: int = 0  # since the last tangent

    @classmethod
    def of(cls, energy: Energy, linear: str = "auto") -> "KeptSolver":
        """ "auto" factorises all but large clouds."""
        small = linear == "auto" and energy.elastic.cloud.count <= _DIRECT
        return cls(solver=LinearSolver.of(energy, "direct" if small else linear))

    def preconditioner(self, tangent: Tangent) -> "KeptSolver":
        """Itself, renewed at this tangent where need be."""
        if self.inverse is None or self.calls > _WORN or len(tangent.elastic.frames):
            self.inverse = self.solver.preconditioner(tangent)
        self.calls = 0
        return self

    def following(
        self, last: Preconditioner | None, energy: Energy, tangent: Tangent, residual: np.ndarray
    ) -> "KeptSolver":
        """Likewise."""
        return self.preconditioner(tangent)

    def frames(self, index: np.ndarray) -> "KeptSolver":
        """Itself: there is one frame."""
        return self

    def __call__(self, r: np.ndarray) -> np.ndarray:
        """z ~ H^-1 r, (1, N, 3)."""
        self.calls += 1
        return self.inverse(r)
