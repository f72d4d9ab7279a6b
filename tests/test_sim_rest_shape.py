"""The stress-free shape under gravity: back to where our own simulator and finite elements let a beam sag from."""

from dataclasses import replace

import fem_scenes
import numpy as np
import pytest
from clouds import block

from sim.cloud import RestCloud
from sim.elastic import Elastic
from sim.energy import Energy
from sim.fixed_point import MixingOptions
from sim.lame import Lame
from sim.newton import equilibrate
from sim.rest_shape import _upright, stress_free_rest
from sim.terms.loads import AppliedForce

LAME = Lame.from_young(1.0, 0.3)
DENSITY = 1.0


@pytest.fixture(scope="module")
def cloud():
    """A beam of length 1 along x."""
    return RestCloud.build(block((13, 4, 4), (1, 0.2, 0.2), (0, -0.1, -0.1)))


def down(gravity):
    return np.array([0.0, 0.0, -gravity])


def sagged(cloud, gravity):
    """Where the beam, clamped at x = 0, hangs."""
    weight = AppliedForce(force=DENSITY * cloud.volume[None, :, None] * down(gravity))
    energy = Energy.of(Elastic.neo_hookean(cloud, LAME), [weight], clamp(cloud))
    return equilibrate(energy, cloud.x[None]).require_converged().y[0]


def clamp(cloud):
    return cloud.x[:, 0] < 1e-9


@pytest.mark.parametrize("gravity", [2e-3, 6e-3])  # the tip falls by 8 and 22 % of the length
def test_rest_shape_of_a_sagged_beam_is_the_beam(cloud, gravity):
    y = sagged(cloud, gravity)
    found = stress_free_rest(cloud.moved(y), LAME, DENSITY * cloud.volume, down(gravity), clamp(cloud))
    assert found.settled, found.sentence
    assert np.abs(found.cloud.x - cloud.x).max() < 3e-3 * np.abs(y - cloud.x).max()


def test_rest_shape_sags_into_the_observed_pose(cloud):
    observed = RestCloud.build(sagged(cloud, 6e-3))
    found = stress_free_rest(observed, LAME, DENSITY * cloud.volume, down(6e-3), clamp(cloud))
    weight = AppliedForce(force=DENSITY * cloud.volume[None, :, None] * down(6e-3))
    again = equilibrate(Energy.of(Elastic.neo_hookean(found.cloud, LAME), [weight], clamp(cloud)), found.cloud.x[None])
    np.testing.assert_allclose(again.y[0], observed.x, atol=1e-5 * observed.spacing)
    np.testing.assert_array_equal(found.cloud.x[clamp(cloud)], observed.x[clamp(cloud)])


def test_rest_shape_of_a_finite_element_beam_is_straight():
    # With five points across, a cloud of 425 falls short of the sag by some 5 % forwards; backwards it does no worse.
    straight, gravity = RestCloud.build(block((17, 5, 5), (1, 0.2, 0.2), (0, -0.1, -0.1))), 6e-3
    sag = fem_scenes.cantilever(gravity).displacement(straight.x)
    observed = RestCloud.build(straight.x + sag)
    found = stress_free_rest(observed, LAME, DENSITY * straight.volume, down(gravity), clamp(straight))
    assert found.settled, found.sentence
    assert np.abs(found.cloud.x - straight.x).max() < 0.1 * np.abs(sag).max()


def test_without_gravity_the_pose_is_its_own_rest_shape(cloud):
    found = stress_free_rest(cloud, LAME, cloud.volume, np.zeros(3), clamp(cloud))
    assert found.settled and found.iterations == 1
    np.testing.assert_array_equal(found.cloud.x, cloud.x)


def test_moved_cloud_is_the_cloud_built_there(cloud):
    # Growth changes no neighbour and no tetrahedron; building shakes points by 1e-6 of the spacing to measure volumes.
    moved, built = cloud.moved(1.1 * cloud.x), RestCloud.build(1.1 * cloud.x)
    np.testing.assert_array_equal(moved.neighbours, built.neighbours)
    for name in ("x", "arms", "weights", "gradients", "volume", "area", "reach"):
        one, other = getattr(moved, name), getattr(built, name)
        np.testing.assert_allclose(one, other, atol=1e-5 * np.abs(other).max(), err_msg=name)


def test_moved_cloud_still_passes_the_patch_test(cloud):
    y = cloud.x + 0.01 * np.sin(7 * cloud.x[:, [1, 2, 0]])
    moved = cloud.moved(y)
    stress = np.broadcast_to(np.random.default_rng(0).normal(size=(3, 3)), (1, cloud.count, 3, 3))
    expected = np.einsum("ab,nb->na", stress[0, 0], moved.area)
    np.testing.assert_allclose(moved.divergence(stress)[0], expected, atol=1e-7 * np.abs(expected).max())
    assert not _upright(cloud, cloud.x * [-1, 1, 1])


def test_too_soft_a_material_is_told(cloud):
    soft = Lame.from_young(0.02, 0.3)
    few = MixingOptions(tolerance=1e-9, iterations=4)
    found = stress_free_rest(cloud, soft, cloud.volume, down(1e-2), clamp(cloud), mixing=few)
    assert not found.settled
    assert "no rest shape was found in" in found.sentence and "too soft" in found.sentence


def test_mass_that_is_not_positive_is_named(cloud):
    with pytest.raises(ValueError, match="mass must be positive at every point; got 0"):
        stress_free_rest(cloud, LAME, np.zeros(cloud.count), down(1.0), clamp(cloud))


def test_paper_mode_has_a_rest_shape_too(cloud):
    paper = RestCloud.build(cloud.x, options=replace(cloud.options, mode="paper", stabilisation=0.1))
    found = stress_free_rest(paper, LAME, paper.volume, down(1e-3), clamp(paper))
    assert found.settled, found.sentence
    assert found.cloud.x[:, 2].max() > paper.x[:, 2].max()
