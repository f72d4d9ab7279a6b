"""The discretisation's own columns: how the motion changes with other neighbours."""

import numpy as np
from test_diagnosis_experiment import scene  # noqa: F401

from sim.checks import require
from sim.cloud import RestCloud
from veo_ti.diagnosis.columns import discretisation


def test_discretisation_columns_are_small_beside_the_motion(scene):  # noqa: F811
    motion = np.linalg.norm(scene.y - scene.cloud.x)
    for known in discretisation(scene):
        assert 0 < np.linalg.norm(known.motion) < 0.5 * motion


def test_a_choice_of_neighbours_that_leaves_a_point_flat_is_left_out(scene, monkeypatch):  # noqa: F811
    """Six neighbours may lie in a plane where a body is thin."""
    every, build = discretisation(scene), RestCloud.build

    def thin(x, *, options, **more):
        require(options.neighbours != 6, "x", "surround every point in three directions", "flat neighbourhoods")
        return build(x, options=options, **more)

    monkeypatch.setattr(RestCloud, "build", thin)
    assert np.array_equal([k.motion for k in discretisation(scene)], [every[0].motion, every[2].motion])
