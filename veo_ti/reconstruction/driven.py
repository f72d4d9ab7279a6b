"""Frames in which the nozzle alone moves the object: motion by forces that nobody measured teaches no material."""

import numpy as np

from veo_ti.observation import Observation
from veo_ti.scene import cloud_of, forces_of

_ACTS = 1e-4  # of the largest frame's sum of forces, above which the stream, wider than assumed, may meet the object
_RESTS = 0.005  # of the object's size: nineteen points in twenty of an object at rest never seem to be further off
_NOISE = 3.0  # times what the quietest quarter of frames without stream seem to move by


def driven_frames(observation: Observation) -> np.ndarray:
    """Numbers of the frames in which the stream meets the object, or the object rests; all when it never does.

    Left out are those in which it moves though nothing known acts: before the air stream sweeps over it, the object is
    pulled by fishing lines whose tension is not measured (paper, "Capture").
    """
    force = np.linalg.norm(forces_of(observation, cloud_of(observation)), axis=2).sum(axis=1)
    acts = force > _ACTS * force.max()
    calm = np.flatnonzero(~acts[1:]) + 1
    if not acts.any() or not len(calm):
        return np.arange(len(force))
    moved = np.linalg.norm(observation.points - observation.points[:1], axis=2)
    most, nearly = np.quantile(moved, (0.95, 0.99), axis=1)
    size = np.linalg.norm(np.ptp(observation.points[0], axis=0))
    rests = (most < _RESTS * size) & (nearly <= _NOISE * np.quantile(nearly[calm], 0.25))
    return np.flatnonzero(acts | rests)
