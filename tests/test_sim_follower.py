"""Follower loads: area vectors of known deformations, and a pressure whose equilibrium has a closed form."""

from dataclasses import replace

import numpy as np
import pytest
from clouds import block, rotation
from scipy.optimize import brentq

from sim.cloud import RestCloud
from sim.elastic import Elastic
from sim.energy import Energy
from sim.follower import Following, deformed_area, equilibrate_follower
from sim.lame import Lame
from sim.newton import NewtonOptions
from sim.terms.handles import Handles
from sim.terms.jet import Jet, jet_forces

LAME = Lame.from_young(1e4, 0.3)


@pytest.fixture(scope="module")
def cloud():
    return RestCloud.build(block((6, 5, 5), (0.1, 0.08, 0.08)))


def test_area_vectors_turn_with_the_body(cloud):
    turn = rotation(0.9)
    np.testing.assert_allclose(deformed_area(cloud, (cloud.x @ turn.T)[None])[0], cloud.area @ turn.T, atol=1e-15)


def test_area_vectors_of_a_stretched_box_are_those_of_its_faces(cloud):
    # (x, y, z) -> (2x, 3y, z/2): the face across x grows by 3 / 2, across y by 1, across z by 6.
    area = deformed_area(cloud, (cloud.x * [2, 3, 0.5])[None])[0]
    np.testing.assert_allclose(area, cloud.area * [1.5, 1.0, 6.0], atol=1e-15)


def test_forces_that_turn_push_as_their_difference(cloud):
    """Beside their own motion, by central differences; nothing where there is none."""
    rng = np.random.default_rng(0)
    y, change = (cloud.x + s * rng.normal(size=(1, cloud.count, 3)) * cloud.spacing for s in (0.05, 0.1))
    change = np.concatenate([change - cloud.x, 2 * cloud.x[None]])
    nominal = np.zeros_like(y)
    nominal[:, cloud.area.any(axis=1)] = [0.3, -0.2, 0.5]

    def following(y):
        return Following(cloud=cloud, F=cloud.deformation_gradient(y), nominal=nominal)

    here, h = following(y), 1e-5
    for pushed, way in zip(here.own(0, change), change, strict=True):
        expected = (following(y + h * way).there - following(y - h * way).there)[0] / (2 * h)
        np.testing.assert_allclose(pushed, expected, atol=1e-6 * np.abs(expected).max())
    outward = following((cloud.x @ rotation(0.9).T)[None]).there
    np.testing.assert_allclose(outward[0], nominal[0] @ rotation(0.9).T, atol=1e-12)
    assert here.acts(0) and not replace(here, nominal=0 * nominal).acts(0)


def swollen_by(suction):
    """Stretch s of a free body under a suction that follows its surface: mu (s - 1/s) + lam (s^3 - 1) s^2 = p s^2."""
    mu, lam = LAME.mu.item(), LAME.lam.item()
    return brentq(lambda s: mu * (s - 1 / s) + lam * (s**3 - 1) * s**2 - suction * s**2, 0.9, 2.0)


def loosely_held(cloud):
    """An energy that lets the body change size freely and only keeps it from flying away."""
    middle = cloud.x.mean(axis=0)
    near = np.argsort(((cloud.x - middle) ** 2).sum(axis=1))[:4]
    targets = np.repeat(middle[None, None], 4, axis=1)
    handles = Handles(points=near, targets=targets, alpha=np.full(4, 1e-6 * LAME.mu.item() * cloud.spacing))
    corner = np.zeros(cloud.count, bool)
    corner[near[0]] = True
    return Energy.of(Elastic.neo_hookean(cloud, LAME), [handles], corner)


def test_following_suction_swells_a_body_as_the_closed_form(cloud):
    suction = np.array([1000.0, 4000.0])  # a dead pressure would turn the free body over
    found = equilibrate_follower(
        loosely_held(cloud), lambda y, area: suction[:, None, None] * area, np.repeat(cloud.x[None], 2, axis=0)
    )
    assert found.converged, found.sentence
    for y, p in zip(found.y, suction, strict=True):
        size = np.linalg.norm(y - y[0], axis=1)[1:] / np.linalg.norm(cloud.x - cloud.x[0], axis=1)[1:]
        np.testing.assert_allclose(size, swollen_by(p), rtol=1e-5)
        assert swollen_by(p) > 1.02


def bent_by_a_jet(cloud, force, **options):
    fixed = cloud.x[:, 0] < 1e-9
    position, direction = np.array([[0.09, 0.04, 0.2]]), np.array([[0.0, 0.0, -1.0]])
    jet = Jet(position=position, direction=direction, force=np.array([force]), footprint=0.03)
    energy = Energy.of(Elastic.neo_hookean(cloud, LAME), [], fixed)
    return jet, equilibrate_follower(energy, lambda y, area: jet_forces(jet, y, area), cloud.x[None], **options)


def test_jet_holds_the_pose_that_it_makes(cloud):
    jet, found = bent_by_a_jet(cloud, 4.0)
    assert found.converged, found.sentence
    expected = jet_forces(jet, found.y, deformed_area(cloud, found.y))
    np.testing.assert_allclose(found.force, expected, atol=1e-5 * np.abs(expected).max())
    dead = jet_forces(jet, cloud.x, cloud.area)
    assert np.abs(found.force - dead).max() > 0.05 * np.abs(dead).max()


def test_load_that_does_not_settle_says_so(cloud):
    _, found = bent_by_a_jet(cloud, 4.0, iterations=2)
    assert not found.converged
    assert "1 of 1 frames the forces did not settle with the surface in 2 solves" in found.sentence


def test_frame_without_a_load_stays_at_rest(cloud):
    _, found = bent_by_a_jet(cloud, 0.0)
    assert found.converged and found.iterations == 1
    np.testing.assert_allclose(found.y[0], cloud.x, atol=1e-12)


def test_first_solve_that_fails_is_told(cloud):
    _, found = bent_by_a_jet(cloud, 4.0, options=NewtonOptions(iterations=1))
    assert not found.converged and found.iterations == 1
    assert "the first forces have no equilibrium: 1 of 1 frames did not converge" in found.sentence
