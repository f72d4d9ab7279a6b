"""The direct peers: every frame's assembled Hessian factorised by CHOLMOD, where cvxopt is installed, or by SuperLU."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse.linalg import SuperLU

from sim.direct import DirectFactors, Layout
from sim.energy import Energy, Tangent
from sim.linear import Preconditioner
from sim.runtime import serial_blas
from sim.solvers import Memoryless

try:
    from cvxopt import cholmod, matrix, spmatrix
except ImportError:
    cholmod = None


class _Fresh(Memoryless):
    """Stands in for a LinearSolver of one frame, and makes a factor at every step."""

    def following(
        self, last: Preconditioner | None, energy: Energy, tangent: Tangent, residual: np.ndarray
    ) -> Preconditioner:
        """A fresh one."""
        return self.preconditioner(tangent)

    def frames(self, index: np.ndarray, tangent: Tangent) -> Preconditioner:
        """Itself: there is one frame."""
        return self


@dataclass(frozen=True, kw_only=True, eq=False)
class Cholmod(_Fresh):
    """The symbolic analysis is made once for the pattern; it is its own preconditioner, of the last frame."""

    layout: Layout
    lower: np.ndarray  # (L,) places of the lower triangle's entries among the matrix's
    pattern: Any  # spmatrix of the lower triangle; its values change
    factor: Any  # CHOLMOD's object, overwritten by every factorisation

    @classmethod
    def of(cls, energy: Energy) -> "Cholmod":
        """Analyse the pattern of an energy's Hessian."""
        layout = Layout.of(energy.elastic)
        template = layout.template[0]
        column = np.repeat(np.arange(template.shape[0]), np.diff(template.indptr))
        lower = np.flatnonzero(template.indices >= column)
        pattern = spmatrix(1.0, template.indices[lower].tolist(), column[lower].tolist(), template.shape)
        return cls(layout=layout, lower=lower, pattern=pattern, factor=cholmod.symbolic(pattern))

    def preconditioner(self, tangent: Tangent) -> Preconditioner:
        """The inverse at the one frame of a tangent; SuperLU's where it is not positive definite."""
        blocks = tangent.assembled(slice(0, 1))[0]
        self.pattern.V = matrix(self.layout.matrix(blocks).data[self.lower])
        try:
            cholmod.numeric(self.pattern, self.factor)
        except ArithmeticError:
            return DirectFactors.of(tangent, self.layout)
        return self

    def __call__(self, right: np.ndarray) -> np.ndarray:
        x = matrix(right.reshape(-1, 1))
        cholmod.solve(self.factor, x)
        return np.array(x).reshape(right.shape)


@dataclass(frozen=True, kw_only=True, eq=False)
class Superlu(_Fresh):
    """SuperLU, which analyses the pattern anew for every matrix; its own preconditioner, of one frame."""

    layout: Layout
    factor: SuperLU | None = None

    @classmethod
    def of(cls, energy: Energy) -> "Superlu":
        """Nothing is known beforehand."""
        return cls(layout=Layout.of(energy.elastic))

    def preconditioner(self, tangent: Tangent) -> Preconditioner:
        """The inverse at the one frame of a tangent."""
        with serial_blas():
            return replace(self, factor=self.layout.indefinite(tangent.assembled(slice(0, 1))[0]))

    def __call__(self, right: np.ndarray) -> np.ndarray:
        with serial_blas():
            return self.factor.solve(right.ravel()).reshape(right.shape)


def best_direct(energy: Energy) -> tuple[str, Cholmod | Superlu]:
    """The faster of the peers that is installed, and its name."""
    if cholmod is None:
        return "SuperLU", Superlu.of(energy)
    return "CHOLMOD", Cholmod.of(energy)
