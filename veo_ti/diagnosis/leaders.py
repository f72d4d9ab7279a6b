"""The causes worth a refit, refitted: at the best of their places, at the noise that they leave."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sim.evidence import design_effect
from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.causes.beside import Beside
from veo_ti.diagnosis.model import Model, Refit
from veo_ti.diagnosis.noise import Noise, measure_noise
from veo_ti.diagnosis.placing import better_place
from veo_ti.diagnosis.refit import refit
from veo_ti.diagnosis.scene import Scene
from veo_ti.diagnosis.score import Score, scores_of

_LEAST = 1.5  # nats that a score must reach for a refit
_FAIR = (0.0, 0.2, 0.6, 0.75, 0.85)  # share of the best score that the first, second, third ... must reach; and
_FURTHER, _COUNT = 0.3, 3  # that others must, and how many of them, where none of these explains enough
_CLOSER = 0.7  # share of the variance that a cause must leave to be worth a second fit, and
_LOOKS = 3  # at most that a cause gets, each
WORTH = 5.0  # nats of evidence, that another prior of the material must bring
_MOVES = 3  # of a cause's place after its refit
_IN_REACH = 2.0  # times the least that any leaves

Progress = Callable[[str], None]


def counted(scene: Scene, noise: Noise, modes: np.ndarray) -> float:
    """The variance at which residuals count [m2]: the noise's, or that of the whole residual while it is larger.

    Where the model is wrong, the material would else be bent far beyond its linearisation to imitate what is missing.
    """
    r, seen = scene.residual * scene.train[:, None, None], scene.target.seen & scene.train[:, None]
    square = float((r**2).sum() / (3 * seen.sum()))
    return max(noise.variance, square * design_effect(r, seen, modes))


def leaders_of(scores: Sequence[Score], keep: float) -> tuple[list[Score], list[Score]]:
    """Those worth a refit: the best and others that come near, and those that are next where none of these explains
    enough. A score says little about a large effect. None of which the nuisances leave no more than keep."""
    able = [s for s in scores if s.keep > keep and s.log_bayes > _LEAST]
    first = [s for s, share in zip(able, _FAIR, strict=False) if s.log_bayes >= share * able[0].log_bayes]
    others = [s for s in able if s not in first and s.log_bayes >= _FURTHER * able[0].log_bayes]
    return first, others[:_COUNT]


def refitted(
    leaders: Sequence[Score], current: Refit, model: Model, floor: float, modes: np.ndarray, say: Progress
) -> tuple[list[Refit], float]:
    """The leaders at the best of their places, and the noise that the best leaves: what it explains was no noise.

    A refit that leaves less than was taken for noise, or beside which the material's prior was too stiff, is done again
    at what it leaves, up to three times, unless another leaves far less.
    """
    leaders = _narrowed(leaders, current.taken_in(), model, floor, modes, say)
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


def _tried_once(found: Score, current: Refit, model: Model, say: Progress) -> Refit:
    say(f"refit with {found.name}")
    here = current.coefficients
    place, start, far = _begun(found.cause, found.place, here, model)
    if current.cause is not None:
        both, own = Beside(current.cause, found.cause), np.zeros(len(found.theta)) if far is None else far
        theta = np.concatenate([current.theta, own])
        return refit(current.without, model, start, cause=both, place=(current.place, place), theta=theta)
    theta, shift = (found.theta, found.nuisances - here) if far is None else (far, None)
    return refit(current.scene, model, start, cause=found.cause, place=place, theta=theta, shift=shift)


def _begun(
    cause: Cause, place: Any, coefficients: np.ndarray, model: Model
) -> tuple[Any, np.ndarray, np.ndarray | None]:
    """Where a fit at a place begins: place, coefficients, and theta where that is too far for the first order."""
    at, stiffer = cause.begin(place)
    return at, model.basis.stiffer(coefficients, stiffer), cause.known(place) if stiffer else None


def _placed(result: Refit, model: Model, say: Progress) -> Refit:
    """Once more where the refitted material shows a better place, as long as it does."""
    for _ in range(_MOVES):
        cause, place = result.cause, better_place(result, model)
        if place is result.place:  # places may be arrays
            break
        say(f"{cause.name} at a better place")
        at, start, far = _begun(cause, place, result.coefficients, model)
        result = refit(result.without, model, start, cause=cause, place=at, theta=result.theta if far is None else far)
    return result


def _left_by(result: Refit, modes: np.ndarray) -> float:
    """The variance [m2] at which the residual of a refit counts."""
    scene = result.taken_in().scene
    return counted(scene, measure_noise(scene, modes), modes)
