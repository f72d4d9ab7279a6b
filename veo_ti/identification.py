"""From a measurement to a virtual elastic object: homogeneous baseline, material field, held-out error."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path

import numpy as np

from sim.basis import FitOptions
from sim.cloud import CloudOptions, RestCloud
from sim.energy import Energy
from sim.fit import Fit, FitState, check_gradient, fit, guess_modulus
from sim.target import Target
from veo_ti.checkpoint import read_state, write_state
from veo_ti.evaluation import Evaluation, judged, unmoved
from veo_ti.held_out import interval
from veo_ti.kept import kept, key_of
from veo_ti.object import VirtualElasticObject
from veo_ti.observation import Observation
from veo_ti.scene import cloud_of, energy_of, target_of
from veo_ti.stream import Stream, as_wide, find_footprint, unmeasured

_FEW = 12  # frames on which one homogeneous material is found before all are taken
Progress = Callable[[str, FitState], None]


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions:
    """fit: the material field; cloud: the discretisation; every: one frame in so many is held out, in blocks."""

    fit: FitOptions = field(default_factory=FitOptions)
    cloud: CloudOptions = field(default_factory=CloudOptions)
    every: int = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification:
    """A learnt object with the evidence for and against it.

    The three evaluations cover all frames; held_out frames were never used to choose anything.
    """

    observation: Observation
    options: IdentifyOptions
    energy: Energy  # loads and supports of all frames, with the learnt material
    object: VirtualElasticObject
    fit: Fit
    homogeneous: Fit
    model: Evaluation
    baseline: Evaluation  # the homogeneous material
    rest: Evaluation  # no motion at all
    train: np.ndarray  # frame indices
    held_out: np.ndarray
    gradient_error: float
    seconds: float
    stream: Stream | None = None  # how wide an air stream is that nobody measured

    @property
    def key(self) -> str:
        """A fingerprint of everything that it depends on."""
        return _key(self.observation, self.options)

    @property
    def metrics(self) -> dict[str, object]:
        """The numbers of `metrics.json`."""
        errors = {name: self._tables(part) for name, part in self._evaluations.items()}
        lame = self.object.lame
        return {
            "error_mm": errors["model"], "error_mm_homogeneous": errors["homogeneous"],
            "error_mm_no_change": errors["no_change"],
            "gained_mm": {"over_homogeneous": self._gained(self.baseline), "over_no_change": self._gained(self.rest)},
            "rms_per_coordinate_mm": {
                name: {"training": part.rms_mm(self.train), "held_out": _or_none(part.rms_mm, self.held_out)}
                for name, part in self._evaluations.items()
            },
            "noise_mm": 1e3 * self.fit.state.sigma, "noise_given": self.model.target.sigma is not None,
            "gradient_check": self.gradient_error,
            "iterations": len(self.fit.state.objective) - 1, "seconds": self.seconds,
            "status": self.fit.sentence + ("" if self.stream is None else self.stream.sentence),
            "mu_pa": _spread(lame.mu), "lam_pa": _spread(lame.lam), "young_pa": _spread(lame.young),
            "poisson": _spread(lame.poisson), "log_mu_mean_sd": self.fit.mean_sd,
            "log_mu_sd": _spread(self.fit.log_mu_sd), "determined": _spread(self.fit.determined),
            "log_mu_sd_of_discretisation": _spread(self.fit.resolution_sd),
            "homogeneous_young_pa": float(self.homogeneous.lame.young[0]),
            "force_scale_known": self.object.force_scale_known,
            "footprint_mm": None if self.observation.jet is None else 1e3 * self.observation.jet.footprint, "frames": {
                "training": self.train.tolist(), "held_out": self.held_out.tolist(),
                "not_converged": np.flatnonzero(~self.model.converged).tolist(),
            },
        }  # fmt: skip

    @property
    def _evaluations(self) -> dict[str, Evaluation]:
        return {"model": self.model, "homogeneous": self.baseline, "no_change": self.rest}

    def _gained(self, other: Evaluation) -> dict[str, float] | None:
        """By how much the mean held-out distance is smaller than another model's, with a 95 % interval."""
        held = self.held_out[self.model.target.seen[self.held_out].any(axis=1)]
        if not len(held):
            return None

        def gained(frames: np.ndarray) -> float:
            return other.mean_mm(frames) - self.model.mean_mm(frames)

        low, high = interval(gained, held)
        return {"mean": gained(held), "low": low, "high": high}

    def _tables(self, part: Evaluation) -> dict[str, object]:
        return {"training": _table(part, self.train), "held_out": _table(part, self.held_out)}


