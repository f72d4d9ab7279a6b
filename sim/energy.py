"""The total energy: elastic plus a list of terms, with some points held fixed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.checks import as_array, require, some
from sim.elastic import Elastic, ElasticTangent
from sim.material import MaterialTangent
from sim.terms.base import Term, TermTangent


@dataclass(frozen=True, kw_only=True, eq=False)
class Energy:
    """`E(y) = E_elastic(y) + sum_terms E_term(y)` with y = x at the fixed points (paper Eq. equilibrium).

    Build it with `Energy.of`, which checks that the object cannot move rigidly.
    """

    elastic: Elastic
    terms: tuple[Term, ...]
    fixed: np.ndarray  # (N,) bool

    @classmethod
    def of(cls, elastic: Elastic, terms: Sequence[Term] = (), fixed: np.ndarray | None = None) -> "Energy":
        """Raises ValueError when nothing holds a connected part of the object, or when every point is fixed."""
        count = elastic.cloud.count
        fixed = np.zeros(count, bool) if fixed is None else as_array("fixed", fixed, (count,), bool)
        require(not fixed.all(), "fixed", "leave some points free to move", "all points fixed")
        held = fixed.copy()
        for term in terms:
            held[getattr(term, "points", np.zeros(0, int))] = True
        island = elastic.cloud.island
        loose = np.setdiff1d(island, island[held])
        if len(loose):
            stray = np.flatnonzero(np.isin(island, loose))
            raise ValueError(
                "fixed must hold every connected part of the object, which could otherwise move rigidly; "
                f"got {len(loose)} free part(s): points {some(stray)}"
            )
        return cls(elastic=elastic, terms=tuple(terms), fixed=fixed)

    def with_elastic(self, elastic: Elastic) -> "Energy":
        """The same loads on another material."""
        return replace(self, elastic=elastic)

    def frames(self, index: np.ndarray) -> "Energy":
        """The energy of the chosen frames only."""
        return replace(self, terms=tuple(term.frames(index) for term in self.terms))

    def between(self, frame: int, share: float) -> "Energy":
        """The energy of one instant, the `share` of the way from `frame` to the next.

        Terms that know how (`between`) are interpolated linearly; the others are those of the next frame.
        """
        following = np.array([frame + 1])
        moved = (t.between(frame, share) if hasattr(t, "between") else t.frames(following) for t in self.terms)
        return replace(self, terms=tuple(moved))

    def value(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Energy (T,) [J] and the smallest J of each frame (T,)."""
        energy, smallest = self.elastic.value(y)
        return energy + sum(term.value(y) for term in self.terms), smallest

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """dE/dy, (T, N, 3) [N], zero at the fixed points."""
        return self.free(self.elastic.gradient(y) + sum(term.gradient(y) for term in self.terms))

    def load(self, y: np.ndarray) -> np.ndarray:
        """Size (T,) [N] of what the terms other than elasticity do at y: the scale that residuals are relative to."""
        total = np.zeros_like(y) + sum(term.gradient(y) for term in self.terms)
        return np.sqrt((self.free(total) ** 2).sum(axis=(1, 2)))

    def scale(self, y: np.ndarray) -> np.ndarray:
        """What residuals are relative to, (T,) [N]: the load, or a little of the stiffness where there is none."""
        return np.maximum(self.load(y), 1e-5 * self.elastic.m[:, 0].mean() * self.elastic.cloud.spacing**2)

    def tangent(self, y: np.ndarray, project: np.ndarray | None = None) -> "Tangent":
        """The Hessian at y; see `Elastic.tangent` for `project`."""
        parts = tuple(part for part in (term.tangent(y, project) for term in self.terms) if part is not None)
        return Tangent(energy=self, elastic=self.elastic.tangent(y, project), terms=parts, y=y)

    def free(self, vectors: np.ndarray) -> np.ndarray:
        """The vectors (T, N, 3), zeroed in place at the fixed points."""
        vectors[:, self.fixed] = 0.0
        return vectors


@dataclass(frozen=True, kw_only=True, eq=False)
class Tangent:
    """The Hessian of an energy at one state of a batch, on the free points."""

    energy: Energy
    elastic: ElasticTangent
    terms: tuple[TermTangent | MaterialTangent, ...]
    y: np.ndarray  # (T, N, 3)

    def product(self, p: np.ndarray) -> np.ndarray:
        """H p, (T, N, 3), for p that vanishes at the fixed points."""
        out = self.elastic.product(p)
        for term in self.terms:
            out += term.product(p)
        return self.energy.free(out)

    def assembled(self, frames: slice) -> np.ndarray:
        """Blocks (T', M, 3, 3) on the elastic pattern; fixed points become identity rows of a matching size."""
        pattern, fixed = self.energy.elastic.pattern, self.energy.fixed
        out = self.elastic.assembled(frames)
        diagonal = np.flatnonzero(pattern.rows == pattern.indices)
        for term in self.terms:
            if isinstance(term, MaterialTangent):
                out += term.assembled(frames)
            else:
                out[:, diagonal] += term.blocks[frames]
        out[:, fixed[pattern.rows] | fixed[pattern.indices]] = 0.0
        size = np.abs(out[:, diagonal]).max(initial=0.0)
        out[:, diagonal[fixed]] = size * np.eye(3)
        return out
