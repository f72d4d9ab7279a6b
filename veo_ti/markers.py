"""Young's modulus of a body from settled poses under known loads, seen through markers that ride on it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.checks import as_array, require
from sim.cloud import RestCloud
from sim.elastic import Elastic
from sim.energy import Energy
from sim.lame import Lame
from sim.linear import DirectFactors, Layout
from sim.newton import NewtonOptions, equilibrate
from sim.sensitivity import sensitivities
from sim.terms.loads import AppliedForce
from veo_ti.body import Body, MarkerTies

NEWTON = NewtonOptions(tolerance=1e-6)
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
    body: Body,
    poses: Sequence[MarkedPose],
    *,
    fixed: np.ndarray,
    poisson: float,
    start: tuple[float, np.ndarray] | None = None,
) -> ModulusFit:
    """The Young's modulus whose equilibria move the markers as measured, in least squares, at a fixed Poisson's ratio.

    Gauss-Newton in log E with the exact sensitivity of the equilibrium. The body's own shape is the stress-free one, so
    gravity belongs among the loads. fixed: (N,) bool. start: E [Pa] and (T, N, 3) [m] of an earlier fit of the same
    loads; default the linear response. Raises ValueError for poses that do not fit together, NotConverged when an
    equilibrium is not found, RuntimeError when the fit does not settle.
    """
    measured, energy = _problem(body, poses, fixed, poisson)
    young, y = start or (_first_guess(energy, poses, measured), np.repeat(body.x[None], len(poses), axis=0))
    for step in range(1, STEPS + 1):
        scaled = energy.with_elastic(energy.elastic.with_parameters(energy.elastic.m * young))
        y = equilibrate(scaled, y, options=NEWTON).require_converged().y
        motion = np.stack([S[0] for S in sensitivities(scaled, y, scaled.elastic.m[None])])
        predicted, slope = carried(poses, y - body.x), carried(poses, motion)
        change = float((slope * (measured - predicted)).sum() / (slope**2).sum())
        if abs(change) < SMALL:
            return ModulusFit(
                young=young, poisson=poisson, y=y, predicted=predicted, measured=measured, slope=slope, steps=step
            )
        change = float(np.clip(change, -CAUTION, CAUTION))
        young, y = young * np.exp(change), y + change * motion if abs(change) < NEAR else y
    raise RuntimeError(f"Young's modulus did not settle in {STEPS} steps; the last change was {change:.1e}")


def predict_poses(
    body: Body, poses: Sequence[MarkedPose], *, fixed: np.ndarray, young: float, poisson: float, start: np.ndarray
) -> np.ndarray:
    """Marker displacements (T, M, 3) [m] of a body of known modulus, solved from start (T, N, 3) [m]."""
    _, energy = _problem(body, poses, fixed, poisson)
    scaled = energy.with_elastic(energy.elastic.with_parameters(energy.elastic.m * young))
    return carried(poses, equilibrate(scaled, start, options=NEWTON).require_converged().y - body.x)


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
    slope, limit = np.polyfit(h**2, log_young, 1)
    return float(np.exp(limit)), float(abs(log_young[h.argmin()] - limit) / 2)


def _problem(body: Body, poses: Sequence[MarkedPose], fixed: np.ndarray, poisson: float) -> tuple[np.ndarray, Energy]:
    """The measured displacements (T, M, 3), and the energy for E = 1 Pa."""
    require(len(poses) > 0, "poses", "hold at least one settled pose", "none")
    counts = {pose.ties.weights.shape[0] for pose in poses}
    require(len(counts) == 1, "poses", "have the same number of markers", sorted(counts))
    measured = as_array("displacement", [pose.displacement for pose in poses], (len(poses), counts.pop(), 3))
    force = as_array("force", [pose.force for pose in poses], (len(poses), len(body.x), 3))
    cloud = RestCloud.build(body.x, volume=body.volume, surface=body.surface)
    elastic = Elastic.neo_hookean(cloud, Lame.from_young(1.0, poisson))
    return measured, Energy.of(elastic, [AppliedForce(force=force)], fixed)


def _first_guess(energy: Energy, poses: Sequence[MarkedPose], measured: np.ndarray) -> float:
    """E of the linear response to the loads that comes closest to the measured displacements."""
    rest = np.repeat(energy.elastic.cloud.x[None], len(poses), axis=0)
    factors = DirectFactors.of(energy.tangent(rest[:1]), Layout(pattern=energy.elastic.pattern))
    u = carried(poses, factors.many(-energy.gradient(rest)[None])[0])
    along = float((u * measured).sum())
    require(along > 0, "displacement", "follow the loads", "markers that move against them")
    return float((u**2).sum()) / along

