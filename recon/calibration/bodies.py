"""Poses of many rigid bodies from pictures of calibrated cameras, all fitted at once."""

from dataclasses import dataclass

import numpy as np

from recon.calibration.sightings import Projection, Sightings, projected
from recon.rigid import rigid

_CLOSE = 1e-8  # smallest relative gain of a step that is worth another
_UP, _DOWN = 8.0, 0.2  # of the damping after a bad and a good step
_DAMPING = (1e-3, 1e-12, 1e4)  # at first, least, most


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyFit:
    """Fitted poses, their normal matrices `J^T W J` (turn, then shift, in the world), and what remains."""

    T_world_body: np.ndarray  # (B, 4, 4) [m]
    normal: np.ndarray  # (B, 6, 6) [px2 by rad, m]
    residual: np.ndarray  # (M, 2) [px]
    cost: np.ndarray  # (B,) [px2], sum of squares, beyond `loose` growing like Huber's loss


def fitted_bodies(
    lens: np.ndarray,
    T_camera_world: np.ndarray,
    T_world_body: np.ndarray,
    sightings: Sightings,
    *,
    loose: float,
    iterations: int = 60,
) -> BodyFit:
    """Each body's pose of least `sum rho(|predicted - seen|)` from the start T_world_body (B, 4, 4).

    Levenberg and Marquardt's steps, each body with its own damping; rho is Huber's: a square up to `loose` [px],
    a line beyond. lens (C, 18) and T_camera_world (C, 4, 4) stay as they are.
    """
    T, damping = T_world_body, np.full(len(T_world_body), _DAMPING[0])
    seen = projected(lens, T_camera_world, T, sightings)
    cost, moving = _cost(seen, sightings, len(T), loose), np.ones(len(T), bool)
    for _ in range(iterations):
        A, slope = _normal(seen, sightings, len(T), loose)
        step = np.linalg.solve(_damped(A, damping), -slope[..., None])[..., 0]
        tried = _stepped(T, step * moving[:, None])
        there = projected(lens, T_camera_world, tried, sightings)
        found = _cost(there, sightings, len(T), loose)
        better = moving & (found < cost)
        moving &= np.where(better, cost - found > _CLOSE * cost, damping < _DAMPING[2])
        T, cost = np.where(better[:, None, None], tried, T), np.where(better, found, cost)
        damping = np.clip(np.where(better, _DOWN, _UP) * damping, *_DAMPING[1:])
        seen = there.where(better[sightings.body], seen)
        if not moving.any():
            break
    A, _ = _normal(seen, sightings, len(T), loose)
    return BodyFit(T_world_body=T, normal=A, residual=seen.pixel - sightings.pixel, cost=cost)


def huber(residual: np.ndarray, loose: float) -> tuple[np.ndarray, np.ndarray]:
    """Loss (M,) [px2] and weight (M,) of residuals (M, 2): `r^2` and 1 up to `loose`, `2 loose r - loose^2` beyond."""
    r = np.linalg.norm(residual, axis=1)
    return np.where(r <= loose, r**2, 2 * loose * r - loose**2), loose / np.maximum(r, loose)


def _cost(seen: Projection, sightings: Sightings, bodies: int, loose: float) -> np.ndarray:
    loss, _ = huber(seen.pixel - sightings.pixel, loose)
    return np.bincount(sightings.body, loss, minlength=bodies)


def _normal(seen: Projection, sightings: Sightings, bodies: int, loose: float) -> tuple[np.ndarray, np.ndarray]:
    """`J^T W J` (B, 6, 6) and `J^T W r` (B, 6)."""
    residual = seen.pixel - sightings.pixel
    _, weight = huber(residual, loose)
    weighted = weight[:, None, None] * seen.by_body
    A, slope = np.zeros((bodies, 6, 6)), np.zeros((bodies, 6))
    np.add.at(A, sightings.body, np.einsum("mia,mib->mab", weighted, seen.by_body))
    np.add.at(slope, sightings.body, np.einsum("mia,mi->ma", weighted, residual))
    return A, slope


def _damped(A: np.ndarray, damping: np.ndarray) -> np.ndarray:
    diagonal = np.einsum("baa->ba", A)
    floor = 1e-12 * diagonal.max(axis=1, keepdims=True) + np.finfo(float).tiny
    return A + (damping[:, None] * diagonal + floor)[:, :, None] * np.eye(6)


def _stepped(T: np.ndarray, step: np.ndarray) -> np.ndarray:
    moved = T.copy()
    moved[:, :3, :3] = rigid(step[:, :3], np.zeros_like(step[:, :3]))[:, :3, :3] @ T[:, :3, :3]
    moved[:, :3, 3] += step[:, 3:]
    return moved
