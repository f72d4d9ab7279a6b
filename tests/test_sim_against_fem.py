"""The simulator in its two modes beside finite elements: a cantilever bent by 8, 22, 41 % and a two-material block."""

import clouds
import fem_scenes
import numpy as np
import pytest
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


@pytest.mark.parametrize("kind", SAMPLINGS)
def test_cantilever_is_within_two_percent_of_finite_elements(kind):
    ratios = cantilever_ratios(kind, "consistent")
    assert np.abs(ratios - 1).max() < 0.02, f"tip over FEM at 8, 22, 41 %: {ratios.round(4)}"


def test_cantilever_of_the_papers_plain_scheme_is_too_soft():
    ratios = cantilever_ratios("poisson", "paper")
    # On a regular grid its neighbours are the grid's axes and the error is 4 %; on real clouds it is this.
    assert (ratios > 1.3).all(), f"tip over FEM at 8, 22, 41 %: {ratios.round(4)}"


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


@pytest.mark.parametrize("axis", [0, 2])
def test_two_material_block_is_within_two_percent_of_finite_elements(axis):
    ratio, worst = block_ratio(axis, "consistent")
    assert abs(ratio - 1) < 0.02, f"pulled face over FEM: {ratio:.4f}"
    assert worst < 0.03, f"worst point: {worst:.4f} of the largest motion"


def test_two_material_block_of_the_papers_plain_scheme_is_too_soft():
    ratio, _ = block_ratio(0, "paper")
    assert ratio > 1.15, f"pulled face over FEM: {ratio:.4f}"
