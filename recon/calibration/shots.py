"""Which of many moments to calibrate from: those that tell most about the cameras that are known least."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from recon.calibration.charuco import BoardViews
from sim.checks import require


def best_shots(views: Sequence[BoardViews], most: int) -> np.ndarray:
    """At most so many of the shots that show the board to a camera, ascending.

    One after another the shot is taken for which `d / (d + w) sum_c 1 / (1 + n_c)` is largest: over the cameras that
    see the board in it, n_c being their views so far, d the distance to the nearest shot taken (neighbours in time
    are near copies of each other), w the usual distance. Raises ValueError when nothing may be taken.
    """
    require(most >= 1, "most", "be at least 1", most)
    shots = np.unique(np.concatenate([v.shot for v in views]))
    if len(shots) <= most:
        return shots
    seen = np.stack([np.isin(shots, v.seen) for v in views])
    count, usual = np.zeros(len(views)), (shots[-1] - shots[0]) / most
    away, taken = np.full(len(shots), np.inf), []
    for _ in range(most):
        near = np.divide(away, away + usual, out=np.ones(len(shots)), where=np.isfinite(away))
        gain = near * (seen / (1 + count)[:, None]).sum(axis=0)
        gain[taken] = -1.0
        best = int(gain.argmax())
        taken.append(best)
        count += seen[:, best]
        away = np.minimum(away, np.abs(shots - shots[best]))
    return np.sort(shots[taken])


def of_shots(views: BoardViews, shots: np.ndarray) -> BoardViews:
    """The views in these shots only."""
    rows = np.isin(views.shot, shots)
    return replace(views, shot=views.shot[rows], corner=views.corner[rows], pixel=views.pixel[rows])
