"""Poses between the frames in which a body was seen: interpolated, with an uncertainty that says so."""

import numpy as np

from recon.rigid import between, turn_of


def filled(T: np.ndarray, covariance: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses (T, 4, 4) and covariances (T, 6, 6) with the frames not seen (T,) bool filled from those that were.

    Between two seen frames the body turns and shifts evenly; before the first and after the last it keeps their
    pose. The covariance adds to the shares of both ends that of a random walk pinned at them,
    `q a b / (a + b)` with a and b frames to either end, or `q a` beyond the last; q (6,) is the mean square of the
    body's own steps between neighbouring seen frames. At least one frame must be seen.
    """
    at = np.flatnonzero(seen)
    every = np.arange(len(seen))
    after = np.searchsorted(at, every)
    right, left = at[np.minimum(after, len(at) - 1)], at[np.maximum(after - 1, 0)]
    left = np.where(seen, every, np.where(every < at[0], right, left))
    right = np.where(seen, every, right)
    span = right - left
    share = np.divide(every - left, span, out=np.zeros(len(seen)), where=span > 0)
    held = np.where(span == 0, np.abs(every - left), 0)
    walk = share * (1 - share) * span + held
    spread = (1 - share)[:, None, None] ** 2 * covariance[left] + share[:, None, None] ** 2 * covariance[right]
    spread[~seen] += walk[~seen, None, None] * np.diag(_step(T, at))
    return between(T[left], T[right], share), spread


def _step(T: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Mean square turn and shift (6,) a frame, between seen frames `at`; infinite for a single one."""
    if len(at) < 2:
        return np.full(6, np.inf)
    first, last, frames = T[at[:-1]], T[at[1:]], np.diff(at)
    turn = turn_of(last[:, :3, :3] @ np.swapaxes(first[:, :3, :3], 1, 2))
    step = np.concatenate([turn, last[:, :3, 3] - first[:, :3, 3]], axis=1)
    return (step**2 / frames[:, None]).mean(axis=0)
