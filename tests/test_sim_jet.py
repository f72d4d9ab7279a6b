"""The air jet: its formula by hand, its total on a wall, the same load from the finite-element scenes."""

import fem
import fem_scenes
import numpy as np
import pytest
from clouds import block, rotation, sphere
from scipy.spatial import cKDTree

from sim.cloud import RestCloud
from sim.terms.jet import DistanceLaw, Jet, jet_forces, pressures, reblown, told_area

DOWN = np.array([[0.0, 0.0, -1.0]])


def jet_down(*, force=2.0, footprint=0.1, height=1.0):
    return Jet(position=np.array([[0.0, 0.0, height]]), direction=DOWN, force=np.array([force]), footprint=footprint)


def wall(tilt=0.0, half=0.8, count=81):
    """A square wall of points with their area vectors, turned about the y axis."""
    side = np.linspace(-half, half, count)
    x = np.stack([*np.meshgrid(side, side, indexing="ij"), np.zeros((count, count))], axis=-1).reshape(-1, 3)
    turn = rotation(tilt, (0, 1, 0))
    return x @ turn.T, np.full((len(x), 1), (side[1] - side[0]) ** 2) * turn[:, 2]


def test_force_on_one_point_by_hand():
    # p0 = 2 / (2 pi 0.01) = 31.83 Pa; r = 0.1 = sigma; area 3e-4 m2 of which cos 60 = 1/2 faces the jet
    area = 3e-4 * np.array([[np.sin(np.pi / 3), 0, np.cos(np.pi / 3)]])
    force = jet_forces(jet_down(), np.array([[0.06, 0.08, 0.2]]), area)
    np.testing.assert_allclose(force, [[[0, 0, -31.830989 * np.exp(-0.5) * 1.5e-4]]], rtol=1e-7)


@pytest.mark.parametrize("tilt", [0.0, 0.6])
def test_wall_across_the_jet_takes_its_whole_force(tilt):
    # The projected area of a tilted wall is what counts, so the total does not change.
    x, area = wall(tilt)
    np.testing.assert_allclose(jet_forces(jet_down(), x, area).sum(axis=1), 2.0 * DOWN, rtol=1e-9, atol=1e-15)


def test_surface_that_looks_away_feels_nothing():
    x, area = wall()
    assert not jet_forces(jet_down(), x, -area).any()


def test_turning_jet_and_surface_together_turns_the_forces():
    x, area = wall(0.4)
    turn, jet = rotation(1.1), jet_down()
    turned = Jet(position=jet.position @ turn.T, direction=jet.direction @ turn.T, force=jet.force, footprint=0.1)
    expected = jet_forces(jet, x, area) @ turn.T
    np.testing.assert_allclose(jet_forces(turned, x @ turn.T, area @ turn.T), expected, atol=1e-15)


def test_frames_take_their_own_nozzle_and_pose():
    x, area = wall()
    position, direction = np.array([[0, 0, 1.0], [0.3, 0, 1]]), np.repeat(DOWN, 2, axis=0)
    jet = Jet(position=position, direction=direction, force=np.array([1.0, 2.0]), footprint=0.1)
    forces = jet_forces(jet, np.stack([x, x + np.array([0.3, 0, 0])]), area)
    np.testing.assert_allclose(forces[1], 2 * forces[0], atol=1e-15)


def test_force_agrees_with_the_finite_element_load_on_a_box():
    mesh, one = fem.box_mesh((0, -0.05, -0.05), (0.2, 0.05, 0.05), (16, 8, 8)), fem_scenes.constant(1.0)
    body = fem.FemBody.build(mesh, one, one, lambda x: x[:, 0] < 0)
    aim = np.array([[0.6, 0.0, -0.8]])
    position = np.array([[0.1, 0, 0.05]]) - 0.2 * aim
    blown = fem_scenes.Jet(position=position, direction=aim, pressure=np.array([500.0]), footprint=0.02)
    cloud = RestCloud.build(block((17, 9, 9), (0.2, 0.1, 0.1), (0, -0.05, -0.05)))
    jet = Jet(position=blown.position, direction=aim, force=blown.force, footprint=0.02)
    total = jet_forces(jet, cloud.x, cloud.area).sum(axis=1)[0]
    expected = fem.surface_load(body.basis, blown.traction(0)).sum(axis=0)
    np.testing.assert_allclose(total, expected, rtol=0.01, atol=1e-3 * np.abs(expected).max())