def identify(
    observation: Observation,
    *,
    options: IdentifyOptions | None = None,
    checkpoints: Path | None = None,
    progress: Progress | None = None,
) -> Identification:
    """Learn per-point Lame parameters from a measurement and judge them on frames that were held out.

    checkpoints: a folder where the state after every step is kept; an interrupted call goes on from there when the
    measurement and the options are the same. progress(stage, state) is called after every step.
    """
    began, options = time.perf_counter(), options or IdentifyOptions()
    cloud, key = cloud_of(observation, options.cloud), _key(observation, options)
    train, held_out = observation.split(options.every)
    few = np.unique(np.linspace(0, len(train) - 1, _FEW).astype(int))
    stream = None
    if unmeasured(observation):
        stream = _stream(observation.frames(train[few]), cloud, options, checkpoints, key, progress)
        observation = as_wide(observation, stream.footprint)
    energy, target = energy_of(observation, cloud), target_of(observation)
    stage = _Stage(energy.frames(train), target.frames(train), checkpoints, key, progress)
    rest = np.repeat(cloud.x[None], len(train), axis=0)
    mu = guess_modulus(stage.energy, stage.target)
    rough = stage.frames(few).run("rough", rest[few], mu, options.fit.homogeneous)
    homogeneous = stage.run("homogeneous", rest, mu, options.fit.homogeneous, rough.state.a)
    learnt = stage.run("field", homogeneous.state.y, float(homogeneous.lame.mu[0]), options.fit)
    obj = _object(observation, cloud, learnt, options)
    return Identification(
        observation=observation, options=options, energy=_with(energy, learnt), object=obj, fit=learnt,
        homogeneous=homogeneous,
        model=_everywhere(observation, energy, learnt, train),
        baseline=_everywhere(observation, energy, homogeneous, train),
        rest=unmoved(cloud.x, target), train=train, held_out=held_out,
        gradient_error=check_gradient(stage.energy, stage.target, learnt), seconds=time.perf_counter() - began,
        stream=stream,
    )  # fmt: skip


@dataclass(frozen=True)
class _Stage:
    """What the fits of one identification share."""

    energy: Energy
    target: Target
    folder: Path | None
    key: str
    progress: Progress | None

    def frames(self, index: np.ndarray) -> "_Stage":
        return replace(self, energy=self.energy.frames(index), target=self.target.frames(index))

    def run(
        self, name: str, start: np.ndarray, mu: float, options: FitOptions, guess: np.ndarray | None = None
    ) -> Fit:
        path = self.folder / f"checkpoint_{name}.npz" if self.folder else None
        state = read_state(path, self.key) if path else None

        def after(state: FitState) -> None:
            if path:
                write_state(path, self.key, state)
            if self.progress:
                self.progress(name, state)

        return fit(
            self.energy, self.target, start, mu=mu, options=options, guess=guess, state=state, progress=after
        )


def _stream(
    observation: Observation, cloud: RestCloud, options: IdentifyOptions, folder: Path | None, key: str,
    progress: Progress | None,
) -> Stream:  # fmt: skip
    """The width of an air stream that nobody measured; kept like the fits, for a call that goes on from there."""

    def find() -> dict[str, np.ndarray]:
        after = partial(progress, "stream") if progress else None
        found = find_footprint(observation, cloud, options.fit, after)
        return {"footprint": np.array(found.footprint), "change": np.array(found.change)}

    found = kept(folder / "checkpoint_stream.npz", key, find) if folder else find()
    return Stream(footprint=float(found["footprint"]), change=float(found["change"]))


def _everywhere(observation: Observation, energy: Energy, result: Fit, train: np.ndarray) -> Evaluation:
    """The fitted material on every frame; held-out frames start from the nearest training frame's solution."""
    frames = np.arange(len(observation.time))
    near = np.abs(train[None] - frames[:, None]).argmin(axis=1)
    return judged(observation, _with(energy, result), result.equilibrium.y[near])


def _with(energy: Energy, result: Fit) -> Energy:
    m = np.stack([result.lame.mu, result.lame.lam], axis=1)
    return energy.with_elastic(energy.elastic.with_parameters(m))


def _object(observation: Observation, cloud: RestCloud, result: Fit, options: IdentifyOptions) -> VirtualElasticObject:
    return VirtualElasticObject(
        x=cloud.x, lame=result.lame, volume=cloud.volume, fixed=observation.fixed, surface=cloud.surface,
        determined=result.determined, mass=observation.mass, gravity=observation.gravity,
        force_scale_known=observation.force_scale_known, options=options.cloud, name=observation.name,
        footprint=observation.jet.footprint if unmeasured(observation) else None, up=observation.up,
    )  # fmt: skip


def _key(observation: Observation, options: IdentifyOptions) -> str:
    """A fingerprint of everything the result depends on."""
    given = {f.name: getattr(observation, f.name) for f in fields(observation)}
    jet = given.pop("jet")
    blown = () if jet is None else (getattr(jet, f.name) for f in fields(jet))
    return key_of(options, *given.values(), *blown)


def _table(part: Evaluation, frames: np.ndarray) -> dict[str, float] | None:
    if not len(frames) or not part.target.seen[frames].any():
        return None
    table = part.table(frames)
    return {"mean": table.mean_mm, "p95": table.p95_mm, "max": table.max_mm}


def _or_none(number: Callable[[np.ndarray], float], frames: np.ndarray) -> float | None:
    return number(frames) if len(frames) else None


def _spread(values: np.ndarray) -> dict[str, float]:
    p5, median, p95 = np.quantile(values, (0.05, 0.5, 0.95)).tolist()
    return {"min": float(values.min()), "p5": p5, "median": median, "p95": p95, "max": float(values.max())}
