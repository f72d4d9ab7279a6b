"""The silicone beam: Young's modulus from motion capture of its settled poses under gravity and a known weight.

Data: srl-ethz/diffPD_sim2real (MIT), Dragon Skin 10, 30 x 30 x 100 mm, clamped at x = -0.1. The box is the stress-free
shape, so gravity is a load. Beam frame: x from the clamp to the tip, z up.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim.checks import require
from sim.cloud import RestCloud
from veo_ti.body import sample_box, tie_markers
from veo_ti.markers import (
    Interval,
    MarkedPose,
    ModulusFit,
    carried,
    identify_modulus,
    placement_sd,
    refined_limit,
    settle,
    slope_check,
)
from veo_ti.mocap import BeamTake, read_beam_take

SIZE = (0.1, 0.03, 0.03)  # [m]
CORNER = (-0.1, 0.0, 0.0)  # [m]
DENSITY = 1070.0  # [kg/m3]
GRAVITY = 9.807  # [m/s2]
POISSON = 0.499
PUBLISHED = 263_824.0  # [Pa] the authors' fit, nu .499
PUBLISHED_DROP_MM = {"gravity": -6.75, "load52": -16.84}  # their model's static tip drop
TIP, BASE = slice(0, 3), slice(3, 6)  # markers
SETTLED = 100  # last frames: one second
CLOUDS = {1000: 4, 2000: 2, 4000: 1}  # points -> random clouds of that many; coarse ones scatter by 2 %

PLACEMENT = 1e-3  # [m] sd of a marker's place on the beam: a rigid fit leaves 0.3 to 2 mm
STRAIGHTNESS = 0.3e-3  # [m] sd of the held tip's height: the tip markers' misfit over root 3
PITCH = 2e-3  # [rad] sd of the base plate's tilt: what its markers show where none of them jumped


@dataclass(frozen=True, kw_only=True, eq=False)
class SettledTake:
    """What one take says: where the tip markers sit on the straight beam, and how far they moved until it settled."""

    name: str  # gravity_V2_a and so on
    load: float  # [N] weight at the tip, along -z
    held: np.ndarray  # (3, 3) [m]
    displacement: np.ndarray  # (3, 3) [m] relative to the base plate
    base: np.ndarray  # (3, 3) [m] displacement of the base markers
    noise: float  # [m] scatter of a settled marker's coordinate, drift removed
    creep: float  # [m/s] mean vertical speed of the tip in the settled second

    @property
    def kind(self) -> str:
        """The loading, shared by the repeats."""
        return self.name.split("_")[0]

    @property
    def drop_mm(self) -> float:
        """Mean vertical displacement of the tip markers [mm]."""
        return 1e3 * float(self.displacement[:, 2].mean())


def settled_take(name: str, take: BeamTake) -> SettledTake:
    """Held and settled pose of a take.

    Held: the median over the rest frames, because the base markers jump by 0.5 mm in the first 0.13 s of every take.
    Settled: the mean of the last second. The base plate's motion is taken as the median displacement of its markers, a
    translation: their lever of 28 mm is too short for a tilt, and in one take a single one of them jumps by 0.8 mm.
    """
    p = take.markers.positions
    held = np.median(p[: take.rest_frames], axis=0)
    last, t = p[-SETTLED:], take.markers.time[-SETTLED:]
    moved = last.mean(axis=0) - held
    trend = np.polynomial.polynomial.polyfit(t - t.mean(), last.reshape(SETTLED, -1), 1)
    ripple = last.reshape(SETTLED, -1) - trend[0] - np.outer(t - t.mean(), trend[1])
    return SettledTake(
        name=name, load=take.tip_load, held=held[TIP], displacement=moved[TIP] - np.median(moved[BASE], axis=0),
        base=moved[BASE], noise=float(ripple.std()), creep=float(trend[1].reshape(-1, 3)[TIP, 2].mean()),
    )  # fmt: skip


def read_settled(folder: str | Path) -> dict[str, SettledTake]:
    """The takes of a folder of beam_*.npz, by name. Raises ValueError where there is none or one is damaged."""
    paths = sorted(Path(folder).glob("beam_*.npz"))
    require(len(paths) > 0, "folder", "hold beam_*.npz takes", repr(str(folder)))
    names = [path.stem.removeprefix("beam_") for path in paths]
    return {name: settled_take(name, read_beam_take(path)) for name, path in zip(names, paths, strict=True)}


@dataclass(frozen=True, kw_only=True, eq=False)
class BeamModel:
    """The straight beam as a cloud, with its clamp and its loads."""

    cloud: RestCloud

    @classmethod
    def of(cls, count: int, seed: int = 0) -> "BeamModel":
        """A beam of `count` points."""
        body = sample_box(SIZE, count, corner=CORNER, seed=seed)
        return cls(cloud=RestCloud.build(body.x, volume=body.volume, surface=body.surface))

    @property
    def fixed(self) -> np.ndarray:
        """The clamped face, (N,) bool."""
        return self.cloud.x[:, 0] <= CORNER[0] + 1e-9

    def force(self, load: float) -> np.ndarray:
        """Gravity on every point and a weight [N] spread evenly along the upper tip edge, (N, 3) [N]."""
        x, out = self.cloud.x, np.zeros_like(self.cloud.x)
        out[:, 2] = -DENSITY * GRAVITY * self.cloud.volume
        edge = np.flatnonzero((x[:, 0] >= -1e-9) & (x[:, 2] >= SIZE[2] - 1e-9))
        edge = edge[np.argsort(x[edge, 1])]
        half = np.diff(x[edge, 1]) / 2
        out[edge, 2] -= load * (np.append(half, 0) + np.insert(half, 0, 0)) / SIZE[1]
        return out

    def pose(self, take: SettledTake) -> MarkedPose:
        """A take's pose with its markers tied where they sat on the straight beam."""
        ties = tie_markers(self.cloud.x, take.held)
        return MarkedPose(force=self.force(take.load), ties=ties, displacement=take.displacement)

    def fit(
        self, takes: Sequence[SettledTake], poisson: float = POISSON, start: tuple[float, np.ndarray] | None = None
    ) -> ModulusFit:
        """One modulus for the takes."""
        poses = [self.pose(take) for take in takes]
        return identify_modulus(self.cloud, poses, fixed=self.fixed, poisson=poisson, start=start)

    def predict(self, takes: Sequence[SettledTake], fit: ModulusFit, start: Mapping[float, np.ndarray]) -> np.ndarray:
        """Marker displacements (T, 3, 3) [m] of takes at the fitted modulus; start: load [N] -> state (N, 3) [m]."""
        force, first = np.stack([self.force(load) for load in start]), np.stack(list(start.values()))
        y = settle(self.cloud, force, fixed=self.fixed, young=fit.young, poisson=fit.poisson, start=first)
        state = dict(zip(start, y, strict=True))
        return carried([self.pose(take) for take in takes], np.stack([state[t.load] for t in takes]) - self.cloud.x)


