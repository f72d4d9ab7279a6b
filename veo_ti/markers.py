"""Young's modulus of a body from settled poses under known loads, seen through markers that ride on it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.checks import as_array, require
from sim.cloud import RestCloud
from sim.elastic import Elastic
from sim.energy import Energy
from sim.lame import Lame
from sim.linear import conjugate_gradients
from sim.newton import NewtonOptions, equilibrate
from sim.solvers import LinearSolver
from sim.terms.loads import AppliedForce
from veo_ti.body import MarkerTies, tie_markers

NEWTON, ROUGH = NewtonOptions(tolerance=1e-6), NewtonOptions(tolerance=1e-2)
EASY = 0.45  # Poisson's ratio from which a nearly incompressible solve starts
STEPS = 15
SMALL = 1e-5  # change of log E at which the fit stops
CAUTION = 1.5  # largest change of log E in one step
NEAR = 0.15  # change of log E up to which the linear prediction is a good start for the next solve


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkedPose:
    """One settled pose: the loads, and how far each marker moved from the stress-free pose."""

    force: np.ndarray  # (N, 3) [N] on the body's points
    ties: MarkerTies  # M markers, tied where they sit on the stress-free body
    displacement: np.ndarray  # (M, 3) [m]


@dataclass(frozen=True, kw_only=True, eq=False)
class ModulusFit:
    """One Young's modulus for a whole body, and what it predicts."""

    young: float  # [Pa]
    poisson: float
    y: np.ndarray  # (T, N, 3) [m]
    predicted: np.ndarray  # (T, M, 3) [m] marker displacements
    measured: np.ndarray  # (T, M, 3) [m]
    slope: np.ndarray  # (T, M, 3) [m], d predicted / d log E
    steps: int

    @property
    def residual(self) -> np.ndarray:
        """Measured minus predicted, (T, M, 3) [m]."""
        return self.measured - self.predicted

    @property
    def misfit(self) -> float:
        """Relative standard error of E were the residuals independent noise."""
        freedom = max(self.residual.size - 1, 1)
        return float(np.sqrt((self.residual**2).sum() / freedom / (self.slope**2).sum()))

    def influence(self, shift: np.ndarray) -> float:
        """Relative change of E were the measured displacements larger by `shift`, broadcast to (T, M, 3) [m].

        `d log E = sum S . shift / sum S^2` with S the slope.
        """
        return float((self.slope * shift).sum() / (self.slope**2).sum())


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A positive quantity with named, independent, relative standard uncertainties."""

    value: float
    parts: Mapping[str, float]

    @property
    def relative_sd(self) -> float:
        """Root of the sum of squares of the parts."""
        return float(np.sqrt(sum(part**2 for part in self.parts.values())))

    @property
    def bounds(self) -> tuple[float, float]:
        """value exp(-+ 2 sd): about 95 %."""
        return self.value * float(np.exp(-2 * self.relative_sd)), self.value * float(np.exp(2 * self.relative_sd))


def identify_modulus(
    cloud: RestCloud,
    poses: Sequence[MarkedPose],
    *,
    fixed: np.ndarray,
    poisson: float,
    start: tuple[float, np.ndarray] | None = None,
) -> ModulusFit:
    """The Young's modulus whose equilibria move the markers as measured, in least squares, at a fixed Poisson's ratio.

    Gauss-Newton in log E with the exact sensitivity of the equilibrium. The cloud is the stress-free shape, so gravity
    belongs among the loads. fixed: (N,) bool. start: E [Pa] and positions (T, N, 3) [m] of an earlier fit of the same
    loads; default the linear response. Raises ValueError for poses that do not fit together, NotConverged when an
    equilibrium is not found, RuntimeError when the fit does not settle.
    """
    measured, energy = _measured(poses), _energy(cloud, [pose.force for pose in poses], fixed, poisson)
    solver = LinearSolver.of(energy)
    young, y = start or _first_guess(cloud, poses, measured, fixed, min(poisson, EASY), solver)
    for step in range(1, STEPS + 1):
        scaled = _of_modulus(energy, young)
        y = equilibrate(scaled, y, options=NEWTON, solver=solver).require_converged().y
        motion = _response(scaled, y, -scaled.elastic.gradient(y), solver)  # the energy is linear in E
        predicted, slope = carried(poses, y - cloud.x), carried(poses, motion)
        change = float((slope * (measured - predicted)).sum() / (slope**2).sum())
        if abs(change) < SMALL:
            return ModulusFit(
                young=young, poisson=poisson, y=y, predicted=predicted, measured=measured, slope=slope, steps=step
            )
        change = float(np.clip(change, -CAUTION, CAUTION))
        young, y = young * float(np.exp(change)), y + change * motion if abs(change) < NEAR else y
    raise RuntimeError(f"log E did not settle in {STEPS} steps; its last change was {change:.1e}")


def settle(
    cloud: RestCloud, force: np.ndarray, *, fixed: np.ndarray, young: float, poisson: float, start: np.ndarray
) -> np.ndarray:
    """Equilibria (T, N, 3) [m] of a body of known modulus under forces (T, N, 3) [N], solved from start (T, N, 3)."""
    energy = _of_modulus(_energy(cloud, force, fixed, poisson), young)
    return equilibrate(energy, start, options=NEWTON).require_converged().y


def carried(poses: Sequence[MarkedPose], u: np.ndarray) -> np.ndarray:
    """Marker displacements (T, M, 3) [m] for body displacements u (T, N, 3) [m]."""
    return np.stack([pose.ties.positions(frame) for pose, frame in zip(poses, u, strict=True)])


def refined_limit(spacing: Sequence[float], young: Sequence[float]) -> tuple[float, float]:
    """E at zero spacing and its relative standard uncertainty, from fits on clouds of different spacing [m].

    Least squares of `log E = log E_0 + b h^2`; the uncertainty is half of what separates E_0 from the finest cloud's E.
    Raises ValueError for fewer than two clouds.
    """
    h, log_young = as_array("spacing", spacing, (None,)), np.log(as_array("young", young, (None,)))
    require(len(h) >= 2, "spacing", "be of at least two clouds", len(h))
    _, limit = np.polyfit(h**2, log_young, 1)
    return float(np.exp(limit)), float(abs(log_young[h.argmin()] - limit) / 2)


def placement_sd(cloud: RestCloud, poses: Sequence[MarkedPose], fit: ModulusFit, distance: float) -> float:
    """Relative standard uncertainty of E when each coordinate of a marker's place is uncertain by `distance` [m].

    A marker elsewhere on the body moves differently; one that is misplaced is so in all poses.
    """
    total = 0.0
    for step in distance * np.eye(3):
        ties = [tie_markers(cloud.x, pose.ties.positions(cloud.x) + step) for pose in poses]
        moved = [replace(pose, ties=tie) for pose, tie in zip(poses, ties, strict=True)]
        change = (fit.slope * (carried(moved, fit.y - cloud.x) - fit.predicted)).sum(axis=(0, 2))
        total += float((change**2).sum())
    return total**0.5 / float((fit.slope**2).sum())


def slope_check(
    cloud: RestCloud, poses: Sequence[MarkedPose], fit: ModulusFit, fixed: np.ndarray, *, step: float = 1e-2
) -> float:
    """Largest relative difference of the slope from central differences over `step` in log E, pose by pose."""
    force = [pose.force for pose in poses]
    ahead, behind = (
        settle(cloud, force, fixed=fixed, young=fit.young * np.exp(h), poisson=fit.poisson, start=fit.y)
        for h in (step, -step)
    )
    error = carried(poses, ahead - behind) / (2 * step) - fit.slope
    return float(np.max(np.linalg.norm(error, axis=(1, 2)) / np.linalg.norm(fit.slope, axis=(1, 2))))


def _measured(poses: Sequence[MarkedPose]) -> np.ndarray:
    require(len(poses) > 0, "poses", "hold at least one settled pose", "none")
    counts = {pose.ties.weights.shape[0] for pose in poses}
    require(len(counts) == 1, "poses", "have the same number of markers", sorted(counts))
    return as_array("displacement", [pose.displacement for pose in poses], (len(poses), counts.pop(), 3))


def _energy(cloud: RestCloud, force: Sequence[np.ndarray], fixed: np.ndarray, poisson: float) -> Energy:
    """The loaded body for E = 1 Pa."""
    force = as_array("force", force, (None, cloud.count, 3))
    elastic = Elastic.neo_hookean(cloud, Lame.from_young(1.0, poisson))
    return Energy.of(elastic, [AppliedForce(force=force)], fixed)


def _of_modulus(energy: Energy, young: float) -> Energy:
    return energy.with_elastic(energy.elastic.with_parameters(energy.elastic.m * young))


def _response(energy: Energy, y: np.ndarray, force: np.ndarray, solver: LinearSolver) -> np.ndarray:
    """H^-1 force (T, N, 3) [m], exact Hessian at y. Iterative: the factors of a fine cloud would fill gigabytes."""
    tangent = energy.tangent(y)
    precondition = solver.preconditioner(tangent)
    return conjugate_gradients(tangent.product, energy.free(force), precondition, tolerance=1e-5).x


def _first_guess(
    cloud: RestCloud,
    poses: Sequence[MarkedPose],
    measured: np.ndarray,
    fixed: np.ndarray,
    poisson: float,
    solver: LinearSolver,
) -> tuple[float, np.ndarray]:
    """E of the linear response that comes closest to the measured displacements, and the equilibria there.

    A nearly incompressible body is best approached through a more compressible one: Newton's steps are shortened until
    they keep the volume, which costs it several times as many.
    """
    energy = _energy(cloud, [pose.force for pose in poses], fixed, poisson)
    rest = np.repeat(cloud.x[None], len(poses), axis=0)
    u = carried(poses, _response(energy, rest, -energy.gradient(rest), solver))
    along = float((u * measured).sum())
    require(along > 0, "displacement", "follow the loads", "markers that move against them")
    young = float((u**2).sum()) / along
    return young, equilibrate(_of_modulus(energy, young), rest, options=ROUGH, solver=solver).y
