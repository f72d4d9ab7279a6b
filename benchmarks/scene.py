"""The bodies that are measured: a bar of jittered grid points, clamped at one end."""

from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from sim.cloud import RestCloud
from sim.elastic import Elastic
from sim.energy import Energy
from sim.lame import Lame
from sim.runtime import serial_blas
from sim.terms.loads import AppliedForce

SIZE = np.array([2.0, 1.0, 0.75])  # [m]
YOUNG, POISSON = 1e5, 0.4  # [Pa]


@lru_cache
def cloud(points: int) -> RestCloud:
    """About `points` points that fill the bar; spacing grows as the count falls."""
    counts = np.rint(SIZE / SIZE[2] * 1.5 * (points / 12) ** (1 / 3)).astype(int)
    axes = [np.linspace(0, length, count) for length, count in zip(SIZE, counts, strict=True)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = (x > 1e-9) & (x < SIZE - 1e-9)
    x += np.random.default_rng(0).uniform(-0.15, 0.15, x.shape) * SIZE / (counts - 1) * inside
    with serial_blas():
        return RestCloud.build(x, volume=float(SIZE.prod()))


def material(cloud: RestCloud, contrast: float) -> Lame:
    """A checkerboard of half-metre cubes whose stiffness differs by `contrast`."""
    stiff = (cloud.x // 0.5).sum(axis=1) % 2 == 1
    return Lame.from_young(YOUNG * np.where(stiff, contrast, 1.0), POISSON)


def bar(points: int, frames: int, contrast: float = 1.0, force: float = 1500.0) -> Energy:
    """The bar clamped at x = 0, pulled by a total dead force [N] across its axis, another direction every frame."""
    body = cloud(points)
    angle = 2 * np.pi * np.arange(frames) / frames
    total = force * np.stack([0.2 * np.sin(3 * angle), np.cos(angle), np.sin(angle)], axis=1)
    share = body.volume / body.volume.sum()
    load = AppliedForce(force=share[:, None] * total[:, None])
    return Energy.of(Elastic.neo_hookean(body, material(body, contrast)), [load], body.x[:, 0] < 1e-9)


def twisted(energy: Energy, frames: int) -> np.ndarray:
    """States (T, N, 3) [m]: stretched and twisted along the axis, more every frame, then turned by 80 to 120 degrees.

    Far from rest, and yet the Hessian is positive definite there, so that a Cholesky factor exists.
    """
    middle = energy.elastic.cloud.x - [0.0, *SIZE[1:] / 2]
    states = []
    for t, share in enumerate(np.arange(1, frames + 1) / frames):
        turned = Rotation.from_rotvec(0.3 * share * middle[:, :1] * [1.0, 0.0, 0.0]).apply(middle)
        axis = np.array([np.sin(t), np.cos(t), 1.0]) / np.sqrt(2)
        whole = Rotation.from_rotvec(np.radians(80 + 40 * share) * axis)
        states.append(whole.apply(turned * [1 + 0.1 * share, 1.0, 1.0]))
    return np.array(states)


def at_rest(energy: Energy, frames: int) -> np.ndarray:
    """The rest pose in every frame, (T, N, 3) [m]."""
    return np.repeat(energy.elastic.cloud.x[None], frames, axis=0)