@dataclass(frozen=True, kw_only=True)
class CloudFit:
    """The joint fit on one cloud."""

    points: int
    spacing: float  # [m]
    young: float  # [Pa]


@dataclass(frozen=True, kw_only=True, eq=False)
class BeamResult:
    """The beam's modulus, how it came about, and what it predicts for takes it has not seen."""

    takes: Mapping[str, SettledTake]
    train: tuple[str, ...]  # names of the takes that `joint` was fitted to
    model: BeamModel  # the finest
    joint: ModulusFit  # on the finest cloud
    young: Interval  # [Pa], at zero spacing
    refinement: tuple[CloudFit, ...]  # coarsest first
    single: Mapping[str, float]  # E [Pa] of each take alone, on the finest cloud
    predicted: Mapping[str, Mapping[str, np.ndarray]]  # fitted to -> take -> marker displacements (3, 3) [m]
    slope_error: float  # of the sensitivity against finite differences, on the coarsest cloud
    seconds: float

    @property
    def factor(self) -> float:
        """What turns a modulus on the finest cloud into one at zero spacing."""
        return self.young.value / self.joint.young


def identify_beam(
    takes: Mapping[str, SettledTake], *, clouds: Mapping[int, int] = CLOUDS, poisson: float = POISSON
) -> BeamResult:
    """Fit the `a` takes together on ever finer clouds, then each take alone, and predict across takes and loads.

    clouds: points -> how many random clouds of that many points.
    """
    began = time.perf_counter()
    train = tuple(name for name in takes if name.endswith("_a")) or tuple(takes)
    used, refinement = [takes[name] for name in train], []
    for count, seed in [(n, seed) for n in sorted(clouds) for seed in range(clouds[n])]:
        model = BeamModel.of(count, seed)
        joint = model.fit(used, poisson)
        if not refinement:
            slope_error = slope_check(model.cloud, [model.pose(take) for take in used], joint, model.fixed)
        refinement.append(CloudFit(points=count, spacing=model.cloud.spacing, young=joint.young))
    states = {take.load: y for take, y in zip(used, joint.y, strict=True)}
    known = [take for take in takes.values() if take.load in states]
    fits = {take.name: model.fit([take], poisson, (joint.young, states[take.load][None])) for take in known}
    limit, discretisation = refined_limit([c.spacing for c in refinement], [c.young for c in refinement])
    parts = _parts(model, used, joint, fits) | {"discretisation": discretisation}
    predicted = {
        name: dict(zip([take.name for take in known], model.predict(known, fit, states), strict=True))
        for name, fit in ({"all": joint} | {name: fits[name] for name in train}).items()
    }
    return BeamResult(
        takes=takes, train=train, model=model, joint=joint, young=Interval(value=limit, parts=parts),
        refinement=tuple(refinement), single={name: fit.young for name, fit in fits.items()}, predicted=predicted,
        slope_error=slope_error, seconds=time.perf_counter() - began,
    )  # fmt: skip


def _parts(
    model: BeamModel, used: Sequence[SettledTake], joint: ModulusFit, fits: Mapping[str, ModulusFit]
) -> dict[str, float]:
    """Relative standard uncertainties of E other than the discretisation's."""
    log_young = {name: float(np.log(fit.young)) for name, fit in fits.items()}
    pairs = [(take.name, take.name[:-2] + "_b") for take in used]
    repeats = [log_young[a] - log_young[b] for a, b in pairs if a != b and b in log_young]
    return {
        "repeats": float(np.sqrt(np.mean(np.square(repeats)) / 2)) if repeats else 0.0,
        "between loads": float(np.ptp([log_young[take.name] for take in used]) / 2),
        "marker placement": placement_sd(model.cloud, [model.pose(take) for take in used], joint, PLACEMENT),
        "straightness when held": abs(joint.influence(np.array([0, 0, STRAIGHTNESS]))),
        "tilt of the base": abs(joint.influence(np.array([0, 0, PITCH * SIZE[0]]))),
    }
