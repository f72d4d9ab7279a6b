"""Whether all cameras filmed the same moment: what moves, moves in all their pictures at once."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import uniform_filter1d

from sim.checks import as_array, require

SMALL = 64  # [px], the width at which pictures are compared: what is left is motion, not noise
FEWEST = 16  # changes between frames from which an offset can be told
SLOW = 7  # changes over which a curve's slow part is taken out: it differs from view to view, and neighbours share it
IN_STEP, UNRELATED = 0.81, 0.1  # how probable it is beforehand that a camera is in step, or shows another motion
SURE = 0.95  # probability from which an offset is told
ALIKE = 0.3  # and correlation
ROUNDS = 2  # of comparing: the second one against cameras that the first one found in step


@dataclass(frozen=True, kw_only=True, eq=False)
class Sync:
    """offset (C,) [frames], positive where a camera shows things later than most; alike (C,): the correlation there.

    sure (C,): the probability of that offset; known (C,) bool: whether that is enough to tell; where not, offset is 0.
    enough: whether there were enough frames to compare at all.
    """

    offset: np.ndarray
    alike: np.ndarray
    sure: np.ndarray
    known: np.ndarray
    enough: bool


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


def estimate_offsets(energy: np.ndarray, most: int = 20, devices: Sequence[str] | None = None) -> Sync:
    """How many frames each camera is late, by correlating its motion energy (C, F) with the other cameras' mean.

    Root of the energy, less its slow part; lags up to `most` frames, and a quarter of them, are tried. A lag whose
    correlation over n changes is r has the likelihood `(1 - r^2)^(-(n - 3) / 2)` beside no relation at all, that of a
    straight line with unknown slope and noise (r > 0); with the probabilities beforehand this gives that of each lag.
    devices: which device each camera is of; those of one device see alike, and do not speak for each other.
    Raises ValueError for NaN, a negative energy or fewer than two devices.
    """
    energy = as_array("energy", energy, (None, None))
    require(len(energy) >= 2, "energy", "hold at least two cameras", len(energy))
    own = np.arange(len(energy)) if devices is None else np.asarray(devices)
    require(len(own) == len(energy) and len(set(own.tolist())) >= 2, "devices", "be at least two", list(own))
    require(bool((energy >= 0).all()), "energy", "not be negative", float(energy.min()))
    count, frames = energy.shape
    offset, alike, sure = np.zeros(count, int), np.zeros(count), np.zeros(count)
    if frames < FEWEST:
        return Sync(offset=offset, alike=alike, sure=sure, known=sure > 0, enough=False)
    lags = np.arange(-min(most, frames // 4), min(most, frames // 4) + 1)
    curves = np.sqrt(energy)
    curves = curves - uniform_filter1d(curves, SLOW, axis=1, mode="reflect")
    trusted = np.ones(count, bool)
    for _ in range(ROUNDS):
        found = [
            _best(curve, _mean(curves, own != device, trusted), lags) for curve, device in zip(curves, own, strict=True)
        ]
        offset, alike, sure = (np.array(column) for column in zip(*found, strict=True))
        known = (sure >= SURE) & (alike >= ALIKE)
        trusted = known & (offset == 0)
    return Sync(offset=np.where(known, offset, 0), alike=alike, sure=sure, known=known, enough=True)


def _mean(curves: np.ndarray, other: np.ndarray, trusted: np.ndarray) -> np.ndarray:
    """The mean of the other cameras' curves, of the trusted ones where there are any."""
    chosen = other & trusted if (other & trusted).any() else other
    return np.mean([_standard(curve) for curve in curves[chosen]], axis=0)


def _best(curve: np.ndarray, reference: np.ndarray, lags: np.ndarray) -> tuple[int, float, float]:
    """The most probable lag, the correlation there and its probability."""
    r = np.clip([_alike(curve, reference, lag) for lag in lags], 0, 0.999)
    beforehand = np.where(lags == 0, IN_STEP, (1 - IN_STEP - UNRELATED) / max(1, len(lags) - 1))
    weight = beforehand * (1 - r * r) ** (-(len(curve) - np.abs(lags) - 3) / 2)
    best = int(weight.argmax())
    return int(lags[best]), float(r[best]), float(weight[best] / (weight.sum() + UNRELATED))


def _standard(curve: np.ndarray) -> np.ndarray:
    return (curve - curve.mean()) / max(curve.std(), 1e-9)


def _alike(curve: np.ndarray, reference: np.ndarray, lag: int) -> float:
    """The correlation of curve[t + lag] with reference[t] where both are known."""
    late, early = curve[max(0, lag) : len(curve) + min(0, lag)], reference[max(0, -lag) : len(curve) - max(0, lag)]
    return float((_standard(late) * _standard(early)).mean())
