"""Contact between two soft bodies: conserved momenta, a mirror image as oracle, joined clouds that stay apart."""

import numpy as np
import pytest
from clouds import ball, block, rotation
from scipy.spatial import Delaunay

from sim.cloud import CloudOptions, RestCloud
from sim.elastic import Elastic
from sim.energy import Energy
from sim.join import join_clouds, part_slices
from sim.lame import Lame
from sim.newton import NewtonOptions, equilibrate
from sim.terms.contact import Contact, contact_alpha
from sim.terms.handles import Handles
from sim.terms.pair import SurfaceContact
from sim.terms.shapes import Plane

LAME = Lame.from_young(5e4, 0.4)
MU = LAME.mu.item()


def two(first, second, factor=100.0):
    """A joined cloud, its parts and the contact between them."""
    clouds = RestCloud.build(first), RestCloud.build(second)
    cloud, parts = join_clouds(*clouds), part_slices(*clouds)
    return cloud, parts, SurfaceContact.between(cloud, *parts, contact_alpha(MU, cloud.spacing, factor))


@pytest.fixture(scope="module")
def overlapping():
    """Two blocks of which one stands askew in the other, over three frames."""
    cloud, (a, b), contacts = two(block((5, 5, 4), (1, 1, 1)), block((4, 4, 4), (0.7, 0.7, 0.7), seed=1))
    y = np.repeat(cloud.x[None], 3, axis=0)
    for t in range(3):
        y[t, b] = (cloud.x[b] - 0.35) @ rotation(0.3 + t).T + [0.5, 0.5, 1.2 - 0.1 * t]
    return cloud, (a, b), contacts, y


def test_joined_parts_are_each_as_they_were_alone(overlapping):
    cloud, parts, _, _ = overlapping
    y = cloud.x + np.random.default_rng(0).normal(0, 0.01, (2, *cloud.x.shape))
    stress = np.random.default_rng(1).normal(size=(2, cloud.count, 3, 3))
    for part, alone in zip(parts, (RestCloud.build(cloud.x[p]) for p in parts), strict=True):
        np.testing.assert_array_equal(cloud.deformation_gradient(y)[:, part], alone.deformation_gradient(y[:, part]))
        together = cloud.divergence(stress)[:, part]
        np.testing.assert_allclose(together, alone.divergence(stress[:, part]), atol=1e-15)
        assert (cloud.neighbours[part] >= part.start).all() and (cloud.neighbours[part] < part.stop).all()
        assert len(np.unique(cloud.island[part])) == 1
    assert len(np.unique(cloud.island)) == 2


def test_clouds_of_different_options_are_not_joined():
    x = block((4, 4, 4), (1, 1, 1))
    with pytest.raises(ValueError, match="clouds must share their options"):
        join_clouds(RestCloud.build(x), RestCloud.build(x, options=CloudOptions(mode="paper")))


def test_points_are_pushed_exactly_where_they_are_inside_the_other_body(overlapping):
    _, (a, b), (first, second), y = overlapping
    for term, own, other in ((first, a, b), (second, b, a)):
        for t in range(len(y)):
            inside = Delaunay(y[t, other]).find_simplex(y[t, term.probes]) >= 0  # both bodies are convex
            pushed = term.gradient(y)[t, term.probes].any(axis=1)
            np.testing.assert_array_equal(pushed, inside)
            assert inside.any() and (term.probes >= own.start).all() and (term.probes < own.stop).all()


def test_forces_are_equal_and_opposite_with_no_turning_moment(overlapping):
    _, (a, b), contacts, y = overlapping
    for term in contacts:
        force = -term.gradient(y)
        size = np.abs(force).sum()
        np.testing.assert_allclose(force[:, a].sum(axis=1), -force[:, b].sum(axis=1), atol=1e-15 * size)
        np.testing.assert_allclose(np.cross(y, force).sum(axis=1), 0, atol=1e-15 * size)
        assert np.abs(force[:, a].sum(axis=1)).max() > 0.01 * size


def test_moving_everything_together_changes_nothing(overlapping):
    _, _, contacts, y = overlapping
    turn = rotation(2.0)
    for term in contacts:
        np.testing.assert_allclose(term.value(y @ turn.T + [1, 2, 3]), term.value(y), rtol=1e-10)


