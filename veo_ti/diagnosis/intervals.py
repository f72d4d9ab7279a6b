"""How unsure the place is that was found for a cause, and its parameters with that."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from veo_ti.diagnosis.causes.base import Measure
from veo_ti.diagnosis.fitted import Placed, Refit
from veo_ti.diagnosis.model import Model
from veo_ti.diagnosis.placing import along, further, moved

_LIKELY = 1.96**2 / 2  # nats that a place may be worth less within a 95 % interval
_BEST = 4  # scanned places, from which courses lead on


def unsure_of_place(result: Refit, wrong: Mapping[str, float]) -> Refit:
    """A refit whose intervals hold that its place is unsure, where that lies on a course; of one of two causes, that
    both are.

    wrong: nats, by the causes' names, that what the simulation gets wrong of them may be worth. That may look like
    another place: one nearby, to first order, or any other that was scanned.
    """
    if result.whole is not None:
        both = unsure_of_place(result.whole, wrong).apart()
        return replace(result, placed=next(one.placed for one in both if one.cause is result.cause))
    courses = [] if result.cause is None else result.cause.courses(result.without, result.place)
    if not courses:
        return result
    model, n = result.line.problem.model, len(result.coefficients)
    found = along(result, result.place, courses, model).covariance[n:, n:]
    own, on = slice(-len(courses)), slice(-len(courses), None)
    nats = sum(wrong.get(one.cause.name, 0.0) for one in result.apart())
    placed = Placed(covariance=found[own, own], steps=found[on, on], nats=nats)
    return replace(result, placed=replace(placed, elsewhere=_as_likely(replace(result, placed=placed), model)))


def _as_likely(result: Refit, model: Model) -> tuple[tuple[Any, np.ndarray], ...]:
    """Other places within the interval, with the parameters there: those that were scanned, and from the best of them
    on along the courses."""
    cause, scene, n = result.cause, result.without, len(result.coefficients)
    there = [] if cause.lags else list(cause.near(scene, result.place))
    if not there:
        return ()
    here, *found = moved(result, model, [result.place, *there])
    best = sorted(range(len(there)), key=lambda i: -found[i].evidence)[:_BEST]
    more = [place for i in best for place in further(result, there[i], model)]
    found += moved(result, model, more) if more else []
    least = here.evidence - _LIKELY * result.off_place
    likely = [(at, one.mean[n:]) for at, one in zip([*there, *more], found, strict=True) if one.evidence > least]
    return tuple((at, theta) for at, theta in likely if (theta[cause.positive] > 0).all())


def measured(result: Refit) -> list[tuple[Measure, float, float]]:
    """What tells the place of a refit of one cause, with the ends of 95 % intervals, which hold other places that are
    as likely; nothing where that was not asked.

    `sd^2 = j^T C j`, j the change with a step along each course, with what the simulation gets wrong
    (`Refit.off_place`).
    """
    courses = [] if result.placed is None else result.cause.courses(result.without, result.place)
    if not courses:
        return []
    here = result.cause.measures(result.place)
    before, after = ([_values(result, on(result.place, step)) for on in courses] for step in (-0.5, 0.5))
    change = np.subtract(after, before)
    sd = np.sqrt(np.einsum("cm,cd,dm->m", change, result.placed.steps, change) * result.off_place)
    elsewhere = [{m.name: m.value for m in result.cause.measures(place)} for place, _ in result.placed.elsewhere]
    found = []
    for measure, s in zip(here, sd.tolist(), strict=True):
        ends = [*measure.interval(s), *(other[measure.name] for other in elsewhere if measure.name in other)]
        found.append((measure, min(ends), max(ends)))
    return found


def _values(result: Refit, place: Any) -> np.ndarray:
    return np.array([measure.value for measure in result.cause.measures(place)])