def test_forces_of_three_jets_tell_the_area_and_change_nothing_where_none_blew():
    x, area = wall(0.3)
    aim = np.array([[0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [-0.48, 0.6, -0.64]])
    jet = Jet(position=-aim, direction=aim, force=np.array([2.0, 1.0, 1.0]), footprint=0.1)
    guess = area * np.random.default_rng(0).uniform(0.5, 1.5, area.shape)
    told = told_area(jet, x, guess, jet_forces(jet, x, area))
    near, far = (x**2).sum(axis=1) < 0.1**2, (x**2).sum(axis=1) > 0.7**2
    np.testing.assert_allclose(told[near], area[near], atol=0.05 * np.abs(area).max())
    np.testing.assert_array_equal(told[far], guess[far])
    off = jet_forces(jet, x, told) - jet_forces(jet, x, area)
    assert np.abs(off).max() < 0.05 * np.abs(jet_forces(jet, x, area)).max()


def three_jets(turn=0.0, shift=0.0):
    """Nearly in the plane across y; turned about x, where they come out of it, and shifted along y."""
    aim = np.array([[0.6, 0, -0.8], [-0.6, 0.03, -0.8], [0.1, -0.03, -1.0]])
    aim /= np.linalg.norm(aim, axis=1)[:, None]
    hit = np.array([[0.03, 0, 0.095], [-0.04, 0.01, 0.09], [0, 0, 0.1]])
    return Jet(position=hit - 0.3 * aim + [0, shift, 0], direction=aim @ rotation(turn, (1, 0, 0)).T,
               force=np.full(3, 0.1), footprint=0.03)  # fmt: skip


def test_forces_that_are_rough_do_not_turn_areas_across_jets_that_are_nearly_in_one_plane():
    (x, area), jet = sphere(400, 0.1), three_jets()
    rough = jet_forces(jet, x, area) * (1 + 0.15 * np.random.default_rng(1).normal(size=(3, 400, 1)))
    off = (told_area(jet, x, area, rough) - area) / np.linalg.norm(area, axis=1)[:, None]
    blown = pressures(jet, x).max(axis=0)
    assert np.sqrt((off[blown > 0.3 * blown.max(), 1] ** 2).mean()) < 0.03  # 0.20, told by least squares alone


@pytest.mark.parametrize("other", [dict(turn=0.1), dict(turn=-0.2), dict(shift=0.015)])
def test_another_jet_blows_as_on_a_hundred_times_as_many_points(other):
    (x, area), (fine, small), jet, turned = sphere(400, 0.1), sphere(40000, 0.1), three_jets(), three_jets(**other)
    own = (cKDTree(x).query(fine)[1] == np.arange(400)[:, None]).astype(float)
    known, wanted = (own @ jet_forces(blowing, fine, small) for blowing in (jet, turned))
    guess = area * np.random.default_rng(0).uniform(0.8, 1.2, (400, 1))
    told = reblown(jet, turned, x, told_area(jet, x, guess, known), known)
    assert np.linalg.norm(told - wanted) < 0.1 * np.linalg.norm(wanted - known)


def test_what_another_jet_does_not_reach_is_left_to_what_else_pulls():
    (x, area), jet = sphere(400, 0.1), three_jets()
    forces = 1.3 * jet_forces(jet, x, area)
    below = x[:, 2] < -0.08
    forces[:, below] += [0.0, 0.0, -0.01]
    np.testing.assert_allclose(reblown(jet, jet, x, area, forces), forces, atol=1e-15)
    gone = reblown(jet, three_jets(shift=2.0), x, area, forces)
    np.testing.assert_allclose(gone[:, below], np.full((3, below.sum(), 3), [0.0, 0.0, -0.01]), atol=1e-9)
    assert np.abs(gone[:, ~below]).max() < 1e-3 * np.abs(forces).max()


def test_distance_law_is_one_in_the_core_and_falls_by_its_power_beyond():
    law, x, area = DistanceLaw(core=0.5, exponent=2.0), *wall()
    near, far, behind = (jet_forces(jet_down(height=h), x, area, law=law).sum(axis=(0, 1))[2] for h in (0.4, 1.0, -0.1))
    np.testing.assert_allclose([near, far, behind], [-2.0, -0.5, 0.0], rtol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(footprint=0.0), "footprint must be positive; got 0.0"),
        (dict(direction=np.zeros((2, 3))), r"direction must have shape \(1, 3\); got \(2, 3\)"),
        (dict(force=np.array([np.nan])), "force must be finite"),
    ],
)
def test_unsound_jet_is_named(change, message):
    given = dict(position=np.zeros((1, 3)), direction=DOWN, force=np.ones(1), footprint=0.1) | change
    with pytest.raises(ValueError, match=message):
        jet_forces(Jet(**given), *wall())


def test_points_of_another_number_of_frames_are_named():
    x, area = wall()
    with pytest.raises(ValueError, match="y must have shape"):
        jet_forces(jet_down(), np.stack([x, x, x]), area)


def test_law_with_a_negative_power_is_named():
    with pytest.raises(ValueError, match="exponent must not be negative"):
        DistanceLaw(core=0.1, exponent=-1.0)
