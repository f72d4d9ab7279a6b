"""A motion remembered: the stress of the strains that stay behind, and how a change of one frame reaches later ones."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sim.elastic import Elastic
from sim.laws.history import Memory, green_strain
from sim.laws.reference import LinearStress
from sim.laws.softening import SoftBelow, damage, damage_slope, largest_load, load
from sim.stencil import Stencil
from sim.terms.base import Term
from sim.terms.material import ExtraLaw, Held


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
        held = Held.of(self.stencil, self.stencil.bent_forces(self._bent, mu))
        return ExtraLaw(stencil=self.stencil, law=LinearStress, m=m, stabilised=True), held

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
    """How changes (K, N, 3) of the motion of one frame act on those after it through `-2 mu E*`, mu (N,) [Pa]."""

    def __init__(self, what: Recollection, mu: np.ndarray) -> None:
        self._what, self._mu = what, mu
        count, size = what.stencil.cloud.neighbours.shape
        self._past = self._last = np.zeros((1, count, 3, 3)), np.zeros((1, count, size, 3))

    def force(self, frame: int) -> np.ndarray:
        """`div 2 mu F past`, and what the stabilisation makes of it, (K, N, 3) [N]."""
        stencil, then = self._what.stencil, self._what.memory.then
        self._past = strain, bent = tuple(then(frame, *both) for both in zip(self._past, self._last, strict=True))
        return stencil.pull(strain, self._what.F[frame], 2 * self._mu) + stencil.spring_back(bent, self._mu)

    def acts(self, frame: int) -> bool:
        """No: it is in the frame's Hessian."""
        return False

    def keep(self, frame: int, change: np.ndarray) -> None:
        """Its strain `dE = sym F^T dF`, and how it bends every stencil."""
        stencil = self._what.stencil
        self._last = stencil.strained(change, self._what.F[frame]), stencil.bent(change)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Softened:
    """An elastic body that lost a share of its energy by the largest load so far (see `sim.laws.softening`)."""

    elastic: Elastic
    y: np.ndarray  # (T, N, 3) [m]
    F: np.ndarray
    share: float
    scale: float
    at_once = True  # whether a frame loses by its own load

    @cached_property
    def load_slope(self) -> np.ndarray:
        """How the load grows with the Green strain, `dI/dE = 2 (1 - C^-1)`, (T, N, 3, 3)."""
        return 2 * (np.eye(3) - np.linalg.inv(self.F.swapaxes(2, 3) @ self.F))

    @cached_property
    def reached(self) -> np.ndarray:
        """What grows with the largest load so far, (T, N)."""
        raise NotImplementedError

    @cached_property
    def fresh(self) -> np.ndarray:
        """Where that load is a frame's own, (T, N)."""
        return np.diff(self.reached, axis=0, prepend=0.0) > 0

    @cached_property
    def each(self) -> np.ndarray:
        """What every stencil would lose on its own points if it lost all, (T, N, k + 1, 3) [N]."""
        raise NotImplementedError

    def slope(self, frame: int) -> np.ndarray:
        """How the share that is lost grows with the largest load, (N,)."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True, eq=False)
class Damaged(_Softened):
    """For good: `share D` of its energy, D of the largest load."""

    soon: bool = False

    def terms(self) -> tuple[Term, ...]:
        """What it lost."""
        return (self.lost(-self.share * self.reached),)

    def lost(self, weight: np.ndarray) -> ExtraLaw:
        """The energy in proportion to weights (T, N)."""
        given = self.elastic
        return ExtraLaw(stencil=given.stencil, law=given.law, m=given.m, weight=weight, stabilised=True)

    @cached_property
    def each(self) -> np.ndarray:
        """With the stabilisation."""
        return self.lost(np.ones((1, self.y.shape[1]))).each(self.y)

    @cached_property
    def reached(self) -> np.ndarray:
        """The damage D done, from 0 to 1."""
        return damage(self.F, self.scale, soon=self.soon)

    def slope(self, frame: int) -> np.ndarray:
        """Of the damage."""
        return self.share * damage_slope(self.reached[frame], self.scale, soon=self.soon)


@dataclass(frozen=True, kw_only=True, eq=False)
class SoftenedBelow(_Softened):
    """Below the largest load before: `share tanh` of its shear stress (`sim.laws.softening.SoftBelow`)."""

    at_once = False

    def terms(self) -> tuple[Term, ...]:
        """What it lost."""
        given, before = self.elastic, np.concatenate([np.zeros_like(self.reached[:1]), self.reached[:-1]])
        m = np.stack(np.broadcast_arrays(given.m[:, 0], self.share, self.scale, before), axis=2)
        return (ExtraLaw(stencil=given.stencil, law=SoftBelow, m=m),)

    @cached_property
    def reached(self) -> np.ndarray:
        """The load itself."""
        return largest_load(self.F)

    @cached_property
    def each(self) -> np.ndarray:
        """Of the shear modulus."""
        given = self.elastic
        return ExtraLaw(stencil=given.stencil, law=given.law, m=given.m * [1.0, 0.0]).each(self.y)

    def slope(self, frame: int) -> np.ndarray:
        """Of tanh, and nothing where the frame's own load is the largest."""
        below = (self.reached[frame] - load(self.F[frame])) / self.scale
        return np.where(self.fresh[frame], 0.0, self.share * (1 - np.tanh(below) ** 2) / self.scale)


class PassingSoftening:
    """How changes (K, N, 3) of the motion of one frame act on those after it, and on itself, by what they soften."""

    def __init__(self, what: Damaged | SoftenedBelow) -> None:
        self._what, self._largest = what, np.zeros((1, what.y.shape[1]))

    def force(self, frame: int) -> np.ndarray:
        """Where earlier frames had the largest load, (K, N, 3) [N]."""
        return self._pushed(frame, np.where(self._what.fresh[frame], 0.0, self._largest))

    def acts(self, frame: int) -> bool:
        """Where the frame has."""
        return self._what.at_once and bool(self._what.fresh[frame].any())

    def own(self, frame: int, change: np.ndarray) -> np.ndarray:
        """By its own load, (K, N, 3) [N]."""
        return self._pushed(frame, np.where(self._what.fresh[frame], self._load(frame, change), 0.0))

    def keep(self, frame: int, change: np.ndarray) -> None:
        """The change of the largest load so far."""
        self._largest = np.where(self._what.fresh[frame], self._load(frame, change), self._largest)

    def _load(self, frame: int, change: np.ndarray) -> np.ndarray:
        """`dI/dE : dE`, (K, N)."""
        strain = self._what.elastic.stencil.strained(change, self._what.F[frame])
        return np.einsum("nab,knab->kn", self._what.load_slope[frame], strain)

    def _pushed(self, frame: int, load: np.ndarray) -> np.ndarray:
        what = self._what
        return what.elastic.stencil.gathered(what.each[frame], what.slope(frame) * load)
