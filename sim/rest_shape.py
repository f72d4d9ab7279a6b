"""The stress-free shape of an object that was seen sagging under gravity (paper: P_0 is the pose under gravity)."""

from dataclasses import dataclass, replace

import numpy as np

from sim.checks import as_array, require
from sim.cloud import RestCloud
from sim.elastic import Elastic
from sim.energy import Energy
from sim.fixed_point import MixingOptions, fixed_point
from sim.lame import Lame
from sim.newton import NewtonOptions, Status, equilibrate
from sim.solvers import LinearSolver
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


def _upright(cloud: RestCloud, x: np.ndarray) -> bool:
    """Whether the solid around every point keeps a volume at x (flat tetrahedra in the surface may turn over)."""
    return bool((cloud.hull.volume(x)[cloud.hull.volume(cloud.x) > 0] > 0).all())


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
    elastic, y = Elastic.neo_hookean(observed, lame), observed.x
    solver = LinearSolver.of(Energy.of(elastic, [weight], fixed), (options or NewtonOptions()).linear)

    def image(x: np.ndarray) -> np.ndarray:
        if not _upright(observed, x[0]):
            return np.full_like(x, np.nan)
        energy = Energy.of(replace(elastic, cloud=observed.moved(x[0])), [weight], fixed)
        found = equilibrate(energy, y[None], options=options, solver=solver)
        if found.status[0] is not Status.CONVERGED:
            return np.full_like(x, np.nan)
        return x - (found.y - y)

    mixing = mixing or MixingOptions(tolerance=1e-6 * observed.spacing)
    found = fixed_point(image, y[None], mixing)
    return RestShape(
        cloud=observed.moved(found.x[0]),
        miss=float(found.change[0]),
        iterations=found.iterations,
        settled=bool(found.settled[0]),
    )
