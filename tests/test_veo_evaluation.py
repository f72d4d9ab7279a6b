"""A prediction under an air stream: on the surface where it is simulated, never where it was observed."""

from dataclasses import replace

import numpy as np
import pytest
from clouds import rotation

from sim.follower import deformed_area
from sim.lame import Lame
from sim.terms.jet import Jet, jet_forces
from veo_ti.body import sample_box
from veo_ti.evaluation import evaluate
from veo_ti.object import VirtualElasticObject
from veo_ti.observation import Observation
from veo_ti.scene import cloud_of, forces_of


@pytest.fixture(scope="module")
def bar():
    body = sample_box([0.2, 0.05, 0.05], 200)
    return VirtualElasticObject(
        x=body.x, lame=Lame.from_young(np.full(len(body.x), 2e4), 0.4), volume=body.volume, surface=body.surface,
        fixed=body.x[:, 0] == 0, mass=0.05,
    )  # fmt: skip


@pytest.fixture(scope="module")
def blown(bar):
    """The bar blown on from above in frame 1, where it was seen turned about its clamped end."""
    jet = Jet(
        position=np.tile([0.15, 0.025, 0.3], (2, 1)), direction=np.tile([0.0, 0.0, -1.0], (2, 1)),
        force=np.array([0.0, 0.05]), footprint=0.02,
    )  # fmt: skip
    points = np.stack([bar.x, bar.x @ rotation(0.3).T])
    return Observation(
        points=points, time=np.arange(2.0), fixed=bar.fixed, surface=bar.surface, volume=bar.volume, jet=jet
    )


def test_what_was_observed_does_not_move_a_prediction(bar, blown):
    still = replace(blown, points=np.repeat(bar.x[None], 2, axis=0))
    one, other = evaluate(bar, blown), evaluate(bar, still)
    moved = np.linalg.norm(one.y[1] - bar.x, axis=1).max()
    assert one.converged.all() and other.converged.all() and moved > 5e-3
    assert np.abs(one.y - other.y).max() < 1e-2 * moved


def test_prediction_holds_the_air_that_meets_it(bar, blown):
    """The elastic forces of the predicted pose against the jet's on that pose."""
    found, cloud = evaluate(bar, blown).y, bar.cloud
    inner = -bar.elastic.gradient(found)[1]
    air = jet_forces(blown.jet, found, deformed_area(cloud, found), spacing=cloud.spacing)[1]
    free = ~bar.fixed
    assert np.abs(inner + air)[free].max() < 1e-2 * np.abs(air).max()


def test_a_stream_that_turns_with_the_observed_pose_gives_forces_that_turn_too(bar, blown):
    cloud, turn = cloud_of(blown), rotation(0.3)
    still = replace(blown, points=np.repeat(bar.x[None], 2, axis=0))
    jet = replace(blown.jet, position=blown.jet.position @ turn.T, direction=blown.jet.direction @ turn.T)
    turned = replace(still, points=still.points @ turn.T, jet=jet)
    expected = forces_of(still, cloud) @ turn.T
    np.testing.assert_allclose(forces_of(turned, cloud), expected, atol=1e-9 * np.abs(expected).max())


def test_a_pose_with_lost_points_counts_as_the_reference(bar, blown):
    observed = np.ones((2, len(bar.x)), bool)
    observed[1, 5] = False
    cloud = cloud_of(blown)
    expected = jet_forces(blown.jet, cloud.x, cloud.area, spacing=cloud.spacing)
    np.testing.assert_allclose(forces_of(replace(blown, observed=observed), cloud), expected)
