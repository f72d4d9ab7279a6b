"""The virtual elastic object: loads add up, files round-trip, wrong use is one sentence."""

import numpy as np
import pytest

from sim.lame import Lame
from sim.terms.contact import Contact, contact_alpha
from sim.terms.shapes import Sphere
from veo_ti.body import sample_box
from veo_ti.object import VirtualElasticObject


@pytest.fixture(scope="module")
def beam() -> VirtualElasticObject:
    body = sample_box([0.2, 0.05, 0.05], 300)
    return VirtualElasticObject(
        x=body.x, lame=Lame.from_young(np.full(300, 2e4), 0.3), volume=body.volume, surface=body.surface,
        fixed=body.x[:, 0] == 0, mass=0.5, gravity=np.array([0.0, 0.0, -9.81]), name="beam",
    )  # fmt: skip


def test_push_spreads_exactly_the_total_force(beam):
    term = beam.push_at([0.2, 0.025, 0.05], [0.0, 0.1, -0.3], radius=0.02)
    np.testing.assert_allclose(term.force.sum(axis=1), [[0.0, 0.1, -0.3]], rtol=1e-12)
    assert not term.force[:, ~beam.surface].any()


def test_gravity_of_the_rest_pose_is_no_load(beam):
    assert not beam.under_gravity(beam.gravity).force.any()


def test_turned_gravity_loads_with_the_weight(beam):
    total = beam.under_gravity([9.81, 0, 0]).force.sum(axis=(0, 1))
    np.testing.assert_allclose(total, 0.5 * 9.81 * np.array([1, 0, 1]), rtol=1e-12)


def test_supports_carry_what_is_applied(beam):
    push = beam.push_at([0.2, 0.025, 0.05], [0.0, 0.0, -0.05], radius=0.02)
    pose = beam.simulate(push)
    assert pose.converged
    reaction = beam.elastic.gradient(pose.y)[0, beam.fixed].sum(axis=0)
    np.testing.assert_allclose(reaction, [0.0, 0.0, 0.05 - 0.05 * _share(push, beam)], atol=1e-8)


def _share(push, beam) -> float:
    """The part of the push that falls on fixed points."""
    return push.force[0, beam.fixed, 2].sum() / push.force[0, :, 2].sum()


def test_file_round_trip_keeps_everything(beam, tmp_path):
    loaded = VirtualElasticObject.load(beam.save(tmp_path / "beam.vtkhdf"))
    for name in ("x", "volume", "fixed", "surface", "gravity"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(beam, name))
    np.testing.assert_array_equal(loaded.lame.lam, beam.lame.lam)
    assert (loaded.mass, loaded.name, loaded.options) == (beam.mass, beam.name, beam.options)


def test_place_far_from_the_surface_is_named(beam):
    with pytest.raises(ValueError, match="place must lie near the surface; got a place 1"):
        beam.push_at([0.2, 0.025, 1.05], [0, 0, 1], radius=0.02)


def test_gravity_without_mass_is_refused(beam):
    massless = VirtualElasticObject(
        x=beam.x, lame=beam.lame, volume=beam.volume, surface=beam.surface, fixed=beam.fixed
    )
    with pytest.raises(ValueError, match="mass must be known"):
        massless.under_gravity([0, 0, 9.81])


def test_object_that_nothing_holds_is_refused(beam):
    loose = VirtualElasticObject(
        x=beam.x, lame=beam.lame, volume=beam.volume, surface=beam.surface, fixed=np.zeros(300, bool)
    )
    with pytest.raises(ValueError, match="could otherwise move rigidly"):
        loose.simulate(loose.push(np.ones((300, 3))))


def test_gradual_loads_lead_to_the_same_pose_where_there_is_only_one(beam):
    push = beam.push_at([0.2, 0.025, 0.05], np.linspace(0, 1, 4)[:, None] * [0.0, 0.02, -0.05], radius=0.02)
    at_once, gradual = beam.simulate(push), beam.simulate(push, gradual=True)
    assert gradual.converged
    np.testing.assert_allclose(gradual.y, at_once.y, atol=1e-9)


def test_a_ball_that_goes_slowly_pushes_the_beam_before_it(beam):
    """It ends below where the beam was; put there at once, it drives the beam out at its nearer side, above."""
    radius, frames = 0.04, 12
    tip = np.array([0.2, 0.025, 0.05])
    way = tip + np.linspace(radius, -1.4 * radius, frames)[:, None] * [0, 0, 1]
    alpha = contact_alpha(float(np.median(beam.lame.mu)), beam.cloud.spacing)
    ball = Contact(shape=Sphere(radius=radius), volume=beam.cloud.volume, alpha=alpha, position=way)
    at_once, gradual = beam.simulate(ball, frames=frames), beam.simulate(ball, frames=frames, gradual=True)
    assert gradual.converged
    end = np.linalg.norm(beam.x - tip, axis=1).argmin()
    assert gradual.y[-1, end, 2] < way[-1, 2] < at_once.y[-1, end, 2]
