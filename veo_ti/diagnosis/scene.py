"""The baseline that causes are held against: a measurement, the fitted material, and the motion it simulates."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sim.cloud import RestCloud
from sim.elastic import Elastic
from sim.energy import Energy
from sim.laws.history import Memory
from sim.recollection import Recollection
from sim.sensitivity import responses
from sim.target import Target
from sim.terms.jet import Jet, jet_forces, reblown, told_area
from sim.vibration import Vibrations
from veo_ti.observation import Observation
from veo_ti.scene import blown, forces_of

SPOTS = 40  # places on the surface that are tried
_AT_REST = ("vibrations", "relaxations", "sag")  # what is the material's, whatever the motion


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """All frames at the present model. `train` marks the frames that may be used to choose anything."""

    observation: Observation
    energy: Energy  # with the present material
    y: np.ndarray  # (T, N, 3) [m], simulated
    target: Target  # all frames; outliers unseen
    train: np.ndarray  # (T,) bool
    told: tuple[np.ndarray, Jet | None] | None = None  # nominal forces and jet, where not those of the measurement

    def moved(self, energy: Energy, y: np.ndarray) -> "Scene":
        """The same measurement under another model."""
        return self._with(energy=energy, y=y)

    def of_material(self, elastic: Elastic) -> "Scene":
        """The same motion in an object of another material."""
        if elastic is self.energy.elastic:
            return self
        return self._with(energy=self.energy.with_elastic(elastic))

    def under(self, forces: np.ndarray, jet: Jet | None) -> "Scene":
        """The same motion, with these as the nominal forces (T, N, 3) [N], blown by this jet."""
        other = self._with(told=(forces, jet))
        other.__dict__.update(_told_area=self._told_area)  # the measurement's, whatever is told instead
        return other

    def _with(self, **changes: Any) -> "Scene":
        """Keeps what was worked out for the motion or the material, where that is the same."""
        other = replace(self, **changes)
        if other.y is self.y:
            other.__dict__.update(F=self.F, _recollections=self._recollections)
        if other.energy.elastic is self.energy.elastic:
            other.__dict__.update({name: self.__dict__[name] for name in _AT_REST if name in self.__dict__})
        return other

    def with_frames(self, frames: np.ndarray, there: np.ndarray) -> np.ndarray:
        """The motion (T, N, 3) [m] with other positions there (n, N, 3) in some frames (n,)."""
        y = self.y.copy()
        y[frames] = there
        return y

    def recollection(self, name: Hashable, memory: Callable[[], Memory]) -> Recollection:
        """What a material with this memory keeps of the motion; worked out once under a name."""
        known, stencil = self._recollections, self.energy.elastic.stencil
        if name not in known:
            known[name] = Recollection(stencil=stencil, memory=memory(), y=self.y, F=self.F)
        return known[name]

    @cached_property
    def _recollections(self) -> dict[Hashable, Recollection]:
        return {}

    @property
    def cloud(self) -> RestCloud:
        """The rest shape."""
        return self.energy.elastic.cloud

    @property
    def time(self) -> np.ndarray:
        """(T,) [s]."""
        return self.observation.time

    @cached_property
    def interval(self) -> float:
        """From one frame to the next, the median [s]."""
        return float(np.median(np.diff(self.time)))

    @cached_property
    def forces(self) -> np.ndarray:
        """The nominal forces (T, N, 3) [N]."""
        return forces_of(self.observation, self.cloud) if self.told is None else self.told[0]

    @property
    def jet(self) -> Jet | None:
        """The nominal jet, where it is known."""
        return self.observation.jet if self.told is None else self.told[1]

    def blown(self, jet: Jet) -> np.ndarray:
        """The forces of a jet (T, N, 3) [N], by the same rule as the nominal ones; on the area that those tell."""
        if self._told_area is None:
            return blown(self.observation, self.cloud, jet)
        return jet_forces(jet, self.cloud.x, self._told_area)

    def reblown(self, jet: Jet) -> np.ndarray:
        """The nominal forces (T, N, 3) [N] as another jet would make them."""
        if self._told_area is None:
            return self.forces + self.blown(jet) - self.blown(self.jet)
        return reblown(self.jet, jet, self.cloud.x, self._told_area, self.forces)

    @cached_property
    def _told_area(self) -> np.ndarray | None:
        given, jet, cloud = self.observation.forces, self.observation.jet, self.cloud
        return None if given is None or jet is None else told_area(jet, cloud.x, cloud.area, given)

    @cached_property
    def total_force(self) -> np.ndarray:
        """Size of the resultant of each frame, (T,) [N]."""
        return np.linalg.norm(self.forces.sum(axis=1), axis=1)

    @property
    def largest_force(self) -> float:
        """The largest total [N]; where no force is named, what would shear a patch of one spacing by a lot."""
        return float(self.total_force.max()) or float(np.median(self.mu)) * self.cloud.spacing**2

    @property
    def extent(self) -> float:
        """The object's longest side [m]."""
        return float(np.ptp(self.cloud.x, axis=0).max())

    @cached_property
    def F(self) -> np.ndarray:
        """Deformation gradients of the simulated motion, (T, N, 3, 3)."""
        return self.cloud.deformation_gradient(self.y)

    @property
    def mu(self) -> np.ndarray:
        """Shear modulus (N,) [Pa]."""
        return self.energy.elastic.m[:, 0]

    @cached_property
    def mass(self) -> np.ndarray | None:
        """Mass of each point (N,) [kg], where the object was weighed."""
        if self.observation.mass is None:
            return None
        return self.observation.mass * self.cloud.volume / self.cloud.volume.sum()

    @cached_property
    def vibrations(self) -> Vibrations:
        """Free vibrations of the object with the present material."""
        return Vibrations.of(self.energy, self.mass)

    @cached_property
    def sag(self) -> np.ndarray:
        """How the object's weight would deform it if its reference pose were free of stress, (N, 3) [m], linear."""
        bare = Energy(elastic=self.energy.elastic, terms=(), fixed=self.energy.fixed)
        weight = self.mass[:, None] * self.observation.gravity
        return next(responses(bare, self.cloud.x[None], lambda index: weight[None, None].copy()))[0]

    @cached_property
    def relaxations(self) -> Vibrations:
        """The shapes in which a drag in proportion to volume lets the object relax."""
        return Vibrations.of(self.energy, self.cloud.volume)

    @cached_property
    def residual(self) -> np.ndarray:
        """Observed minus simulated (T, N, 3) [m], zero where nothing was seen."""
        return self.target.residual(self.y)

    @cached_property
    def undone(self) -> np.ndarray:
        """What a force at each point would undo of the residual in the frames that train, per newton: `H^-1 r`, the
        slope of `|r|^2 / 2` against it, (T, N, 3) [m2/N]."""
        wanted = self.residual * self.train[:, None, None]
        return np.concatenate(list(responses(self.energy, self.y, lambda index: wanted[index, None].copy())))

    @cached_property
    def moving(self) -> np.ndarray:
        """Frames after the reference, (T, 1, 1), 1 or 0: what acts all the time is part of the reference pose."""
        return (np.arange(len(self.time)) > 0).astype(float)[:, None, None]

    @cached_property
    def free_surface(self) -> np.ndarray:
        """Indices of the surface points that no support holds."""
        return np.flatnonzero(self.cloud.surface & ~self.energy.fixed)

    def spots(self, count: int = SPOTS) -> np.ndarray:
        """Indices of about `count` free surface points spread evenly (farthest-point sampling)."""
        free = self.free_surface
        x = self.cloud.x[free]
        chosen, distance = [int(np.argmax(x[:, 2]))], np.full(len(x), np.inf)
        for _ in range(min(count, len(x)) - 1):
            distance = np.minimum(distance, np.linalg.norm(x - x[chosen[-1]], axis=1))
            chosen.append(int(np.argmax(distance)))
        return free[chosen]

    def nearest(self, point: ArrayLike) -> int:
        """The index of the free surface point that is nearest to a point (3,) [m]."""
        return int(self.free_surface[np.linalg.norm(self.cloud.x[self.free_surface] - point, axis=1).argmin()])

    def spots_near(self, centre: ArrayLike, count: int) -> np.ndarray:
        """Up to `count` other free surface points about as near to a centre (3,) [m] as the spots are to each other."""
        free = self.free_surface
        distance = np.linalg.norm(self.cloud.x[free] - centre, axis=1)
        reach = np.sort(distance)[min(3 * len(free) // SPOTS, len(free) - 1)]
        inside = free[(distance <= max(reach, 1.5 * self.cloud.spacing)) & (distance > 0)]
        return inside[np.linspace(0, len(inside) - 1, min(count, len(inside))).astype(int)]

    def patch(self, centre: ArrayLike, radius: float) -> np.ndarray:
        """Weights (N,) of sum 1, a Gaussian around a centre (3,) [m] on the points of the free surface."""
        free, weights = self.free_surface, np.zeros(self.cloud.count)
        far = (np.linalg.norm(self.cloud.x[free] - centre, axis=1) / radius) ** 2
        w = np.exp(-0.5 * (far - far.min()))
        weights[free] = np.where(w > 1e-3, w, 0.0) / w[w > 1e-3].sum()
        return weights
