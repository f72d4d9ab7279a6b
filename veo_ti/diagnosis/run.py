"""The diagnosis from start to end: baseline, noise, misfit, scores, refits, verdict, gain, and a second cause."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.basis import Basis
from sim.evidence import design_effect
from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.columns import Direction, directions_of, discretisation, moments
from veo_ti.diagnosis.gain import Gain, measure_gain
from veo_ti.diagnosis.noise import Noise, measure_noise
from veo_ti.diagnosis.refit import Model, Refit, refit
from veo_ti.diagnosis.scene import Scene
from veo_ti.diagnosis.score import Misfit, Score, Statistics, score
from veo_ti.diagnosis.verdict import MISFIT, Candidate, Verdict, judge
from veo_ti.identification import Identification

SMOOTH = 12  # spatial modes in which misfit is looked for
BLOCKS = 8  # of training frames
_DISCRETISATION = 0.3  # how much of the step to another discretisation ours may be off by
_LEADERS = 3  # causes that are refitted
_FAIR = 0.2  # share of the best score that a leader must reach

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Round:
    """One look for a cause: what was wrong, every score, the refitted leaders, the verdict."""

    misfit: Misfit
    scores: tuple[Score, ...]  # best first
    candidates: tuple[Candidate, ...]  # best first
    verdict: Verdict


@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnosis:
    """What the simulation gets wrong, and how sure that is."""

    identification: Identification
    noise: Noise
    baseline: Refit  # before any cause
    final: Refit  # with the named causes; the baseline where there are none
    rounds: tuple[Round, ...]
    untestable: dict[str, str]  # cause -> why
    gain: Gain | None
    seconds: float

    @property
    def verdict(self) -> Verdict:
        """The first round's verdict."""
        return self.rounds[0].verdict

    @property
    def named(self) -> tuple[Candidate, ...]:
        """The causes that were named, in order."""
        return tuple(r.verdict.causes[0] for r in self.rounds if r.verdict.kind == "named")


def diagnose(
    identification: Identification, causes: Sequence[Cause], *, second: bool = True, progress: Progress | None = None
) -> Diagnosis:
    """Find what an identified object's simulation gets wrong.

    second: after a cause was named, look for another in what is left.
    """
    began, say = time.perf_counter(), progress or (lambda text: None)
    scene, basis = _scene(identification)
    modes = basis.field.modes[:, :SMOOTH]
    say("noise")
    noise = measure_noise(scene, modes)
    seen = scene.target.seen & ~noise.stray
    scene = replace(scene, target=replace(scene.target, seen=seen, sigma=noise.sigma))
    state = identification.fit.state
    say("discretisation")
    extra = discretisation(scene)
    prior = np.concatenate([basis.prior(state.length, state.amplitude), np.full(len(extra), _DISCRETISATION**2)])
    model = Model(basis=basis, prior=prior, s2=_counted(scene, noise, modes), extra=extra)
    say("baseline")
    start = np.concatenate([state.a, np.zeros(len(extra))])
    baseline = refit(scene, model, start)
    floor = noise.variance
    reasons = {cause.name: cause.untestable(scene) for cause in causes}
    open_causes = [cause for cause in causes if reasons[cause.name] is None]
    rounds, current = [], baseline
    while True:
        rounds.append(_round(current, model, floor, modes, open_causes, say))
        verdict = rounds[-1].verdict
        if verdict.kind != "named":
            break
        current = verdict.causes[0].refit
        left = measure_noise(_taken_in(current).scene, modes)
        noise = replace(noise, correlation=min(noise.correlation, left.correlation))
        floor = noise.variance
        model = replace(model, s2=_counted(_taken_in(current).scene, noise, modes))
        say(f"closer look at {current.cause.name}")
        current = refit(
            current.without, model, current.coefficients, cause=current.cause, place=current.place, theta=current.theta
        )
        if not second or len(rounds) == 2:
            break
        open_causes = [cause for cause in open_causes if cause.name != current.cause.name]
    return Diagnosis(
        identification=identification, noise=noise, baseline=baseline, final=current, rounds=tuple(rounds),
        untestable={name: reason for name, reason in reasons.items() if reason}, seconds=time.perf_counter() - began,
        gain=measure_gain(
            scene.target, scene.train, sigma=noise.sigma,
            models={
                "before": baseline.shown, "after": current.shown, "homogeneous": identification.baseline.y,
                "no_change": identification.rest.y,
            },
        ),
    )  # fmt: skip


