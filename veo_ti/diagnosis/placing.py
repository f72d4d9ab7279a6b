"""Where a cause acts, looked at again once the material has been refitted beside it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.evidence import Posterior, posterior
from veo_ti.diagnosis.causes.courses import Course
from veo_ti.diagnosis.columns import between, directions_of
from veo_ti.diagnosis.fitted import Refit
from veo_ti.diagnosis.model import Model
from veo_ti.diagnosis.moments import Along, Fingerprints, answered_as_shown

_WORTH = 3.0  # nats that another place must promise
_SHARES = (1.0, 0.5, 0.25)  # of the way along all courses that is best to first order, which are tried


@dataclass(frozen=True, kw_only=True, eq=False)
class Spot:
    """A place, with the coefficients (K + E,) and theta (d,) that are most probable there, to first order."""

    place: Any
    coefficients: np.ndarray
    theta: np.ndarray


def better_place(result: Refit, model: Model, *, roams: int = 2) -> Spot:
    """The place near that of a refitted cause at which it would explain most, material and parameters moving with it.

    Linear about the refit: it is taken from its place to another as it is; a cause that lags, and pushes nothing, is
    also tried at each place as if it were new. Its own place as it was, where none is clearly better. roams: 2 to any
    place, 1 along courses only, 0 nowhere.
    """
    here, cause = Spot(place=result.place, coefficients=result.coefficients, theta=result.theta), result.cause
    others = []
    if roams > 1:
        others = [*(cause.places(result.without) if cause.lags else ()), *cause.near(result.without, result.place)]
    places = [*others, *(further(result, result.place, model) if roams else ())]
    if not places:
        return here
    places = [result.place, *places]
    ways = [moved(result, model, places)]
    if cause.lags:
        ways.append(_as_new(result, model, places))
    more, best, found = max(
        ((p.evidence - way[0].evidence, i, p) for way in ways for i, p in enumerate(way)), key=lambda t: t[0]
    )
    if more <= _WORTH:
        return here
    coefficients, theta = np.split(found.mean, [len(result.coefficients)])
    return Spot(place=places[best], coefficients=coefficients, theta=theta)


def further(result: Refit, place: Any, model: Model) -> list[Any]:
    """From a place on, so much of the way along all its courses that is best to first order; none without courses."""
    courses = result.cause.courses(result.without, place)
    if not courses:
        return []
    steps = along(result, place, courses, model).mean[-len(courses) :].clip(-1, 1)
    return [_gone(place, courses, share * steps) for share in _SHARES]


def _gone(place: Any, courses: Sequence[Course], steps: np.ndarray) -> Any:
    """Where so many steps along every course lead, one after the other."""
    for on, step in zip(courses, steps, strict=True):
        place = on(place, float(step))
    return place


def along(result: Refit, place: Any, courses: Sequence[Course], model: Model) -> Posterior:
    """How far on its place is along each course from a place, too, after all other unknowns: how the motion changes
    half a step on is one more column, of unit variance, to first order."""
    ends = [on(place, step) for on in courses for step in (-0.5, 0.5)]
    return moved(result, model, [place], ends)[0]


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


def moved(result: Refit, model: Model, places: Sequence[Any], ends: Sequence[Any] = ()) -> list[Posterior]:
    """At each place, to first order: what taking the cause there as it is adds to the motion is known in full, and each
    parameter has its own fingerprint there.

    ends (2 c): places before and beyond all of them along courses; what lies between is one more unknown for each.
    """
    scene, theta, n = result.scene, result.theta, len(result.coefficients)
    frames, kept, count = result.kept.frames, result.kept.columns, len(places)
    residual, some = scene.target.residual(result.simulated), np.flatnonzero(theta)
    taken, own = np.repeat(residual[None], count, axis=0), [[] for _ in places]
    for t, X, S in zip(frames, kept, _elsewhere(result, [*places, *ends]), strict=True):
        seen = scene.target.seen[t]
        more = S[:, :, seen].reshape(*S.shape[:2], -1)
        on = more[count:].sum(axis=1)
        for place, each in enumerate(more[:count]):
            taken[place, t, seen] -= each.sum(axis=0).reshape(-1, 3)
            rows = X[n:].copy()
            rows[some] += (each / theta[some, None]).astype(np.float32)
            own[place].append(np.concatenate([rows, (on[1::2] - on[::2]).astype(np.float32)]))
    c = len(ends) // 2
    at, prior = np.append(result.around, np.zeros(c)), np.append(result.prior, np.ones(c))
    return [_explained(result, n, rows, at, r, prior, model) for rows, r in zip(own, taken, strict=True)]


def _elsewhere(result: Refit, places: Sequence[Any]) -> Iterator[np.ndarray]:
    """How what is seen of the motion changes with the cause at other places, by each of the parameters that are not
    zero, (P, d, N, 3), frame by frame."""
    scene, cause, theta, frames = result.scene, result.cause, result.theta, result.kept.frames
    each = [theta * axis for axis in np.eye(len(theta)) if theta @ axis] or [theta]
    here, *there = ([cause.change(scene, own, place) for own in each] for place in (result.place, *places))
    ways = [between(now, then) for changes in there for now, then in zip(here, changes, strict=True)]
    beside, materials = Along.with_cause(cause, scene, theta, result.place), np.zeros((0, scene.cloud.count, 2))

    def forces_of(chosen: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        return lambda local: np.stack([d.forces(scene, chosen[local]) for d in ways], axis=1)

    pushes = any(d.change.terms for d in ways)
    pushed = answered_as_shown(scene, forces_of, frames, beside, materials) if pushes else np.zeros(len(frames))
    for t, S in zip(frames, pushed, strict=True):
        moves = np.stack([d.moves(scene, np.array([t]))[0] for d in ways])
        yield (S + moves).reshape(-1, len(each), *moves.shape[1:])


def _explained(
    result: Refit, first: int, rows: Sequence[np.ndarray], at: np.ndarray, residual: np.ndarray, prior: np.ndarray,
    model: Model,
) -> Posterior:  # fmt: skip
    """By the refit's first columns and others (d, 3 n) of the points seen frame by frame, with what they explain."""
    kept = result.kept
    columns = tuple(np.concatenate([X[:first], own]) for X, own in zip(kept.columns, rows, strict=True))
    normal = Fingerprints(frames=kept.frames, columns=columns).parts(residual, result.scene.target.seen, at, 1)[0]
    return posterior(normal, prior, np.sqrt(model.s2))
