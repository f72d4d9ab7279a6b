"""A motion remembered: the stress of the strains that stay behind, and how a change of one frame reaches later ones."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sim.dtypes import contiguous
from sim.laws.history import Memory, green_strain
from sim.laws.reference import LinearStress
from sim.stencil import Stencil
from sim.terms.base import Term
from sim.terms.loads import AppliedForce
from sim.terms.material import ExtraLaw


@dataclass(frozen=True, kw_only=True, eq=False)
class Recollection:
    """What a material remembers of a motion y (T, N, 3) [m] with deformation gradients F.

    The strain of a frame itself is part of it (`memory.own`), and moves with the frame; those before are given.
    """

    stencil: Stencil
    memory: Memory
    y: np.ndarray
    F: np.ndarray

    def terms(self, mu: np.ndarray, elastic: float = 0.0) -> tuple[Term, ...]:
        """`S = 2 mu (elastic E - E*)` of the strain E and the one remembered, E*; mu (N,) [Pa]; stabilised as mu is."""
        m = LinearStress.pack(mu * (elastic - self._own), -2 * mu[:, None, None] * self._strain)
        held = self.stencil.spring_back(self._bent, mu)
        return ExtraLaw(stencil=self.stencil, law=LinearStress, m=m, stabilised=True), AppliedForce(force=held)

    @cached_property
    def _own(self) -> np.ndarray:
        return self.memory.own.reshape(len(self.y), -1)

    @cached_property
    def _strain(self) -> np.ndarray:
        return self.memory.past(green_strain(self.F))

    @cached_property
    def _bent(self) -> np.ndarray:
        return self.memory.past(self.stencil.bent(self.y - self.stencil.cloud.x))


class Passing:
    """The past of changes (K, N, 3) of a motion, for `sim.sensitivity.responses_in_turn`: `-2 mu E*` of each part."""

    def __init__(self, parts: Sequence[tuple[Recollection, np.ndarray]]) -> None:
        self._parts, self._motion = parts, parts[0][0]
        count, size = self._motion.y.shape[1], self._motion.stencil.cloud.neighbours.shape[1]
        self._last = np.zeros((1, count, 3, 3)), np.zeros((1, count, size, 3))
        self._past = [self._last for _ in parts]

    def force(self, frame: int) -> np.ndarray:
        """`div 2 mu F past`, and what the stabilisation makes of it, (K, N, 3) [N]."""
        stencil, F, total = self._motion.stencil, self._motion.F[frame], 0.0
        for n, (what, mu) in enumerate(self._parts):
            pairs = zip(self._past[n], self._last, strict=True)
            self._past[n] = strain, bent = tuple(what.memory.then(frame, past, last) for past, last in pairs)
            P = contiguous(F @ ((2 * stencil.cloud.volume * mu)[:, None, None] * strain))
            total = total + stencil.divergence(np.zeros(P.shape[:3]), P, None) + stencil.spring_back(bent, mu)
        return total

    def keep(self, frame: int, change: np.ndarray) -> None:
        """Its strain `dE = sym F^T dF`, and how it bends every stencil."""
        cloud = self._motion.stencil.cloud
        D = self._motion.F[frame].swapaxes(1, 2) @ (cloud.deformation_gradient(cloud.x + change) - np.eye(3))
        self._last = (D + D.swapaxes(2, 3)) / 2, self._motion.stencil.bent(change)
