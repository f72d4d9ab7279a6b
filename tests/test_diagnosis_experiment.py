"""The measurement that would tell two causes apart: it shows what they differ in."""

from dataclasses import replace

import numpy as np
import pytest
import sim_cases

from sim.basis import Basis, FitOptions
from sim.lame import Lame
from sim.newton import equilibrate
from sim.solvers import LinearSolver
from veo_ti.diagnosis.causes.clocks import ForceTiming
from veo_ti.diagnosis.causes.loads import HiddenForce
from veo_ti.diagnosis.causes.material import StrainStiffening
from veo_ti.diagnosis.causes.measurement import CameraScale
from veo_ti.diagnosis.experiment import separating
from veo_ti.diagnosis.fitted import Refit
from veo_ti.diagnosis.model import Model
from veo_ti.diagnosis.refit import refit
from veo_ti.diagnosis.scene import Scene
from veo_ti.observation import Observation
from veo_ti.scene import cloud_of, energy_of, target_of

FRAMES, NOISE = 7, 1e-4


def scene_of(x: np.ndarray, push: float = 0.005) -> Scene:
    """Points (N, 3) [m], held at x = 0, that are slowly pushed down [N] at the other end and let go."""
    course = np.array([0, 0.3, 0.7, 1.0, 0.7, 0.3, 0.0])
    end = np.exp(-((x - [x[:, 0].max(), 0.2, 0.2]) ** 2).sum(axis=1) / 0.1**2) * (x[:, 0] > 0)
    forces = course[:, None, None] * (end / end.sum())[:, None] * [0, 0, -push]
    still = np.repeat(x[None], FRAMES, axis=0)
    observation = Observation(points=still, time=np.arange(7.0), fixed=x[:, 0] < 1e-9, forces=forces)
    cloud = cloud_of(observation)
    energy = energy_of(observation, cloud)
    energy = energy.with_elastic(type(energy.elastic).neo_hookean(cloud, Lame(mu=1.0, lam=2.0)))
    y = equilibrate(energy, still).require_converged().y
    observation = replace(observation, points=y)
    return Scene(
        observation=observation, energy=energy, y=y, target=target_of(observation), train=np.ones(FRAMES, bool)
    )


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A jittered box."""
    return scene_of(sim_cases.points())


@pytest.fixture(scope="module")
def model(scene) -> Model:
    basis = Basis.of(scene.cloud, FitOptions(modes=4, ratio_modes=0), 1.0)
    solver = LinearSolver.of(scene.energy)
    return Model(basis=basis, prior=basis.prior(0.2, 0.3), s2=NOISE**2, extra=(), solver=solver)


@pytest.fixture(scope="module")
def baseline(scene, model) -> Refit:
    return refit(scene, model, np.zeros(len(model.prior)))


def assumed(baseline: Refit, model: Model, cause, theta, place=None) -> Refit:
    """The baseline as if the cause had been found with these parameters."""
    prior = np.concatenate([model.prior, cause.widths(baseline.scene) ** 2])
    return replace(baseline, cause=cause, place=place, theta=np.array(theta, float), prior=prior)


def test_a_delay_is_told_by_loading_faster(baseline, model):
    """A slow push hides it; the scale of the cameras is large and seen under any load."""
    delay = assumed(baseline, model, ForceTiming(), [2e-3], ForceTiming().places(baseline.scene)[0])
    scale = assumed(baseline, model, CameraScale(), [0.05, 0, 0, 0])
    found = separating(baseline, delay, scale, model, model.s2)
    assert "five times as fast" in found.description
    assert found.then > 5 * found.now > 0


def test_a_cause_cannot_be_told_from_itself(baseline, model):
    spot, elsewhere = (HiddenForce().places(baseline.scene)[i] for i in (5, 9))
    one = assumed(baseline, model, HiddenForce(), [0, 1e-4, 1e-4], spot)
    other = assumed(baseline, model, HiddenForce(), [0, 1e-4, 1e-4], elsewhere)
    same, apart = (separating(baseline, one, second, model, model.s2) for second in (one, other))
    assert same.then < 0.05 * apart.then


def test_a_stiffening_is_compared_as_it_levels_off(baseline, model):
    """However it was followed; the law itself is drowned by what few points are strained most."""
    (place,) = StrainStiffening().places(baseline.scene)
    law, levelled = (
        assumed(baseline, model, StrainStiffening(), [1 / place.levels], at)
        for at in (replace(place, levels=None), place)
    )
    scale = assumed(baseline, model, CameraScale(), [0.05, 0, 0, 0])
    same, other = (separating(baseline, law, second, model, model.s2) for second in (levelled, scale))
    assert same.then < 0.05 * other.then


def test_nothing_is_proposed_where_no_force_is_named(baseline, model, scene):
    bare = replace(scene.observation, forces=0 * scene.observation.forces)
    idle = replace(baseline, scene=replace(scene, observation=bare))
    scale = assumed(baseline, model, CameraScale(), [0.05, 0, 0, 0])
    assert separating(idle, scale, scale, model, model.s2) is None
