"""Another place of a cause that was refitted: what is promised there is what a refit there brings."""

from dataclasses import replace

import numpy as np
import pytest
from test_diagnosis_experiment import NOISE, model, scene  # noqa: F401

from veo_ti.diagnosis.causes.history import Viscoelasticity
from veo_ti.diagnosis.placing import _moved, better_place
from veo_ti.diagnosis.problem import Problem
from veo_ti.diagnosis.refit import refit
from veo_ti.diagnosis.solved import solved

SHARE, TAU, START = 1.5, 1.2, 2.4  # [s]; frames are a second apart


@pytest.fixture(scope="module")
def creeping(scene, model):  # noqa: F811
    """The scene as a viscous material would have moved, and noise."""
    problem = Problem.of(scene, model, Viscoelasticity(), TAU)
    true = solved(problem, scene, np.zeros(len(model.prior)), np.array([SHARE]))
    noise = NOISE * np.random.default_rng(2).normal(size=scene.y.shape)
    return replace(scene, target=replace(scene.target, y=true.scene.y + noise, sigma=NOISE))


def test_what_is_promised_elsewhere_is_what_a_refit_brings_there(creeping, model):  # noqa: F811
    """With all that frames pass on, and the share that goes with the other time constant."""
    places = [START, 0.8 * START, 0.6 * START, 0.5 * START]
    start, half = np.zeros(len(model.prior)), np.array([0.5])
    there = [refit(creeping, model, start, cause=Viscoelasticity(), place=at, theta=half) for at in places]
    found = there[0]
    brought = np.array([r.evidence(model.s2) for r in there])
    promised = _moved(found, model, places)
    assert brought[-1] > brought[0] + 10
    assert promised - promised[0] == pytest.approx(brought - brought[0], abs=0.2 * (brought[-1] - brought[0]))
    assert abs(np.log(better_place(found, model) / TAU)) < 0.4