def _scene(found: Identification) -> tuple[Scene, Basis]:
    """The identified object on all frames, and the basis its material is written in."""
    target, energy = found.model.target, found.energy
    train = np.zeros(len(target.y), bool)
    train[found.train] = True
    target = replace(target, seen=target.seen & found.model.converged[:, None])
    basis = Basis.of(energy.elastic.cloud, found.options.fit, float(np.exp(found.fit.centre)))
    scene = Scene(observation=found.observation, energy=energy, y=found.model.y, target=target, train=train)
    return scene, basis


def _counted(scene: Scene, noise: Noise, modes: np.ndarray) -> float:
    """The variance at which residuals count [m2]: the noise's, or that of the whole residual while it is larger.

    Where the model is wrong, the material would else be bent far beyond its linearisation to imitate what is missing.
    """
    r, seen = scene.residual * scene.train[:, None, None], scene.target.seen & scene.train[:, None]
    square = float((r**2).sum() / (3 * seen.sum()))
    return max(noise.variance, square * design_effect(r, seen, modes))


def _round(
    current: Refit, model: Model, floor: float, modes: np.ndarray, causes: Sequence[Cause], say: Progress
) -> Round:
    """floor: the variance of the noise, by which misfit is judged; the model's own weighs the causes."""
    current = _taken_in(current)
    say("fingerprints of all causes")
    statistics, scores = scores_of(current, model, modes, causes)
    misfit = replace(statistics, s2=floor).misfit()
    if misfit.z < MISFIT:
        return Round(misfit=misfit, scores=scores, candidates=(), verdict=judge(misfit, ()))
    candidates = [_candidate(s, current, model, floor, modes, misfit, say) for s in _leaders(scores)]
    candidates.sort(key=lambda c: -c.gained)
    return Round(misfit=misfit, scores=scores, candidates=tuple(candidates), verdict=judge(misfit, candidates))


def _taken_in(current: Refit) -> Refit:
    """A refit whose effect on the observation is taken out of the observation, so that the next cause stands alone."""
    scene = current.scene
    target = replace(scene.target, y=scene.target.y - (current.simulated - scene.y))
    return replace(current, scene=replace(scene, target=target), cause=None, theta=np.zeros(0), sd=np.zeros(0))


def scores_of(
    current: Refit, model: Model, modes: np.ndarray, causes: Sequence[Cause]
) -> tuple[Statistics, tuple[Score, ...]]:
    """Every cause's score at a state, best first; the parameters of a cause named before count as nuisances there."""
    scene = current.scene
    directions: list[Direction] = []
    table = []
    for cause in causes:
        places = list(cause.places(scene))
        columns = []
        for place in places:
            made = directions_of(cause, scene, place)
            columns.append(range(len(directions), len(directions) + len(made)))
            directions += made
        table.append((cause, places, np.array(columns)))
    K = model.basis.log_mu.shape[1]
    train = np.flatnonzero(scene.train)
    blocks = np.full(len(scene.time), -1)
    blocks[train] = np.arange(len(train)) * BLOCKS // len(train)
    found = moments(
        scene, model.basis, current.coefficients[:K], model.extra, directions,
        residual=scene.target.residual(current.simulated), modes=modes, blocks=blocks,
    )  # fmt: skip
    statistics = Statistics(moments=found, s2=model.s2, prior=model.prior)
    scores = [
        score(statistics, cause, cause.widths(scene), places, columns + found.nuisances)
        for cause, places, columns in table
    ]
    return statistics, tuple(sorted(scores, key=lambda s: -s.log_bayes))


def _leaders(scores: Sequence[Score]) -> list[Score]:
    least = max(1.5, _FAIR * scores[0].log_bayes)
    return [s for s in scores[:_LEADERS] if s.log_bayes > least]


def _candidate(
    found: Score, current: Refit, model: Model, floor: float, modes: np.ndarray, misfit: Misfit, say: Progress
) -> Candidate:
    """The cause refitted, and what is left of the misfit under it."""
    say(f"refit with {found.name}")
    result = refit(
        current.scene, model, current.coefficients, cause=found.cause, place=found.place, theta=found.theta
    )
    statistics = scores_of(result, model, modes, ())[0]
    left = replace(statistics, s2=floor).misfit()
    # What the cause explains no longer passes for correlated noise.
    sharper = min(floor, measure_noise(_taken_in(result).scene, modes).variance)
    positive = np.array([p.positive for p in found.cause.parameters])
    return Candidate(
        refit=result, gained=result.evidence - current.evidence, misfit=replace(statistics, s2=sharper).misfit(),
        explained=1 - left.excess / max(misfit.excess, 1e-300),
        plausible=bool((result.theta[positive] > 0).all()),
    )  # fmt: skip
