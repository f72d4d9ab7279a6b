"""The causes worth a refit, refitted: at the best of their places, at the noise that they leave."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from veo_ti.diagnosis.fitted import Refit
from veo_ti.diagnosis.looks import IN_REACH, LOOKS, NEARBY, Progress, Tried, beyond, cost_under, looked, tried_once
from veo_ti.diagnosis.model import Model
from veo_ti.diagnosis.score import Score, Statistics, scores_of

_LEAST = 1.5  # nats that a score must reach for a refit, and
_CLEARLY = 20.0  # likewise, where it promises next to nothing
_PROMISING = 0.25  # share of the misfit, to first order; docs/blind_trials.md: how much less refits explain
_FAIR = (0.0, 0.2, 0.6, 0.75, 0.85)  # share of the best score that the first, second, third ... must reach; and
_FURTHER, _COUNT = 0.3, 3  # that others must, and how many of them, where none of these explains enough
_HIDDEN = 0.25  # share of the misfit that two promise together beyond what any does, to be refitted for that; and
_AS_MUCH = 0.8  # share of the best score that one must reach which the nuisances imitate
_ALIKE = 0.7  # share of what the best one does, to first order, that a cause can do to be worth one as well
_BEHIND = 2.5  # times the cost of another fit, more than which one is given up that does not promise less
_NEARLY = 0.2  # share of the variance that a cause must leave for its refit to go to the end


def leaders_of(scores: Sequence[Score], keep: float) -> tuple[list[Score], list[Score]]:
    """Those worth a refit: the best and others that come near, and those that are next where none of these explains
    enough. A score says little about a large effect. None of which the nuisances leave no more than keep, or that does
    not promise to explain a fair share."""
    able = [s for s in _spoken_for(scores, keep) if s.explained > _PROMISING]
    first = [s for s, share in zip(able, _FAIR, strict=False) if s.log_bayes >= share * able[0].log_bayes]
    others = [s for s in able if s not in first and s.log_bayes >= _FURTHER * able[0].log_bayes]
    return first, others[:_COUNT]


def hiding(statistics: Statistics, noise: Statistics, scores: Sequence[Score], keep: float) -> tuple[Score, ...]:
    """The two that promise most together, if that is far more than any does alone: they may hide each other. noise: the
    statistics at the variance of the noise."""
    spoken = _spoken_for(scores, keep)
    pairs = [(statistics.together(*two, noise), two) for two in combinations(spoken, 2)]
    most, both = max(pairs, key=lambda pair: pair[0], default=(0.0, ()))
    return both if both and most > _HIDDEN + max(s.explained for s in spoken) else ()


def waiting(scores: Sequence[Score], both: Sequence[Score], tried: Collection[str]) -> list[Score]:
    """All others that could be next, however many, and however much of them the nuisances imitate; and those of both,
    which may hide each other."""
    able = [s for s in _spoken_for(scores, 0.0) if s.explained > _PROMISING]
    others = [s for s in able if s.log_bayes >= _FURTHER * able[0].log_bayes]
    return [s for s in (*others, *(s for s in both if s not in others)) if s.name not in tried]


def likeliest(scores: Sequence[Score], keep: float) -> list[Score]:
    """The one for which most speaks, and those for which nearly as much does, however little they promise to first
    order: beside a cause that takes up what is their own, that says nothing."""
    spoken = _spoken_for(scores, keep)[:_COUNT]
    return [s for s in spoken if s.log_bayes > max(_CLEARLY, _AS_MUCH * spoken[0].log_bayes)]


def as_likely(scores: Sequence[Score], leaders: Sequence[Score], keep: float) -> list[Score]:
    """Those that the nuisances imitate, and for which as much speaks nevertheless as for the best of the leaders."""
    least = _AS_MUCH * leaders[0].log_bayes if leaders else np.inf
    return [s for s in scores if s.keep <= keep and s.log_bayes > least]


def look_alikes(
    name: str, statistics: Statistics, scores: Sequence[Score], keep: float, tried: Sequence[str]
) -> list[Score]:
    """Those not tried yet that can do most of what the cause of that name does: of a large effect either may be the
    better one, whatever the score says. A jet that is turned about its nozzle is shifted at first."""
    best = next(s for s in scores if s.name == name)
    others = [s for s in _spoken_for(scores, keep) if s.name not in tried]
    return [s for s in others if statistics.likeness(best, s) > _ALIKE]


def _spoken_for(scores: Sequence[Score], keep: float) -> list[Score]:
    """Those for which there is evidence, and of which the nuisances leave more than keep."""
    return [s for s in scores if s.keep > keep and s.log_bayes > _LEAST]


@dataclass(frozen=True, kw_only=True, eq=False)
class Refitted:
    """Causes that were refitted, and what they are measured by."""

    refits: tuple[Refit, ...] = ()
    s2: float = np.inf  # the noise [m2] that the best of them leaves: what it explains was no noise
    least: float = np.inf  # variance [m2] at which what any of them leaves counts; and
    rough: float = 0.0  # up to which none is left behind: a rough refit says no more


def refitted(
    leaders: Sequence[Score], current: Refit, model: Model, floor: float, modes: np.ndarray, say: Progress, *,
    beside: Refitted = Refitted(),
) -> Refitted:  # fmt: skip
    """The leaders at the best of their places, after those that were refitted before, beside which they have to stand:
    one that leaves far more than any gets no second look, unless that is little of what was wrong.

    In the first look those that obey one of several laws are refitted by the others as well, unless they leave least,
    and that is noise.
    """
    leaders = _narrowed(leaders, current, model, floor, modes, say)
    tried, reached = _looked_at(leaders, current, model, floor, modes, say, beside)
    nearest = _nearest(beside.least, tried)
    close = [t.left < NEARBY * nearest and t.left > min(nearest, floor) for t in tried]
    others = [
        (s.cause, law)
        for s, may_be in zip(leaders, close, strict=True)
        for law in (s.cause.laws(current.scene) if may_be and current.cause is None else ())
        if law != s.place
    ]
    if others:
        scores = scores_of(current, model, floor, modes, [(cause, [law]) for cause, law in others])[1]
        more, less = _looked_at(scores, current, model, floor, modes, say, replace(beside, least=nearest))
        best = {t.result.cause.name: t for t in sorted([*tried, *more], key=lambda t: -t.left)}
        tried, reached = [best[t.result.cause.name] for t in tried], min(reached, less)
        nearest = _nearest(nearest, tried)
    tried = [beyond(t, modes, say) if t.left < IN_REACH * nearest else t for t in tried]
    return Refitted(
        refits=(*beside.refits, *(t.result for t in tried)),
        s2=min([beside.s2, reached, *(t.model.s2 for t in tried)]),
        least=_nearest(nearest, tried),
        rough=beside.rough,
    )


def _looked_at(
    leaders: Sequence[Score], current: Refit, model: Model, floor: float, modes: np.ndarray, say: Progress,
    beside: Refitted,
) -> tuple[list[Tried], float]:  # fmt: skip
    """All refitted at their places, and the noise that the best leaves.

    A refit that leaves less than was taken for noise, or beside which the material's prior was too stiff, is done again
    at what it leaves, a few times, unless another leaves far less.
    """
    tried: list[Tried] = []
    known = min((cost_under(model, r) for r in beside.refits), default=np.inf)
    for found in leaders:
        most = _BEHIND * min([known, *(t.result.cost for t in tried)])
        tried.append(Tried.of(tried_once(found, current, model, say, most), model, modes, fine=False))
    enough, reached = max(_NEARLY * model.s2, IN_REACH * floor), model.s2
    for _ in range(LOOKS):
        before = list(tried)
        for n in np.argsort([t.left for t in before], kind="stable"):  # what leaves least tells which others may follow
            least = max(beside.rough, _nearest(beside.least, tried))
            tried[n] = looked(tried[n], least, enough, modes, say)
        again = [t for t, old in zip(tried, before, strict=True) if t is not old]
        if not again:
            break
        reached = min(reached, *(min(t.model.s2, t.left) for t in again))
    return tried, reached


def _nearest(known: float, tried: Sequence[Tried]) -> float:
    """The least that any leaves, of those tried and of others of which the best leaves `known`."""
    return min([known, *(t.left for t in tried)])


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
