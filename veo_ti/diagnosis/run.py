"""The diagnosis from start to end: baseline, noise, misfit, scores, refits, verdict, gain, and a second cause."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.basis import Basis
from sim.evidence import design_effect
from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.columns import Direction, directions_of, discretisation
from veo_ti.diagnosis.experiment import Experiment, separating
from veo_ti.diagnosis.gain import Gain, measure_gain
from veo_ti.diagnosis.model import Model, Refit
from veo_ti.diagnosis.moments import moments, moments_of
from veo_ti.diagnosis.noise import Noise, measure_noise
from veo_ti.diagnosis.refit import refit
from veo_ti.diagnosis.scene import Scene
from veo_ti.diagnosis.score import Misfit, Score, Statistics, score
from veo_ti.diagnosis.verdict import MISFIT, TESTABLE, Candidate, Verdict, judge, stands, unexplained
from veo_ti.identification import Identification

SMOOTH = 12  # spatial modes in which misfit is looked for
BLOCKS = 8  # of training frames
_LEADERS = 3  # causes that are refitted
_FAIR = 0.2  # share of the best score that a leader must reach
_CLOSER = 0.7  # share of the variance that a cause must leave to be worth a second fit

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Round:
    """One look for a cause: what was wrong, every score, the refitted leaders, the verdict."""

    misfit: Misfit
    scores: tuple[Score, ...]  # best first
    candidates: tuple[Candidate, ...]  # best first
    verdict: Verdict
    experiment: Experiment | None = None  # what would tell apart those that are ambiguous


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
    prior = np.concatenate([basis.prior(state.length, state.amplitude), np.ones(len(extra))])
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
        left = measure_noise(current.taken_in().scene, modes)
        noise = replace(noise, correlation=min(noise.correlation, left.correlation))
        floor = noise.variance
        model = replace(model, s2=_counted(current.taken_in().scene, noise, modes))
        if not second or len(rounds) == 2:
            break
        open_causes = [cause for cause in open_causes if cause.name != current.cause.name]
    named = [r.verdict.causes[0] for r in rounds if r.verdict.kind == "named"]
    if named and not stands(named):
        rounds, current = [replace(rounds[0], verdict=unexplained(named[:1]))], baseline
    return Diagnosis(
        identification=identification, noise=noise, baseline=baseline, final=current, rounds=tuple(rounds),
        untestable={name: reason for name, reason in reasons.items() if reason}, seconds=time.perf_counter() - began,
        gain=measure_gain(
            scene.target, scene.train, sigma=noise.sigma,
            models={
                "before": baseline.shown, "homogeneous": identification.baseline.y,
                "after": current.shown + (scene.target.y - current.scene.target.y), "no_change": identification.rest.y,
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
    current = current.taken_in()
    say("fingerprints of all causes")
    statistics, scores = scores_of(current, model, modes, causes)
    misfit = replace(statistics, s2=floor).misfit()
    if misfit.z < MISFIT:
        return Round(misfit=misfit, scores=scores, candidates=(), verdict=judge(misfit, ()))
    tried = [_tried(s, current, model, modes, say) for s in _leaders(scores)]
    # All are weighed at the noise that the best of them leaves: what it explains was no noise.
    s2 = min([model.s2, *(own.s2 for _, own in tried)])
    floor = min([floor, *(measure_noise(result.taken_in().scene, modes).variance for result, _ in tried)])
    before = statistics_of(current, replace(model, s2=floor), modes).misfit()
    candidates = [_candidate(result, current, replace(model, s2=floor), s2, modes, before) for result, _ in tried]
    candidates.sort(key=lambda c: -c.gained)
    verdict, experiment = judge(misfit, candidates), None
    if verdict.kind == "ambiguous":
        say("what would tell them apart")
        first, second = (c.refit for c in verdict.causes[:2])
        experiment = separating(current, first, second, model, s2)
    return Round(misfit=misfit, scores=scores, candidates=tuple(candidates), verdict=verdict, experiment=experiment)


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
        scene, model.basis, current.around[:K], model.extra, directions,
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
    return [s for s in scores if s.log_bayes > least and s.keep > TESTABLE][:_LEADERS]


def _tried(found: Score, current: Refit, model: Model, modes: np.ndarray, say: Progress) -> tuple[Refit, Model]:
    """The cause refitted, once more where it leaves less than was taken for noise, and the model with that noise."""
    say(f"refit with {found.name}")
    shift = found.nuisances - current.coefficients
    result = refit(
        current.scene, model, current.coefficients, cause=found.cause, place=found.place, theta=found.theta, shift=shift
    )
    left = result.taken_in().scene
    closer = replace(model, s2=_counted(left, measure_noise(left, modes), modes))
    if closer.s2 > _CLOSER * model.s2:
        return result, model
    say(f"closer look at {found.name}")
    again = refit(result.without, closer, result.coefficients, cause=found.cause, place=found.place, theta=result.theta)
    left = again.taken_in().scene
    return again, replace(model, s2=min(closer.s2, _counted(left, measure_noise(left, modes), modes)))


def _candidate(result: Refit, current: Refit, model: Model, s2: float, modes: np.ndarray, before: Misfit) -> Candidate:
    """What a refitted cause gains at the variance s2, and what is left of the misfit at the model's."""
    left = statistics_of(result, model, modes).misfit()
    predicted = (current.left_out(s2, BLOCKS) - result.left_out(s2, BLOCKS)) / (2 * s2)
    return Candidate(
        refit=result, gained=result.evidence(s2) - current.evidence(s2), predicted=predicted, misfit=left,
        explained=1 - left.excess / max(before.excess, 1e-300), plausible=result.cause.plausible(result.theta),
    )  # fmt: skip


def statistics_of(result: Refit, model: Model, modes: np.ndarray) -> Statistics:
    """The nuisances and the smooth modes against what a refit leaves, with its own fingerprints."""
    taken, K = result.taken_in(), model.basis.log_mu.shape[1]
    residual = taken.scene.target.residual(taken.simulated) * taken.scene.train[:, None, None]
    found = moments_of(result.kept, result.around[:K], len(model.extra), residual, taken.scene.target.seen, modes)
    return Statistics(moments=found, s2=model.s2, prior=model.prior)