def test_bodies_apart_do_not_touch(overlapping):
    _, (_, b), contacts, y = overlapping
    apart = y.copy()
    apart[:, b] += [0, 0, 2]
    for term in contacts:
        assert not term.value(apart).any() and not term.gradient(apart).any() and not term.depth(apart).any()
        assert not term.tangent(apart).product(y).any()


def led_down(energy_of, cloud, part, drops, linear="auto"):
    """Equilibria of the energy with one more term: the top of a part led down by `drops` [m]."""
    top = cloud.x[part][:, 2].max()
    led = part.start + np.flatnonzero(cloud.x[part][:, 2] > top - 0.6 * cloud.spacing)
    targets = cloud.x[led] - np.array(drops)[:, None, None] * [0, 0, 1]
    lead = Handles.relative(led, targets, mu=MU, spacing=cloud.spacing)
    start = np.repeat(cloud.x[None], len(drops), axis=0)
    found = equilibrate(energy_of(lead), start, options=NewtonOptions(tolerance=1e-9, linear=linear))
    return found, -lead.gradient(found.y).sum(axis=1)


def base(cloud, part):
    """The lowest layer of a part, (N,) bool."""
    fixed = np.zeros(cloud.count, bool)
    fixed[part] = cloud.x[part][:, 2] < cloud.x[part][:, 2].min() + 0.6 * cloud.spacing
    return fixed


@pytest.mark.parametrize("linear", ["direct", "two-level"])
@pytest.mark.parametrize("kind", ["blocks", "balls"])
def test_newton_converges_in_contact_and_forces_balance(kind, linear):
    if kind == "blocks":
        bodies = block((6, 6, 4), (0.08, 0.08, 0.05)), block((5, 5, 4), (0.05, 0.05, 0.05), (0.02, 0.01, 0.051), seed=1)
    else:
        bodies = ball(0.04, 6, (0, 0, 0.04)), ball(0.03, 6, (0.004, 0.002, 0.111), seed=2)
    cloud, (a, b), contacts = two(*bodies)
    elastic, fixed = Elastic.neo_hookean(cloud, LAME), base(cloud, a)
    found, push = led_down(lambda lead: Energy.of(elastic, [lead, *contacts], fixed), cloud, b, (0.003, 0.006), linear)
    assert found.converged, found.sentence
    # About 10 steps where the tangent couples the bodies, hundreds where it holds its pointwise part only.
    assert found.iterations.max() <= 25
    held = elastic.gradient(found.y)[:, fixed].sum(axis=1)
    np.testing.assert_allclose(push, -held, atol=1e-6 * np.abs(push).max())
    assert push[1, 2] < -1.0
    assert max(term.depth(found.y).max() for term in contacts) < 0.02 * cloud.spacing


def test_hard_block_is_a_wall():
    upper = block((5, 5, 4), (0.05, 0.05, 0.04), (0.02, 0.01, 0.0), seed=1)
    cloud, (a, b), contacts = two(block((6, 6, 4), (0.08, 0.08, 0.04), (0, 0, -0.04)), upper, factor=1000.0)
    mu = np.where(np.arange(cloud.count) < a.stop, 1e3, 1.0) * MU
    elastic, drops = Elastic.neo_hookean(cloud, Lame(mu=mu, lam=4 * mu)), (0.002, 0.004)
    both, push = led_down(lambda lead: Energy.of(elastic, [lead, *contacts], base(cloud, a)), cloud, b, drops)
    alone = RestCloud.build(upper)
    wall = Contact(
        shape=Plane(normal=np.array([0.0, 0.0, 1.0])), volume=alone.volume, position=np.zeros(3),
        alpha=contacts[0].alpha,
    )  # fmt: skip
    soft = Elastic.neo_hookean(alone, Lame(mu=np.array([MU]), lam=np.array([4 * MU])))
    one, expected = led_down(lambda lead: Energy.of(soft, [wall, lead]), alone, slice(0, len(upper)), drops)
    assert both.converged and one.converged
    np.testing.assert_allclose(push[:, 2], expected[:, 2], rtol=0.01)
    np.testing.assert_allclose(both.y[:, b], one.y, atol=0.01 * 0.004)


def test_stiffness_that_is_not_positive_is_named(overlapping):
    cloud, parts, _, _ = overlapping
    with pytest.raises(ValueError, match="alpha must be positive; got 0"):
        SurfaceContact.between(cloud, *parts, 0)
