"""One look for a cause: every cause scored, the leaders refitted, the verdict on them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.experiment import Experiment, separating
from veo_ti.diagnosis.fitted import Refit, everywhere
from veo_ti.diagnosis.leaders import Refitted, as_likely, hiding, leaders_of, likeliest, look_alikes, refitted, waiting
from veo_ti.diagnosis.looks import Progress
from veo_ti.diagnosis.misfit import Misfit
from veo_ti.diagnosis.model import Model
from veo_ti.diagnosis.noise import counted, measure_noise
from veo_ti.diagnosis.score import Score, Statistics, scores_of, statistics_of
from veo_ti.diagnosis.verdict import (
    CLEAN,
    CLEAR,
    EXPLAINED,
    MISFIT,
    SURVIVES,
    TESTABLE,
    TOGETHER,
    Candidate,
    Verdict,
    judge,
    leaves_clearly,
    nothing,
    stands,
    sufficient,
    unexplained,
)
from veo_ti.diagnosis.visible import Left

SHORT = 0.1  # of what a cause gains, that its refit may still promise
BLOCKS = 8  # of training frames
_FAIRLY = 0.8  # of what a cause leaves, that another explains for all to be tried: nine tenths, if that one does half
_ROUGHLY = 0.025  # of what there was, that a first, rough refit may leave of what further ones explain


@dataclass(frozen=True, kw_only=True, eq=False)
class Round:
    """One look for a cause: what was wrong, every score, the refitted leaders, the verdict.

    tried: what was refitted, beside which further causes have to stand; both: the two that promise far more together
    than any does alone; extended: the model with what was named; where several could be what a named cause leaves,
    with the likeliest.
    """

    misfit: Misfit
    scores: tuple[Score, ...]  # best first
    candidates: tuple[Candidate, ...]  # best first
    verdict: Verdict
    s2: float  # variance [m2] at which the candidates were weighed
    tried: Refitted = field(default_factory=Refitted)
    both: frozenset[str] = frozenset()
    extended: Refit | None = None
    statistics: Statistics | None = None  # by which the scores were made
    experiment: Experiment | None = None  # what would tell apart those that are ambiguous


def look(
    current: Refit, model: Model, floor: float, modes: np.ndarray, causes: Sequence[Cause], say: Progress, *,
    shadow: bool = False, least: float = np.inf,
) -> Round:  # fmt: skip
    """Look for a cause beside what `current` holds: nothing, or a cause whose parameters then stay free.

    floor: the variance of the noise, by which misfit is judged; the model's own weighs the causes; shadow: whether
    `current` explains most already, so that what is left may be its own shadow: only a cause that explains nearly all
    of it is then named, and, unless it is clear that something is left, one that little can imitate. least: variance
    [m2] at which counts what others are known to leave; one that leaves far more gets no second look.
    """
    current = everywhere(current)
    taken = current.taken_in()
    say("fingerprints of all causes")
    statistics, scores = scores_of(current, model, floor, modes, [(c, list(c.places(taken.scene))) for c in causes])
    misfit = replace(statistics, s2=floor).misfit()
    quiet = Round(misfit=misfit, scores=scores, statistics=statistics, candidates=(), verdict=nothing(), s2=model.s2)
    if misfit.z < MISFIT:
        return quiet
    noise = measure_noise(taken.scene, modes)
    left = Left.by(taken, model, model.s2, noise.local, modes, shadow=shadow)
    if not left.visible:
        return quiet
    keep = SURVIVES if shadow and misfit.z < CLEAR else TESTABLE
    clear = likeliest(scores, keep) if current.cause is not None and misfit.z > CLEAR else []
    if left.like_noise and not any(s.explained > EXPLAINED for s in clear[:1]):
        return replace(quiet, verdict=nothing(even=True))
    leaders, others = leaders_of(scores, keep)
    leaders += [s for s in clear if s not in leaders]
    if not shadow or misfit.z > CLEAR:
        leaders += as_likely(scores, leaders, keep)
    rough = _ROUGHLY * counted(taken.scene, noise, modes)
    known = Refitted(least=max(least, rough), rough=rough)
    tried = refitted(leaders, current, model, floor, modes, say, beside=known)
    candidates = _candidates(tried.refits, scores, current, model, floor, tried.s2, modes)
    standing = [c for c in candidates if sufficient(c)]
    wider = not standing and current.cause is not None and any(c.able and c.explained > _FAIRLY for c in candidates)
    if standing:
        alike = look_alikes(standing[0].name, statistics, scores, keep, [c.name for c in candidates])
        further = others if leaves_clearly(standing[0]) else ()
        others = alike + [s for s in further if s not in (*alike, *leaders)]
    elif wider:  # it may only imitate what is there
        others = waiting(scores, (), {c.name for c in candidates})
    if others and (standing or wider or current.cause is None):
        tried = refitted(others, current, model, floor, modes, say, beside=tried)
        candidates = _candidates(tried.refits, scores, current, model, floor, tried.s2, modes)
    verdict = _lasting(judge(misfit, candidates, shadow=shadow), model)
    explained = verdict.kind == "ambiguous" or (verdict.kind == "named" and stands(verdict.causes))
    if not explained and left.faint:
        verdict = nothing(faint=True)
    holds = verdict.kind == "named" or (verdict.kind == "ambiguous" and current.cause is not None)
    return replace(
        quiet, candidates=tuple(candidates), verdict=verdict, s2=tried.s2, tried=tried,
        extended=verdict.causes[0].refit if holds else None,
    )  # fmt: skip


def told_apart(found: Round, current: Refit, model: Model, s2: float, say: Progress) -> Round:
    """A look beside `current` with the measurement that would tell apart the likeliest two of several causes, at the
    variance s2 [m2]."""
    if found.verdict.kind != "ambiguous":
        return found
    say("what would tell them apart")
    first, second = (c.refit.apart()[-1] for c in found.verdict.causes[:2])
    return replace(found, experiment=separating(current.taken_in(), first, second, model, s2))


def widened(found: Round, current: Refit, model: Model, floor: float, modes: np.ndarray, say: Progress) -> Round:
    """A first look with all those refitted, too, that could be next."""
    both = hiding(found.statistics, replace(found.statistics, s2=floor), found.scores, TESTABLE)
    others = waiting(found.scores, both, {c.name for c in found.candidates})
    tried = refitted(others, current, model, floor, modes, say, beside=found.tried)
    more = tried.refits[len(found.tried.refits) :]
    wider = with_more(found, more, current, model, floor, modes, wide=True)
    return replace(wider, tried=tried, both=frozenset(s.name for s in both))


def with_more(
    found: Round, more: Sequence[Refit], current: Refit, model: Model, floor: float, modes: np.ndarray, *,
    wide: bool = False,
) -> Round:  # fmt: skip
    """A first look with further refits of its causes, of each the best one; wide: of all that promise something."""
    every = [*found.candidates, *_candidates(more, found.scores, current, model, floor, found.s2, modes)]
    best = {c.name: c for c in sorted(every, key=lambda c: c.gained)}
    candidates = tuple(sorted(best.values(), key=lambda c: -c.gained))
    verdict = _lasting(judge(found.misfit, candidates, wide=wide), model)
    extended = verdict.causes[0].refit if verdict.kind == "named" else None
    return replace(found, candidates=candidates, verdict=verdict, extended=extended)


def _lasting(verdict: Verdict, model: Model) -> Verdict:
    """None is named once the effort is over: another may have needed the looks that it did not get."""
    return unexplained(verdict.causes) if verdict.kind == "named" and model.effort.over else verdict


def _candidates(
    tried: Sequence[Refit], scores: Sequence[Score], current: Refit, model: Model, floor: float, s2: float,
    modes: np.ndarray,
) -> list[Candidate]:  # fmt: skip
    """All weighed at the noise that the best of them leaves, best first."""
    each = [measure_noise(r.taken_in().scene, modes) for r in tried]
    model = replace(model, s2=min([floor, *(noise.variance for noise in each)]))
    before = statistics_of(current, model, modes).misfit()
    found = [_candidate(r, current, model, s2, n.local, modes, before) for r, n in zip(tried, each, strict=True)]
    imitated, unlike = {s.name for s in scores if s.keep <= TESTABLE}, {s.name: s.unlike for s in scores}
    found = [replace(c, testable=c.name not in imitated, unlike=unlike.get(c.name, {})) for c in found]
    return sorted(found, key=lambda c: -c.gained)


def _candidate(
    result: Refit, current: Refit, model: Model, s2: float, noise: float, modes: np.ndarray, before: Misfit
) -> Candidate:  # fmt: skip
    """What a refitted cause gains at the variance s2, and what is left of the misfit at the model's."""
    left = statistics_of(result, model, modes).misfit()
    with_it, without = result.tuned(model, s2), current.tuned(model, s2)
    leaves = Left.by(result.taken_in(), model, s2, noise, modes, shadow=True)
    predicted = (without.left_out(s2, BLOCKS) - with_it.left_out(s2, BLOCKS)) / (2 * s2)
    gained = with_it.evidence(s2) - without.evidence(s2)
    explained = 1 - left.excess / max(before.excess, 1e-300)
    arrived = left.z < CLEAN and explained > TOGETHER  # a promise next to an instability is none
    return Candidate(
        refit=result, gained=gained, predicted=predicted, misfit=left, explained=explained,
        settled=result.converged or result.short < SHORT * gained or arrived,
        plausible=result.cause.plausible(result.scene, result.theta, result.spread) and bool(np.isfinite(result.short)),
        coincidence=result.cause.coincidence(result.scene, result.theta, result.spread),
        certain=result.certain(gained if current.cause is None else 0.0),
        like_noise=leaves.like_noise,
        visible=leaves.visible or (result.cause.plain and left.z > CLEAN and not leaves.coarse),
    )  # fmt: skip
