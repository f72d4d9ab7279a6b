"""Where a cause acts, looked at again once the material has been refitted beside it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim.evidence import Posterior, posterior
from veo_ti.diagnosis.causes.base import Change, Measure
from veo_ti.diagnosis.causes.courses import Course
from veo_ti.diagnosis.columns import Direction, Negated, directions_of
from veo_ti.diagnosis.fitted import OURS, Placed, Refit
from veo_ti.diagnosis.model import Model, shown_by
from veo_ti.diagnosis.moments import Along, Fingerprints, answered_as_shown

_WORTH = 3.0  # nats that another place must promise
_SHARES = (1.0, 0.5, 0.25)  # of the way along all courses that is best to first order, which are tried


@dataclass(frozen=True, kw_only=True, eq=False)
class Spot:
    """A place, with the coefficients (K + E,) and theta (d,) that are most probable there, to first order."""

    place: Any
    coefficients: np.ndarray
    theta: np.ndarray


def better_place(result: Refit, model: Model) -> Spot:
    """The place near that of a refitted cause at which it would explain most, material and parameters moving with it.

    Linear about the refit: it is taken from its place to another as it is; a cause that lags, and pushes nothing, is
    also tried at each place as if it were new. Its own place as it was, where none is clearly better.
    """
    here = Spot(place=result.place, coefficients=result.coefficients, theta=result.theta)
    cause, courses = result.cause, result.cause.courses(result.without, result.place)
    others = cause.places(result.without) if cause.lags else ()
    places = [result.place, *others, *cause.near(result.without, result.place)]
    if courses:
        steps = _along(result, courses, model).mean[-len(courses) :].clip(-1, 1)
        places += [_gone(result.place, courses, share * steps) for share in _SHARES]
    if len(places) == 1:
        return here
    ways = [_moved(result, model, places)]
    if cause.lags:
        ways.append(_as_new(result, model, places))
    more, best, found = max(
        ((p.evidence - way[0].evidence, i, p) for way in ways for i, p in enumerate(way)), key=lambda t: t[0]
    )
    if more <= _WORTH:
        return here
    coefficients, theta = np.split(found.mean, [len(result.coefficients)])
    return Spot(place=places[best], coefficients=coefficients, theta=theta)


def _gone(place: Any, courses: Sequence[Course], steps: np.ndarray) -> Any:
    """Where so many steps along every course lead, one after the other."""
    for on, step in zip(courses, steps, strict=True):
        place = on(place, float(step))
    return place


def unsure_of_place(result: Refit) -> Refit:
    """A refit whose intervals hold that its place is unsure, where that lies on a course; of one of two causes, that
    both are."""
    if result.whole is not None:
        both = unsure_of_place(result.whole).apart()
        return replace(result, placed=next(one.placed for one in both if one.cause is result.cause))
    courses = [] if result.cause is None else result.cause.courses(result.without, result.place)
    if not courses:
        return result
    found = _along(result, courses, result.line.problem.model).covariance[len(result.coefficients) :]
    rest = found[:, len(result.coefficients) :]
    own, on = slice(-len(courses)), slice(-len(courses), None)
    return replace(result, placed=Placed(covariance=rest[own, own], steps=rest[on, on]))


def measured(result: Refit) -> list[tuple[Measure, float, float]]:
    """What tells the place of a refit of one cause, with the ends of 95 % intervals; nothing where that was not asked.

    `sd^2 = j^T C j`, j the change with a step along each course, with what the simulation gets wrong (`Refit.spread`).
    """
    courses = [] if result.placed is None else result.cause.courses(result.without, result.place)
    if not courses:
        return []
    here = result.cause.measures(result.place)
    ends = [[_values(result, on(result.place, step)) for step in (-0.5, 0.5)] for on in courses]
    change = np.array([after - before for before, after in ends])
    sd = np.sqrt(np.einsum("cm,cd,dm->m", change, result.placed.steps, change) * (1 + 2 * OURS**2 * result.worth))
    return [(measure, *measure.interval(float(s))) for measure, s in zip(here, sd, strict=True)]


def _values(result: Refit, place: Any) -> np.ndarray:
    return np.array([measure.value for measure in result.cause.measures(place)])


def _along(result: Refit, courses: Sequence[Course], model: Model) -> Posterior:
    """How far on its place is along each course, too, after all other unknowns: how the motion changes half a step on
    is one more column, of unit variance, to first order."""
    n, scene = len(result.coefficients), result.scene
    ends = [on(result.place, step) for on in courses for step in (-0.5, 0.5)]
    motion = _pushed_elsewhere(result, [result.place, *ends])
    rows = []
    for t, X, S in zip(result.kept.frames, result.kept.columns, motion, strict=True):
        moves = (S[1::2] - S[::2])[:, scene.target.seen[t]]
        rows.append(np.concatenate([X[n:], moves.reshape(len(courses), -1).astype(np.float32)]))
    at, prior = np.append(result.around, np.zeros(len(courses))), np.append(result.prior, np.ones(len(courses)))
    return _explained(result, n, rows, at, scene.target.residual(result.simulated), prior, model)


def _as_new(result: Refit, model: Model, places: Sequence[Any]) -> list[Posterior]:
    """At each place for a cause that only changes what is seen, whose motion is that of every place."""
    scene, n = result.without, len(result.coefficients)
    prior = np.concatenate([model.prior, result.cause.widths(scene) ** 2])
    at = np.concatenate([result.around[:n], np.zeros(len(result.theta))])
    residual, found = scene.target.residual(scene.y), []
    for place in places:
        directions = directions_of(result.cause, scene, place)
        moves = [np.stack([d.moves(scene, np.array([t]))[0] for d in directions]) for t in result.kept.frames]
        seen = [scene.target.seen[t] for t in result.kept.frames]
        rows = [X[:, own].reshape(len(X), -1).astype(np.float32) for X, own in zip(moves, seen, strict=True)]
        found.append(_explained(result, n, rows, at, residual, prior, model))
    return found


def _moved(result: Refit, model: Model, places: Sequence[Any]) -> list[Posterior]:
    """At each place: what taking the cause there adds is one more motion, in full.

    In proportion to its only parameter it belongs to the parameter's own fingerprint there.
    """
    scene, theta, n = result.scene, result.theta, len(result.coefficients)
    frames, kept = result.kept.frames, result.kept.columns
    residual, single = scene.target.residual(result.simulated), len(theta) == 1 and theta.all()
    taken, own = np.repeat(residual[None], len(places), axis=0), [[X[n:] for X in kept] for _ in places]
    motion = _shown_elsewhere(result, places) if result.cause.lags else _pushed_elsewhere(result, places)
    for i, (t, S) in enumerate(zip(frames, motion, strict=True)):
        seen = scene.target.seen[t]
        moved = S[:, seen]
        taken[1:, t, seen] -= moved
        for place, more in enumerate(moved.reshape(len(moved), -1) if single else (), start=1):
            own[place][i] = own[place][i] + (more / theta).astype(np.float32)
    at = zip(own, taken, strict=True)
    return [_explained(result, n, rows, result.around, r, result.prior, model) for rows, r in at]


def _shown_elsewhere(result: Refit, places: Sequence[Any]) -> Iterator[np.ndarray]:
    """What is seen of the same motion with the cause at the other places instead of the first, (P - 1, N, 3), frame by
    frame."""
    scene, theta, now = result.scene, result.theta, result.simulated
    there = [shown_by(scene, result.cause.change(scene, theta, place)) for place in places[1:]]
    yield from (np.stack([y[t] - now[t] for y in there]) for t in result.kept.frames)


def _pushed_elsewhere(result: Refit, places: Sequence[Any]) -> Iterator[np.ndarray]:
    """How the motion moves with it."""
    scene, cause, theta = result.scene, result.cause, result.theta
    here = tuple(Negated(term=term) for term in cause.change(scene, theta, result.place).terms)
    ways = [
        Direction(change=Change(terms=(*cause.change(scene, theta, place).terms, *here)), scale=1.0)
        for place in places[1:]
    ]
    along, materials = Along.with_cause(cause, scene, theta, result.place), np.zeros((0, scene.cloud.count, 2))

    def forces_of(chosen: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        return lambda local: np.stack([d.forces(scene, chosen[local]) for d in ways], axis=1)

    return answered_as_shown(scene, forces_of, result.kept.frames, along, materials)


def _explained(
    result: Refit, first: int, rows: Sequence[np.ndarray], at: np.ndarray, residual: np.ndarray, prior: np.ndarray,
    model: Model,
) -> Posterior:  # fmt: skip
    """By the refit's first columns and others (d, 3 n) of the points seen frame by frame, with what they explain."""
    kept = result.kept
    columns = tuple(np.concatenate([X[:first], own]) for X, own in zip(kept.columns, rows, strict=True))
    normal = Fingerprints(frames=kept.frames, columns=columns).parts(residual, result.scene.target.seen, at, 1)[0]
    return posterior(normal, prior, np.sqrt(model.s2))
