"""Loads that turn with the surface they act on: a jet or a pressure on the deformed pose."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sim.cloud import RestCloud
from sim.energy import Energy
from sim.fixed_point import MixingOptions, fixed_point
from sim.newton import Equilibrium, NewtonOptions, Status, equilibrate
from sim.solvers import LinearSolver
from sim.terms.loads import AppliedForce

Load = Callable[[np.ndarray, np.ndarray], np.ndarray]  # y (T, N, 3) [m], area (T, N, 3) [m2] -> forces (T, N, 3) [N]


@dataclass(frozen=True, kw_only=True, eq=False)
class FollowerEquilibrium:
    """The pose that holds the forces which that pose receives."""

    equilibrium: Equilibrium  # under the last forces
    force: np.ndarray  # (T, N, 3) [N]
    change: np.ndarray  # (T,) largest change of a force in the last round, relative to the frame's largest force
    iterations: int  # solves
    settled: np.ndarray  # (T,) bool

    @property
    def y(self) -> np.ndarray:
        """Positions (T, N, 3) [m]."""
        return self.equilibrium.y

    @property
    def converged(self) -> bool:
        """Whether every frame is in equilibrium with forces that have settled."""
        return bool(self.settled.all()) and self.equilibrium.converged

    @property
    def sentence(self) -> str:
        """What happened, naming the frames that failed."""
        if self.settled.all():
            return f"the forces settled in {self.iterations} solves; {self.equilibrium.sentence}"
        worst = int(self.change.argmax())
        if np.isinf(self.change[worst]):
            return f"the first forces have no equilibrium: {self.equilibrium.sentence}; a smaller load may help"
        return (
            f"in {int((~self.settled).sum())} of {len(self.settled)} frames the forces did not settle with the surface "
            f"in {self.iterations} solves (frame {worst} still changes by {self.change[worst]:.1e} of its force); "
            "a smaller load, or steps towards it, may help"
        )


def deformed_area(cloud: RestCloud, y: np.ndarray) -> np.ndarray:
    """Outward area vectors `a_i = J F^-T A_i` (T, N, 3) [m2] of the poses y (T, N, 3) [m] (Nanson's formula)."""
    out = np.zeros((*y.shape[:2], 3))
    outer = np.flatnonzero(cloud.area.any(axis=1))
    out[:, outer] = np.einsum("tnab,nb->tna", _cofactor(cloud.deformation_gradient(y)[:, outer]), cloud.area[outer])
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Following:
    """Nominal forces f (T, N, 3) [N] that turn and spread with the surface, `cof(F) f`, F (T, N, 3, 3).

    A `Past` of `sim.sensitivity`: a frame's own motion pushes beyond the Hessian of its energy, and no other frame's.
    """

    cloud: RestCloud
    F: np.ndarray
    nominal: np.ndarray

    @cached_property
    def there(self) -> np.ndarray:
        """The forces there are, (T, N, 3) [N]."""
        return np.einsum("tnab,tnb->tna", _cofactor(self.F), self.nominal)

    def force(self, frame: int) -> float:
        """None of the frames before."""
        return 0.0

    def acts(self, frame: int) -> bool:
        """Where there is a force."""
        return bool(self.nominal[frame].any())

    def own(self, frame: int, change: np.ndarray) -> np.ndarray:
        """`d cof(F) f` of changes (K, N, 3) [m]."""
        at, out = np.flatnonzero(self.nominal[frame].any(axis=1)), np.zeros(change.shape)
        arms = change[:, self.cloud.neighbours[at]] - change[:, at, None]
        F, dF = self.F[frame, at], np.einsum("knca,ncb->knab", arms, self.cloud.gradients[at])
        out[:, at] = np.einsum("knab,nb->kna", _crossed(F, dF) + _crossed(dF, F), self.nominal[frame, at])
        return out

    def keep(self, frame: int, change: np.ndarray) -> None:
        """Nothing."""


def _cofactor(F: np.ndarray) -> np.ndarray:
    """`J F^-T`, also where F (..., 3, 3) is flat."""
    return _crossed(F, F)


def _crossed(F: np.ndarray, G: np.ndarray) -> np.ndarray:
    """What is the cofactor where F = G: linear in both, column by column."""
    (a, b, c), (d, e, f) = (tuple(M[..., n] for n in range(3)) for M in (F, G))
    return np.stack([np.cross(b, f), np.cross(c, d), np.cross(a, e)], axis=-1)


def equilibrate_follower(
    energy: Energy,
    load: Load,
    start: np.ndarray,
    *,
    tolerance: float = 1e-6,
    iterations: int = 30,
    options: NewtonOptions | None = None,
) -> FollowerEquilibrium:
    """Equilibrium (T, N, 3) [m] of the energy and a load that depends on the pose, from `start`.

    Solve, take the area vectors of the solution, take the forces on it, until no force changes by more than `tolerance`
    of the frame's largest. For a jet: `lambda y, area: jet_forces(jet, y, area)`. A follower load has in general no
    energy, so this outer loop stands around the Newton solve and not in it.
    """
    mixing = MixingOptions(tolerance=tolerance, iterations=iterations)
    cloud, solver = energy.elastic.cloud, LinearSolver.of(energy, (options or NewtonOptions()).linear)
    start = np.asarray(start, float)
    nominal = load(start, deformed_area(cloud, start))
    scale = np.abs(nominal).max(axis=(1, 2), keepdims=True)
    scale[scale == 0] = 1.0
    found = [start]

    def solve(share: np.ndarray) -> Equilibrium:
        loaded = replace(energy, terms=(*energy.terms, AppliedForce(force=share * scale)))
        return equilibrate(loaded, found[-1], options=options, solver=solver)

    def image(share: np.ndarray) -> np.ndarray:
        solved = solve(share)
        failed = np.array([status is not Status.CONVERGED for status in solved.status])[:, None, None]
        found.append(np.where(failed, found[-1], solved.y))
        return np.where(failed, np.nan, load(solved.y, deformed_area(cloud, solved.y)) / scale)

    mixed = fixed_point(image, nominal / scale, mixing)
    return FollowerEquilibrium(
        equilibrium=solve(mixed.x), force=mixed.x * scale, change=mixed.change, iterations=mixed.iterations,
        settled=mixed.settled,
    )  # fmt: skip
