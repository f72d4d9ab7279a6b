"""One pose a frame out of several that fit: the best where it stands alone, else the one the neighbours point to."""

import numpy as np

from recon.nozzle.consensus import Hypotheses
from recon.nozzle.gaps import filled
from recon.rigid import inverse, turn_of

_RIVAL = 16.0  # chi-squared within which a pose explains the same finds as well as the best
_CLEAR = 0.5  # the neighbouring frames decide when their pose is nearer to one rival by this factor
_SAME = (0.05, 0.02)  # [rad], sides of the marker: poses nearer than this are one


def noise_of(poses: Hypotheses, rows: np.ndarray) -> float:
    """Standard deviation [px] of one coordinate of a corner, from what the poses `rows` leave unexplained."""
    spare = 8 * poses.views[rows].sum() - 6 * len(rows)
    return float(np.sqrt(poses.cost[rows].sum() / spare))


def chosen(poses: Hypotheses, frames: int, side: float) -> tuple[np.ndarray, np.ndarray]:
    """The pose (T,) of each frame, -1 where there is none or no telling, and (T,) bool where neighbours decided.

    More cameras win; among as many, poses of the same finds are rivals when they fit about as well, and poses of
    different finds always, for then one camera contradicts another and nothing in the frame says which is right.
    """
    rivals = _rivals(poses, frames, side)
    sure = np.array([len(r) == 1 for r in rivals])
    best = np.array([r[0] if len(r) else -1 for r in rivals], int)
    pick = np.where(sure, best, -1)
    open_ = np.flatnonzero((best >= 0) & ~sure)
    if not sure.any():
        return pick, np.zeros(frames, bool)
    T = np.tile(np.eye(4), (frames, 1, 1))
    T[sure] = poses.T_world_marker[best[sure]]
    guess, _ = filled(T, np.zeros((frames, 6, 6)), sure)
    for f in open_:
        away = np.array([_apart(guess[f], poses.T_world_marker[h], side) for h in rivals[f]])
        nearest, second = np.argsort(away)[:2]
        if away[nearest] < _CLEAR * away[second]:
            pick[f] = rivals[f][nearest]
    return pick, (pick >= 0) & ~sure


def _rivals(poses: Hypotheses, frames: int, side: float) -> list[list[int]]:
    """For each frame the best pose and every other that could be the true one."""
    order = np.lexsort([poses.cost, -poses.views])
    ranked = [[] for _ in range(frames)]
    for h in order[poses.views[order] > 0]:
        ranked[poses.frame[h]].append(int(h))
    best = np.array([r[0] for r in ranked if r], int)
    margin = _RIVAL * noise_of(poses, best) ** 2
    pair = poses.pair[np.argsort(poses.pair[:, 0], kind="stable")]
    finds = np.split(pair[:, 1], np.searchsorted(pair[:, 0], np.arange(1, len(poses.frame))))
    rests_on = [frozenset(f.tolist()) for f in finds]
    return [_standing(poses, r, margin, rests_on, side) for r in ranked]


def _standing(
    poses: Hypotheses, ranked: list[int], margin: float, rests_on: list[frozenset[int]], side: float
) -> list[int]:
    kept: list[int] = []
    for h in ranked:
        fits = not kept or rests_on[h] != rests_on[kept[0]] or poses.cost[h] - poses.cost[kept[0]] < margin
        alone = all(not _same(poses.T_world_marker[h], poses.T_world_marker[k], side) for k in kept)
        if poses.views[h] == poses.views[ranked[0]] and fits and alone:
            kept.append(h)
    return kept


def _difference(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """Turn [rad] and shift [m] between two poses."""
    return float(np.linalg.norm(turn_of(inverse(one) @ other))), float(np.linalg.norm(one[:3, 3] - other[:3, 3]))


def _same(one: np.ndarray, other: np.ndarray, side: float) -> bool:
    turn, shift = _difference(one, other)
    return turn < _SAME[0] and shift < _SAME[1] * side


def _apart(one: np.ndarray, other: np.ndarray, side: float) -> float:
    """Sum of the turn [rad] and the shift in sides of the marker."""
    turn, shift = _difference(one, other)
    return turn + shift / side
