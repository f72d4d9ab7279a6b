"""Rigid motions (4, 4) and how a small turn moves a point: what calibration and tracking share."""

import numpy as np
from scipy.spatial.transform import Rotation

from sim.checks import require


def rigid(turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """The motion (..., 4, 4) `p -> R p + shift` of rotation vectors `turn` (..., 3) [rad], shift (..., 3) [m]."""
    turn, shift = np.asarray(turn, float), np.asarray(shift, float)
    T = np.zeros((*turn.shape[:-1], 4, 4))
    T[..., :3, :3] = Rotation.from_rotvec(turn.reshape(-1, 3)).as_matrix().reshape(*turn.shape, 3)
    T[..., :3, 3], T[..., 3, 3] = shift, 1.0
    return T


def inverse(T: np.ndarray) -> np.ndarray:
    """The motions (..., 4, 4) that undo T."""
    back = np.zeros_like(T)
    back[..., :3, :3] = np.swapaxes(T[..., :3, :3], -1, -2)
    back[..., :3, 3] = -np.einsum("...ij,...j->...i", back[..., :3, :3], T[..., :3, 3])
    back[..., 3, 3] = 1.0
    return back


def moved(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """`T p` of points (..., 3) [m], for one motion (4, 4) or as many as there are points."""
    return np.einsum("...ij,...j->...i", T[..., :3, :3], points) + T[..., :3, 3]


def turn_of(T: np.ndarray) -> np.ndarray:
    """The rotation vectors (..., 3) [rad] of motions or rotations (..., 3 or 4, 3 or 4)."""
    R = T[..., :3, :3]
    return Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(R.shape[:-1])


def cross_matrix(v: np.ndarray) -> np.ndarray:
    """`[v]` (..., 3, 3) with `[v] p = v x p`."""
    x, y, z = np.moveaxis(np.asarray(v, float), -1, 0)
    zero = np.zeros_like(x)
    rows = [np.stack(row, axis=-1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))]
    return np.stack(rows, axis=-2)


def between(first: np.ndarray, last: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Motions (n, 4, 4) at shares (n,) of the way from `first` to `last` (n, 4, 4): evenly turned, evenly shifted."""
    R, share = first[:, :3, :3], np.asarray(share, float)[:, None]
    require(len(first) == len(last) == len(share), "share", f"have length {len(first)}", len(share))
    whole = turn_of(last[:, :3, :3] @ np.swapaxes(R, 1, 2))
    T = rigid(share * whole, (1 - share) * first[:, :3, 3] + share * last[:, :3, 3])
    T[:, :3, :3] = T[:, :3, :3] @ R
    return T
