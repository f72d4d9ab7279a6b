"""The stress-free shape of an object that was seen sagging under gravity (paper: P_0 is the pose under gravity)."""

from dataclasses import dataclass, replace

import numpy as np

from sim.checks import as_array, require
from sim.cloud import RestCloud, _least_squares_gradients, _weights
from sim.consistency import corrected_gradients
from sim.elastic import Elastic
from sim.energy import Energy
from sim.fixed_point import MixingOptions, fixed_point
from sim.hull import _boundary, _kept_tetrahedra, _volumes
from sim.lame import Lame
from sim.newton import LinearSolver, NewtonOptions, Status, equilibrate
from sim.terms.loads import AppliedForce


@dataclass(frozen=True, kw_only=True, eq=False)
class RestShape:
    """The shape that gravity bends into the observed one."""

    cloud: RestCloud  # the rest cloud, its x the rest positions [m]
    miss: float  # [m] largest distance per coordinate of its sagged pose from the observed one
    iterations: int  # equilibria solved
    settled: bool

    @property
    def sentence(self) -> str:
        """How the search ended."""
        if self.settled:
            return f"the rest shape sags to within {self.miss:.1e} m of the observed one ({self.iterations} solves)"
        return (
            f"no rest shape was found in {self.iterations} solves: the best one sags to {self.miss:.1e} m from the "
            "observed one; the material may be too soft to stand as observed"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A cloud with its topology held, so that it moves smoothly with its points: same neighbours, same tetrahedra."""

    cloud: RestCloud
    tets: np.ndarray  # (M, 4)
    faces: np.ndarray  # (L, 3) outward

    @classmethod
    def of(cls, cloud: RestCloud) -> "Motion":
        """The tetrahedra of the cloud as it is."""
        jitter = np.random.default_rng(0).standard_normal(cloud.x.shape)
        tets = _kept_tetrahedra(cloud.x + 1e-6 * cloud.reach[:, None] * jitter, cloud.reach, 1.8)
        return cls(cloud=cloud, tets=tets, faces=_boundary(tets))

    def at(self, x: np.ndarray) -> RestCloud:
        """The cloud of the same object with its points at x (N, 3) [m]: volumes and areas change with it."""
        c = self.cloud
        arms = x[c.neighbours] - x[:, None]
        weights, lumped, before = _weights(arms), self._lumped(x), self._lumped(c.x)
        some = before > 0
        volume = c.volume * np.divide(lumped, before, out=np.ones_like(before), where=some)
        area = self._areas(x) * (volume.sum() / lumped.sum() if lumped.sum() > 0 else 0.0)
        gradients = _least_squares_gradients(arms, weights)
        if c.options.mode == "consistent":
            gradients = corrected_gradients(gradients, arms, c.neighbours, volume, area, some)
        reach = np.linalg.norm(arms, axis=2).mean(axis=1)
        return replace(c, x=x, arms=arms, weights=weights, gradients=gradients, volume=volume, area=area, reach=reach)

    def upright(self, x: np.ndarray) -> bool:
        """Whether no tetrahedron is turned inside out at x."""
        return bool((_volumes(x, self.tets) * np.sign(_volumes(self.cloud.x, self.tets)) > 0).all())

    def _lumped(self, x: np.ndarray) -> np.ndarray:
        corners = np.repeat(_volumes(x, self.tets) / 4, 4)
        return np.bincount(self.tets.ravel(), corners, minlength=len(x))

    def _areas(self, x: np.ndarray) -> np.ndarray:
        a, b, c = (x[self.faces[:, n]] for n in range(3))
        third = np.repeat(np.cross(b - a, c - a) / 6, 3, axis=0)
        columns = [np.bincount(self.faces.ravel(), third[:, n], minlength=len(x)) for n in range(3)]
        return np.stack(columns, axis=1)


def stress_free_rest(
    observed: RestCloud,
    lame: Lame,
    mass: np.ndarray,
    gravity: np.ndarray,
    fixed: np.ndarray,
    *,
    mixing: MixingOptions | None = None,
    options: NewtonOptions | None = None,
) -> RestShape:
    """Find x with `equilibrium(x, gravity) = observed.x`, points `fixed` (N,) in place.

    mass (N,) [kg], gravity (3,) [m/s2]; `observed` is the cloud built from the sagged pose, whose neighbours are kept.
    Iterates `x <- x - (y(x) - observed)` with Anderson's mixing; the default tolerance is 1e-6 of the spacing.
    Raises ValueError for masses that are not positive; a search that does not settle says so in `sentence`.
    """
    mass = as_array("mass", mass, (observed.count,))
    require(bool((mass > 0).all()), "mass", "be positive at every point", mass.min())
    weight = AppliedForce(force=mass[None, :, None] * as_array("gravity", gravity, (3,)))
    elastic, motion, y = Elastic.neo_hookean(observed, lame), Motion.of(observed), observed.x
    solver = LinearSolver.of(Energy.of(elastic, [weight], fixed), (options or NewtonOptions()).linear)

    def image(x: np.ndarray) -> np.ndarray:
        if not motion.upright(x[0]):
            return np.full_like(x, np.nan)
        energy = Energy.of(replace(elastic, cloud=motion.at(x[0])), [weight], fixed)
        found = equilibrate(energy, y[None], options=options, solver=solver)
        if found.status[0] is not Status.CONVERGED:
            return np.full_like(x, np.nan)
        return x - (found.y - y)

    mixing = mixing or MixingOptions(tolerance=1e-6 * observed.spacing)
    found = fixed_point(image, y[None], mixing)
    return RestShape(
        cloud=motion.at(found.x[0]),
        miss=float(found.change[0]),
        iterations=found.iterations,
        settled=bool(found.settled[0]),
    )
