"""The discretisation's own columns: how the motion changes with other neighbours."""

from dataclasses import replace

import clouds
import numpy as np
import pytest
from test_diagnosis_experiment import model, scene, scene_of  # noqa: F401

from sim.checks import require
from sim.cloud import RestCloud
from veo_ti.diagnosis.columns import discretisation
from veo_ti.diagnosis.looks import Tried
from veo_ti.diagnosis.noise import counted, measure_noise
from veo_ti.diagnosis.refit import refit


def test_discretisation_columns_are_small_beside_the_motion(scene):  # noqa: F811
    motion = np.linalg.norm(scene.y - scene.cloud.x)
    for known in discretisation(scene):
        assert 0 < np.linalg.norm(known.motion) < 0.5 * motion


@pytest.mark.parametrize(("layers", "push", "coarse"), [(2, 3e-4, True), (4, 5e-3, False)])
def test_two_layers_of_points_are_too_few_for_a_plate_that_bends(layers, push, coarse, model):  # noqa: F811
    plate = scene_of(clouds.block((9, 5, layers), (0.8, 0.4, 0.1 * (layers - 1)), jitter=0.15), push)
    assert replace(model, extra=discretisation(plate)).coarse == coarse


def test_a_choice_of_neighbours_that_leaves_a_point_flat_is_left_out(scene, monkeypatch):  # noqa: F811
    """Six neighbours may lie in a plane where a body is thin."""
    every, build = discretisation(scene), RestCloud.build

    def thin(x, *, options, **more):
        require(options.neighbours != 6, "x", "surround every point in three directions", "flat neighbourhoods")
        return build(x, options=options, **more)

    monkeypatch.setattr(RestCloud, "build", thin)
    assert np.array_equal([k.motion for k in discretisation(scene)], [every[0].motion, every[2].motion])


def test_what_the_discretisation_explains_does_not_count_as_left(scene, model):  # noqa: F811
    """A measurement by a simulation whose neighbours are others: its difference from ours is no misfit."""
    known = discretisation(scene)
    off = replace(scene, target=replace(scene.target, y=scene.y + known[0].motion))
    model = replace(model, prior=np.append(1e-6 * model.prior, np.ones(len(known))), extra=known)  # a known material
    found = refit(off, model, np.zeros(len(model.prior)))
    assert np.linalg.norm(found.scene.residual) > np.linalg.norm(off.residual)  # the material is bent, too
    assert np.linalg.norm(found.left.residual) < 0.5 * np.linalg.norm(off.residual)
    modes = model.basis.field.modes[:, :2]
    assert Tried.of(found, model, modes, fine=True).left < 0.1 * counted(off, measure_noise(off, modes), modes)
