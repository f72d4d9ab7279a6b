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
from veo_ti.body import Body, sample_box, tie_markers
from veo_ti.markers import Interval, MarkedPose, ModulusFit, identify_modulus, predict_poses, refined_limit
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
COUNTS = (1000, 2000, 4000)

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
    """The straight beam as points, with its clamp and loads."""

    body: Body

    @classmethod
    def of(cls, count: int, seed: int = 0) -> "BeamModel":
        """A beam of `count` points."""
        return cls(body=sample_box(SIZE, count, corner=CORNER, seed=seed))

    @property
    def fixed(self) -> np.ndarray:
        """The clamped face, (N,) bool."""
        return self.body.x[:, 0] <= CORNER[0] + 1e-9

    def force(self, load: float) -> np.ndarray:
        """Gravity on every point and a weight [N] spread evenly along the upper tip edge, (N, 3) [N]."""
        x, out = self.body.x, np.zeros_like(self.body.x)
        out[:, 2] = -DENSITY * GRAVITY * self.body.volume
        edge = np.flatnonzero((x[:, 0] >= -1e-9) & (x[:, 2] >= SIZE[2] - 1e-9))
        edge = edge[np.argsort(x[edge, 1])]
        half = np.diff(x[edge, 1]) / 2
        out[edge, 2] -= load * (np.append(half, 0) + np.insert(half, 0, 0)) / SIZE[1]
        return out

    def pose(self, take: SettledTake) -> MarkedPose:
        """A take's pose with its markers tied where they sat on the straight beam."""
        ties = tie_markers(self.body.x, take.held)
        return MarkedPose(force=self.force(take.load), ties=ties, displacement=take.displacement)

    def fit(
        self, takes: Sequence[SettledTake], poisson: float = POISSON, start: tuple[float, np.ndarray] | None = None
    ) -> ModulusFit:
        """One modulus for the takes."""
        poses = [self.pose(take) for take in takes]
        return identify_modulus(self.body, poses, fixed=self.fixed, poisson=poisson, start=start)

    def drops_mm(self, takes: Sequence[SettledTake], fit: ModulusFit, start: Mapping[str, np.ndarray]) -> dict[str, float]:
        """Predicted mean tip drop [mm] of each take at the fitted modulus; start: a state (N, 3) for each loading."""
        poses, first = [self.pose(take) for take in takes], np.stack([start[take.kind] for take in takes])
        moved = predict_poses(
            self.body, poses, fixed=self.fixed, young=fit.young, poisson=fit.poisson, start=first
        )
        return {take.name: 1e3 * float(u[:, 2].mean()) for take, u in zip(takes, moved, strict=True)}


@dataclass(frozen=True, kw_only=True, eq=False)
class BeamResult:
    """The beam's modulus, how it came about, and what it predicts for takes it has not seen."""

    takes: Mapping[str, SettledTake]
    model: BeamModel  # the finest
    young: Interval  # [Pa], at zero spacing
    refinement: Mapping[int, tuple[float, float]]  # points -> spacing [m], E [Pa] of the joint fit
    joint: ModulusFit  # of the training takes, on the finest cloud
    train: tuple[str, ...]
    single: Mapping[str, float]  # E [Pa] of each take alone on the finest cloud
    drops_mm: Mapping[str, Mapping[str, float]]  # fitted to -> take -> predicted tip drop [mm]
    seconds: float

    @property
    def factor(self) -> float:
        """What turns a modulus on the finest cloud into one at zero spacing."""
        return self.young.value / self.joint.young


def identify_beam(
    takes: Mapping[str, SettledTake], *, counts: Sequence[int] = COUNTS, poisson: float = POISSON
) -> BeamResult:
    """Fit the `a` takes together on clouds of growing size, then each take alone, and predict across takes and loads."""
    began = time.perf_counter()
    train = tuple(name for name in takes if name.endswith("_a")) or tuple(takes)
    used, refinement = [takes[name] for name in train], {}
    for count in sorted(counts):
        model = BeamModel.of(count)
        joint = model.fit(used, poisson)
        refinement[count] = (model.body.spacing, joint.young)
    states = {take.kind: y for take, y in zip(used, joint.y, strict=True)}
    known = [take for take in takes.values() if take.kind in states]
    fits = {take.name: model.fit([take], poisson, (joint.young, states[take.kind][None])) for take in known}
    limit, discretisation = refined_limit(*zip(*refinement.values(), strict=True))
    parts = _parts(joint, fits, train) | {"discretisation": discretisation}
    chosen = {"both a takes": joint} | {name: fits[name] for name in train}
    return BeamResult(
        takes=takes, model=model, young=Interval(value=limit, parts=parts), refinement=refinement, joint=joint,
        train=train, single={name: fit.young for name, fit in fits.items()},
        drops_mm={name: model.drops_mm(known, fit, states) for name, fit in chosen.items()},
        seconds=time.perf_counter() - began,
    )  # fmt: skip


def _parts(joint: ModulusFit, fits: Mapping[str, ModulusFit], train: Sequence[str]) -> dict[str, float]:
    """Relative standard uncertainties of E other than the discretisation's."""
    log_young = {name: float(np.log(fit.young)) for name, fit in fits.items()}
    repeats = [log_young[n] - log_young[n[:-2] + "_b"] for n in train if n[:-2] + "_b" in log_young]
    alone = [log_young[name] for name in train]
    lever = joint.predicted[..., 0] * 0 + SIZE[0]
    tilt = np.stack([0 * lever, 0 * lever, -PITCH * lever], axis=-1)
    return {
        "repeats": float(np.sqrt(np.mean(np.square(repeats)) / 2)) if repeats else 0.0,
        "between loads": float(np.ptp(alone) / 2),
        "marker placement": _placement(joint),
        "straightness when held": abs(joint.influence(np.array([0, 0, STRAIGHTNESS]))),
        "tilt of the base": abs(joint.influence(tilt)),
    }
