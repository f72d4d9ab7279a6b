"""Clouds, materials and random states that the tests of the simulator share."""

from collections.abc import Callable
from functools import lru_cache

import clouds
import numpy as np

from sim.cloud import CloudOptions, RestCloud
from sim.elastic import Elastic
from sim.energy import Energy
from sim.lame import Lame
from sim.terms.loads import AppliedForce
from veo_ti.body import sample_box

SIZE = np.array([1.0, 0.5, 0.4])  # [m]


@lru_cache
def points(kind: str = "jittered", count: int = 200) -> np.ndarray:
    """Points (N, 3) [m] of the box from 0 to SIZE, its faces included; `count` is met by "poisson" only."""
    if kind == "poisson":
        return sample_box(SIZE, count).x
    return clouds.block((8, 5, 4), tuple(SIZE), jitter=0.25 if kind == "jittered" else 0.0)


@lru_cache
def cloud(kind: str = "jittered", mode: str = "consistent", count: int = 200) -> RestCloud:
    """The rest cloud of those points."""
    return RestCloud.build(points(kind, count), options=CloudOptions(mode=mode))


def material(cloud: RestCloud, seed: int = 0, contrast: float = 3.0) -> Lame:
    """Per-point parameters, each drawn from a decade-like range of the given contrast."""
    random = np.random.default_rng(seed)
    return Lame(mu=contrast ** random.uniform(0, 1, cloud.count), lam=2 * contrast ** random.uniform(0, 1, cloud.count))


@lru_cache
def elastic(kind: str = "jittered", mode: str = "consistent", count: int = 200) -> Elastic:
    """A body with a different material at every point."""
    body = cloud(kind, mode, count)
    return Elastic.neo_hookean(body, material(body))


def bent(cloud: RestCloud, frames: int = 2, seed: int = 0) -> np.ndarray:
    """Turned, sheared, bent and rough states (T, N, 3) [m] with J > 0, without any symmetry."""
    random = np.random.default_rng(seed)
    states = []
    for _ in range(frames):
        turn = clouds.rotation(random.uniform(0.5, 2.5), tuple(random.normal(size=3)))
        F = turn @ (np.eye(3) + random.uniform(-0.2, 0.2, (3, 3)))
        wave = 0.05 * np.sin(3 * cloud.x @ random.normal(size=(3, 3)))
        rough = 0.02 * cloud.spacing * random.normal(size=cloud.x.shape)
        states.append((cloud.x + wave + rough) @ F.T + random.normal(size=3))
    return np.array(states)


def clamped(elastic: Elastic, load: np.ndarray) -> Energy:
    """The body clamped at x = 0 under one total force per frame, load (T, 3) [N], spread by volume."""
    share = elastic.cloud.volume / elastic.cloud.volume.sum()
    force = AppliedForce(force=share[:, None] * np.asarray(load, float)[:, None])
    return Energy.of(elastic, [force], elastic.cloud.x[:, 0] < 1e-9)


def at_rest(cloud: RestCloud, frames: int) -> np.ndarray:
    """The rest pose in every frame, (T, N, 3) [m]."""
    return np.repeat(cloud.x[None], frames, axis=0)


def taylor_rate(value: Callable, slope: np.ndarray, x: np.ndarray, way: np.ndarray, step: float = 1e-2) -> float:
    """Order in h of the remainder |value(x + h way) - value(x) - h slope|, from h = step and step / 10."""
    remainder = [np.linalg.norm(value(x + h * way) - value(x) - h * slope) for h in (step, step / 10)]
    return float(np.log10(remainder[0] / remainder[1]))


def relative(a: np.ndarray, b: np.ndarray) -> float:
    """|a - b| / |b|."""
    return float(np.linalg.norm(np.asarray(a) - b) / np.linalg.norm(b))
