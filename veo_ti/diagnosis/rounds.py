"""One look for a cause: every cause scored, the leaders refitted, the verdict on them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim.evidence import design_effect
from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.causes.beside import Beside
from veo_ti.diagnosis.columns import Direction, directions_of
from veo_ti.diagnosis.experiment import Experiment, separating
from veo_ti.diagnosis.model import Model, Refit
from veo_ti.diagnosis.moments import moments, moments_of
from veo_ti.diagnosis.noise import Noise, measure_noise
from veo_ti.diagnosis.placing import better_place
from veo_ti.diagnosis.refit import refit
from veo_ti.diagnosis.scene import Scene
from veo_ti.diagnosis.score import Misfit, Score, Statistics, score
from veo_ti.diagnosis.verdict import (
    EXPLAINED,
    MISFIT,
    SURVIVES,
    TESTABLE,
    TOGETHER,
    Candidate,
    Verdict,
    judge,
    nothing,
    stands,
)
from veo_ti.diagnosis.visible import Left, least_visible

SHORT = 0.1  # of what a cause gains, that its refit may still promise
BLOCKS = 8  # of training frames
_LEAST = 1.5  # nats that a score must reach for a refit
_FAIR = (0.0, 0.2, 0.6, 0.75, 0.85)  # share of the best score that the first, second, third ... must reach
_CLOSER = 0.7  # share of the variance that a cause must leave to be worth a second fit, and
_LOOKS = 3  # at most that a cause gets, each
WORTH = 5.0  # nats of evidence, that another prior of the material must bring
_MOVES = 3  # of a cause's place after its refit
_IN_REACH = 2.0  # times the least that any leaves

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Round:
    """One look for a cause: what was wrong, every score, the refitted leaders, the verdict.

    extended: the model with what was named; where several could be what a named cause leaves, with the likeliest.
    """

    misfit: Misfit
    scores: tuple[Score, ...]  # best first
    candidates: tuple[Candidate, ...]  # best first
    verdict: Verdict
    s2: float  # variance [m2] at which the candidates were weighed
    extended: Refit | None = None
    experiment: Experiment | None = None  # what would tell apart those that are ambiguous


def counted(scene: Scene, noise: Noise, modes: np.ndarray) -> float:
    """The variance at which residuals count [m2]: the noise's, or that of the whole residual while it is larger.

    Where the model is wrong, the material would else be bent far beyond its linearisation to imitate what is missing.
    """
    r, seen = scene.residual * scene.train[:, None, None], scene.target.seen & scene.train[:, None]
    square = float((r**2).sum() / (3 * seen.sum()))
    return max(noise.variance, square * design_effect(r, seen, modes))


def look(
    current: Refit, model: Model, floor: float, modes: np.ndarray, causes: Sequence[Cause], say: Progress, *,
    even: bool = False, shadow: bool = False,
) -> Round:  # fmt: skip
    """Look for a cause beside what `current` holds: nothing, or a cause whose parameters then stay free.

    floor: the variance of the noise, by which misfit is judged; the model's own weighs the causes; even: whether
    what is wrong goes on evenly, as noise does; shadow: whether `current` explains most already, so that what is left
    may be its own shadow: only a cause that little can imitate, and that explains nearly all of it, is then named.
    """
    taken = current.taken_in()
    say("fingerprints of all causes")
    statistics, scores = scores_of(taken, model, floor, modes, [(c, list(c.places(taken.scene))) for c in causes])
    misfit = replace(statistics, s2=floor).misfit()
    quiet = Round(misfit=misfit, scores=scores, candidates=(), verdict=nothing(), s2=model.s2)
    if misfit.z < MISFIT:
        return quiet
    left = Left.by(taken, model.s2, modes)
    if not left.visible:
        return quiet
    if even and left.like_noise:
        return replace(quiet, verdict=nothing(even=True))
    leaders = _narrowed(_leaders(scores, SURVIVES if shadow else TESTABLE), taken, model, floor, modes, say)
    tried, s2 = _tried(leaders, current, model, modes, say)
    floor = min([floor, *(measure_noise(result.taken_in().scene, modes).variance for result in tried)])
    before = statistics_of(current, replace(model, s2=floor), modes).misfit()
    candidates = [_candidate(result, current, replace(model, s2=floor), s2, modes, before) for result in tried]
    candidates.sort(key=lambda c: -c.gained)
    verdict, experiment = judge(misfit, candidates, least=TOGETHER if shadow else EXPLAINED), None
    explained = verdict.kind == "ambiguous" or (verdict.kind == "named" and stands(verdict.causes))
    if not explained and left.faint:
        verdict = nothing(faint=True)
    if verdict.kind == "ambiguous":
        say("what would tell them apart")
        first, second = (c.refit.apart()[-1] for c in verdict.causes[:2])
        experiment = separating(taken, first, second, model, s2)
    holds = verdict.kind == "named" or (verdict.kind == "ambiguous" and current.cause is not None)
    return Round(
        misfit=misfit, scores=scores, candidates=tuple(candidates), verdict=verdict, s2=s2, experiment=experiment,
        extended=verdict.causes[0].refit if holds else None,
    )  # fmt: skip


def scores_of(
    current: Refit, model: Model, floor: float, modes: np.ndarray, tries: Sequence[tuple[Cause, Sequence[Any]]]
) -> tuple[Statistics, tuple[Score, ...]]:
    """The score at a state of every cause over its places, best first."""
    scene = current.scene
    directions: list[Direction] = []
    table = []
    for cause, places in tries:
        columns = []
        for place in places:
            made = directions_of(cause, scene, place)
            columns.append(range(len(directions), len(directions) + len(made)))
            directions += made
        table.append((cause, places, np.array(columns)))
    K = model.basis.log_mu.shape[1]
    found = moments(
        scene, model.basis, current.around[:K], model.extra, directions,
        residual=scene.target.residual(current.simulated), modes=modes,
    )  # fmt: skip
    statistics = Statistics(moments=found, s2=model.s2, prior=current.prior)
    least = least_visible(scene, np.sqrt(floor)) * np.sqrt(found.normal.count)
    scores = [
        score(statistics, cause, cause.widths(scene), places, columns + found.nuisances, floor, least)
        for cause, places, columns in table
    ]
    return statistics, tuple(sorted(scores, key=lambda s: -s.log_bayes))


def _leaders(scores: Sequence[Score], keep: float) -> list[Score]:
    """Those worth a refit: the best, and others that come near; none of which the nuisances leave no more than keep."""
    able = [s for s in scores if s.keep > keep and s.log_bayes > _LEAST]
    return [s for s, share in zip(able, _FAIR, strict=False) if s.log_bayes >= share * able[0].log_bayes]


def _narrowed(
    leaders: Sequence[Score], current: Refit, model: Model, floor: float, modes: np.ndarray, say: Progress
) -> list[Score]:
    """The leaders at the best of the places between those that were scanned."""
    tries = [(s.cause, [s.place, *s.cause.near(current.scene, s.place)]) for s in leaders]
    tries = [(cause, places) for cause, places in tries if len(places) > 1]
    if not tries:
        return list(leaders)
    say("places in between")
    finer = {s.name: s for s in scores_of(current, model, floor, modes, tries)[1]}
    return [finer.get(s.name, s) for s in leaders]


def _tried(
    leaders: Sequence[Score], current: Refit, model: Model, modes: np.ndarray, say: Progress
) -> tuple[list[Refit], float]:
    """The leaders refitted, and the noise that the best of them leaves: what it explains was no noise.

    A refit that leaves less than was taken for noise, or beside which the material's prior was too stiff, is done again
    at what it leaves, up to three times, unless another leaves far less.
    """
    tried = [_placed(_tried_once(found, current, model, say), model, say) for found in leaders]
    left = [_left_by(result, modes) for result in tried]
    weighed, reached = [model.s2] * len(tried), model.s2
    for _ in range(_LOOKS):
        better = [result.tuned(model, s2) for result, s2 in zip(tried, left, strict=True)]
        closer = [
            i for i, s2 in enumerate(left)
            if s2 < _IN_REACH * min(left)
            and (s2 < _CLOSER * weighed[i] or better[i].evidence(s2) - tried[i].evidence(s2) > WORTH)
        ]  # fmt: skip
        for i in closer:
            say(f"closer look at {leaders[i].name}")
            before = better[i]
            own = replace(model, s2=left[i], prior=before.prior[: len(before.coefficients)])
            again = refit(
                before.without, own, before.coefficients, cause=before.cause, place=before.place, theta=before.theta
            )
            tried[i], weighed[i] = _placed(again, own, say), left[i]
            left[i] = _left_by(tried[i], modes)
            reached = min(reached, weighed[i], left[i])
        if not closer:
            break
    return tried, reached


def _tried_once(found: Score, current: Refit, model: Model, say: Progress) -> Refit:
    say(f"refit with {found.name}")
    start, shift, theta = current.coefficients, found.nuisances - current.coefficients, found.theta
    place, stiffer = found.cause.begin(found.place)
    if stiffer:  # too far for the first order
        start, shift, theta = model.basis.stiffer(start, stiffer), None, found.cause.known(found.place)
    if current.cause is not None:
        both, theta = Beside(current.cause, found.cause), theta if stiffer else np.zeros(len(theta))
        theta = np.concatenate([current.theta, theta])
        return refit(current.without, model, start, cause=both, place=(current.place, place), theta=theta)
    return refit(current.scene, model, start, cause=found.cause, place=place, theta=theta, shift=shift)


def _placed(result: Refit, model: Model, say: Progress) -> Refit:
    """Once more where the refitted material shows a better place, as long as it does."""
    for _ in range(_MOVES):
        cause, place = result.cause, better_place(result, model)
        if place is result.place:  # places may be arrays
            break
        say(f"{cause.name} at a better place")
        at, stiffer = cause.begin(place)
        theta = cause.known(place) if stiffer else result.theta
        start = model.basis.stiffer(result.coefficients, stiffer)
        result = refit(result.without, model, start, cause=cause, place=at, theta=theta)
    return result


def _left_by(result: Refit, modes: np.ndarray) -> float:
    """The variance [m2] at which the residual of a refit counts."""
    scene = result.taken_in().scene
    return counted(scene, measure_noise(scene, modes), modes)


def _candidate(result: Refit, current: Refit, model: Model, s2: float, modes: np.ndarray, before: Misfit) -> Candidate:
    """What a refitted cause gains at the variance s2, and what is left of the misfit at the model's."""
    left = statistics_of(result, model, modes).misfit()
    with_it, without = result.tuned(model, s2), current.tuned(model, s2)
    predicted = (without.left_out(s2, BLOCKS) - with_it.left_out(s2, BLOCKS)) / (2 * s2)
    gained = with_it.evidence(s2) - without.evidence(s2)
    return Candidate(
        refit=result, gained=gained, predicted=predicted, misfit=left,
        settled=result.converged or result.short < SHORT * gained,
        explained=1 - left.excess / max(before.excess, 1e-300),
        plausible=result.cause.plausible(result.scene, result.theta),
    )  # fmt: skip


def statistics_of(result: Refit, model: Model, modes: np.ndarray) -> Statistics:
    """The nuisances and the smooth modes against what a refit leaves, with its own fingerprints."""
    taken, K = result.taken_in(), model.basis.log_mu.shape[1]
    residual = taken.scene.target.residual(taken.simulated) * taken.scene.train[:, None, None]
    found = moments_of(result.kept, result.around[:K], len(model.extra), residual, taken.scene.target.seen, modes)
    return Statistics(moments=found, s2=model.s2, prior=taken.prior)
