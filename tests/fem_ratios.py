"""The simulator over finite elements: how far a loaded body moves in its two modes, per sampling of its points."""

import clouds
import fem_scenes
import numpy as np
import sim_cases

from sim.cloud import CloudOptions, RestCloud
from sim.elastic import Elastic
from sim.energy import Energy
from sim.lame import Lame
from sim.newton import NewtonOptions, equilibrate
from sim.terms.loads import AppliedForce
from veo_ti.body import sample_box

GRAVITY = (2e-3, 6e-3, 1.2e-2)  # [N/m3]
SAMPLINGS = ("poisson", "jittered", "regular")


def sample(kind: str, scene: fem_scenes.Scene, across: int, count: int) -> np.ndarray:
    """Points of the scene's box with its faces: `count` Poisson points, or a grid of `across` points a side."""
    size = scene.upper - scene.lower
    if kind == "poisson":
        return sample_box(size, count, corner=scene.lower).x
    counts = tuple(np.rint(size / size[2] * (across - 1)).astype(int) + 1)
    return clouds.block(counts, tuple(size), tuple(scene.lower), jitter=0.2 if kind == "jittered" else 0.0)


def body(x: np.ndarray, scene: fem_scenes.Scene, mode: str) -> Elastic:
    cloud = RestCloud.build(x, options=CloudOptions(mode=mode))
    return Elastic.neo_hookean(cloud, Lame(mu=scene.mu(x), lam=scene.lam(x)))


def displacement(elastic: Elastic, force: np.ndarray) -> np.ndarray:
    """Displacement (T, N, 3) [m] under forces (T, N, 3) [N], clamped at x = 0."""
    x = elastic.cloud.x
    energy = Energy.of(elastic, [AppliedForce(force=force)], x[:, 0] < 1e-9)
    options = NewtonOptions(tolerance=1e-6)
    return equilibrate(energy, sim_cases.at_rest(elastic.cloud, len(force)), options=options).require_converged().y - x


def cantilever_ratios(kind: str, mode: str) -> np.ndarray:
    """Drop of the free end over that of finite elements, for the three loads."""
    scenes = [fem_scenes.cantilever(g) for g in GRAVITY]
    x = sample(kind, scenes[0], across=9, count=4000)
    elastic = body(x, scenes[0], mode)
    force = elastic.cloud.volume[None, :, None] * np.array([s.body_force for s in scenes])[:, None]
    end = x[:, 0] > 1 - 1e-9
    drop = displacement(elastic, force)[:, end, 2].mean(axis=1)
    return drop / [s.displacement(x[end])[:, 2].mean() for s in scenes]


def block_ratio(axis: int, mode: str, kind: str = "poisson") -> tuple[float, float]:
    """Motion of the pulled face over that of finite elements, and the worst point's error over the largest motion."""
    scene = fem_scenes.two_material_block(axis)
    x = sample(kind, scene, across=13, count=4000)
    elastic = body(x, scene, mode)
    share = np.where(x[:, 0] > 1 - 1e-9, elastic.cloud.area[:, 0], 0.0)
    force = 0.25 * share[:, None] / share.sum() * scene.traction  # the face measures 0.25 m2
    u, exact = displacement(elastic, force[None])[0], scene.displacement(x)
    end = x[:, 0] > 1 - 1e-9
    worst = np.linalg.norm(u - exact, axis=1).max() / np.linalg.norm(exact, axis=1).max()
    return float(np.linalg.norm(u[end].mean(axis=0)) / np.linalg.norm(exact[end].mean(axis=0))), float(worst)
