"""Where a cause acts, looked at again once the material has been refitted beside it."""

from typing import Any

import numpy as np

from sim.evidence import posterior
from veo_ti.diagnosis.columns import directions_of
from veo_ti.diagnosis.model import Model, Refit
from veo_ti.diagnosis.moments import Fingerprints


def better_place(result: Refit, model: Model) -> Any:
    """The place at which a refitted cause explains best what its own motion leaves, the material moving with it.

    Only for causes that follow the simulated motion and push nothing, such as inertia: the motion is then that of every
    place. The others keep theirs.
    """
    scene, cause = result.without, result.cause
    if cause.carried(scene, result.theta, result.place) is None:
        return result.place
    places = [result.place, *cause.places(scene), *cause.near(scene, result.place)]
    evidence = [_evidence(result, model, place) for place in places]
    return places[int(np.argmax(evidence))]


def _evidence(result: Refit, model: Model, place: Any) -> float:
    """Of material and cause together, linear about the refit without the cause."""
    scene, cause, n = result.without, result.cause, len(result.coefficients)
    directions = directions_of(cause, scene, place)
    columns = []
    for t, X in zip(result.kept.frames, result.kept.columns, strict=True):
        index, seen = np.array([t]), scene.target.seen[t]
        moves = np.stack([d.moves(scene, index)[0, seen].ravel() for d in directions])
        columns.append(np.concatenate([X[:n], moves.astype(np.float32)]))
    at = np.concatenate([result.around[:n], np.zeros(len(directions))])
    residual = scene.target.residual(scene.y)
    prints = Fingerprints(frames=result.kept.frames, columns=tuple(columns))
    normal = prints.parts(residual, scene.target.seen, at, 1)[0]
    prior = np.concatenate([model.prior, cause.widths(scene) ** 2])
    return posterior(normal, prior, np.sqrt(model.s2)).evidence
