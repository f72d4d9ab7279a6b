"""Whether all cameras filmed the same moment: what moves, moves in all their pictures at once."""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from sim.checks import as_array, require

SMALL = 64  # [px], the width at which pictures are compared: what is left is motion, not noise
FEWEST = 16  # changes between frames from which an offset can be told
ALIKE = 0.5  # correlation from which two curves show the same motion


@dataclass(frozen=True, kw_only=True, eq=False)
class Sync:
    """offset (C,) [frames], positive where a camera shows things later than most; alike (C,): the correlation there.

    known (C,) bool: whether frames and motion were enough to tell; where not, offset is 0.
    """

    offset: np.ndarray
    alike: np.ndarray
    known: np.ndarray


def motion_energy(images: Iterable[np.ndarray]) -> np.ndarray:
    """Mean change of brightness from each picture to the next in grey levels, one fewer than there are pictures."""
    before, change = None, []
    for image in images:
        height = max(1, round(SMALL * image.shape[0] / image.shape[1]))
        small = cv2.resize(image, (SMALL, height), interpolation=cv2.INTER_AREA).astype(np.float32)
        if before is not None:
            change.append(float(np.abs(small - before).mean()))
        before = small
    return np.array(change)


def estimate_offsets(energy: np.ndarray, most: int = 20) -> Sync:
    """How many frames each camera is late, by correlating its motion energy (C, F) with the cameras' median.

    Curves are compared after mean and spread are taken out; lags up to `most` frames, and a quarter of them, are tried.
    Raises ValueError for NaN or fewer than two cameras.
    """
    energy = as_array("energy", energy, (None, None))
    require(len(energy) >= 2, "energy", "hold at least two cameras", len(energy))
    count, frames = energy.shape
    if frames < FEWEST:
        return Sync(offset=np.zeros(count, int), alike=np.zeros(count), known=np.zeros(count, bool))
    shown = np.stack([_standard(curve) for curve in energy])
    lags = np.arange(-min(most, frames // 4), min(most, frames // 4) + 1)
    reference = np.median(shown, axis=0)
    scores = np.array([[_alike(curve, reference, lag) for lag in lags] for curve in shown])
    best = scores.argmax(axis=1)
    alike = scores[np.arange(count), best]
    known = alike >= ALIKE
    return Sync(offset=np.where(known, lags[best], 0), alike=alike, known=known)


def _standard(curve: np.ndarray) -> np.ndarray:
    return (curve - curve.mean()) / max(curve.std(), 1e-9)


def _alike(curve: np.ndarray, reference: np.ndarray, lag: int) -> float:
    """The correlation of curve[t + lag] with reference[t] where both are known."""
    late, early = curve[max(0, lag) : len(curve) + min(0, lag)], reference[max(0, -lag) : len(curve) - max(0, lag)]
    return float((_standard(late) * _standard(early)).mean())
