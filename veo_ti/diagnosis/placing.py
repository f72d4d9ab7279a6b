"""Where a cause acts, looked at again once the material has been refitted beside it."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from sim.evidence import posterior
from sim.sensitivity import responses
from veo_ti.diagnosis.causes.base import Change
from veo_ti.diagnosis.columns import Direction, Negated, directions_of
from veo_ti.diagnosis.model import Model, Refit
from veo_ti.diagnosis.moments import Fingerprints, carried
from veo_ti.diagnosis.scene import Scene

_WORTH = 3.0  # nats that another place must promise


def better_place(result: Refit, model: Model) -> Any:
    """The place near that of a refitted cause at which it would explain most, material and parameters moving with it.

    Linear about the refit: a cause that lags, and pushes nothing, is tried at each place as if it were new;
    any other is taken from its place to another as it is.
    """
    cause = result.cause
    others = cause.places(result.without) if cause.lags else ()
    places = [result.place, *others, *cause.near(result.without, result.place)]
    if len(places) == 1:
        return result.place
    evidence = _as_new(result, model, places) if cause.lags else _moved(result, model, places)
    best = int(np.argmax(evidence))
    return places[best] if evidence[best] > evidence[0] + _WORTH else result.place


def _as_new(result: Refit, model: Model, places: Sequence[Any]) -> np.ndarray:
    """Evidence at each place for a cause that only changes what is seen, whose motion is that of every place."""
    scene, n = result.without, len(result.coefficients)
    prior = np.concatenate([model.prior, result.cause.widths(scene) ** 2])
    at = np.concatenate([result.around[:n], np.zeros(len(result.theta))])
    residual, found = scene.target.residual(scene.y), []
    for place in places:
        directions = directions_of(result.cause, scene, place)
        rows = [np.stack([d.moves(scene, np.array([t]))[0] for d in directions]) for t in result.kept.frames]
        found.append(_evidence(result, n, rows, at, residual, prior, model))
    return np.array(found)


def _moved(result: Refit, model: Model, places: Sequence[Any]) -> np.ndarray:
    """Evidence at each place for a cause that pushes: what taking it there adds is one more motion, in full."""
    scene, cause, theta = result.scene, result.cause, result.theta
    here = tuple(Negated(term=term) for term in cause.change(scene, theta, result.place).terms)
    ways = [
        Direction(change=Change(terms=(*cause.change(scene, theta, place).terms, *here)), scale=1.0)
        for place in places[1:]
    ]
    frames, residual, prior = result.kept.frames, scene.target.residual(result.simulated), result.prior
    taken = np.repeat(residual[None], len(places), axis=0)
    motion, late = _pushed(scene, ways, frames), cause.carried(scene, theta, result.place)
    if late is not None:
        motion = carried(motion, np.zeros((0, scene.cloud.count, 2)), late, frames)
    for t, S in zip(frames, motion, strict=True):
        seen = scene.target.seen[t]
        taken[1:, t, seen] -= S[:, seen]
    return np.array([_evidence(result, len(prior), None, result.around, r, prior, model) for r in taken])


def _pushed(scene: Scene, ways: Sequence[Direction], frames: np.ndarray) -> Iterator[np.ndarray]:
    """The motions (W, N, 3) that directions lead to, frame by frame."""

    def forces(local: np.ndarray) -> np.ndarray:
        return np.stack([d.forces(scene, frames[local]) for d in ways], axis=1)

    return responses(scene.energy.frames(frames), scene.y[frames], forces)


def _evidence(
    result: Refit, first: int, rows: Sequence[np.ndarray] | None, at: np.ndarray, residual: np.ndarray,
    prior: np.ndarray, model: Model,
) -> float:  # fmt: skip
    """Of the refit's first columns and a few more motions (d, N, 3) frame by frame, with what they have to explain."""
    seen, kept = result.scene.target.seen, result.kept
    columns = []
    for i, (t, X) in enumerate(zip(kept.frames, kept.columns, strict=True)):
        own = [] if rows is None else [rows[i][:, seen[t]].reshape(len(rows[i]), -1).astype(np.float32)]
        columns.append(np.concatenate([X[:first], *own]))
    normal = Fingerprints(frames=kept.frames, columns=tuple(columns)).parts(residual, seen, at, 1)[0]
    return posterior(normal, prior, np.sqrt(model.s2)).evidence
