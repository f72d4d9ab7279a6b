"""What is off by the nozzle's own axes, and what is off in the room: the same in one sweep, two things in several."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_diagnosis import scene  # noqa: F401
from test_diagnosis_other_loads import made

from sim.terms.jet import jet_forces
from veo_ti.diagnosis.causes.clocks import ForceTiming
from veo_ti.diagnosis.causes.other_loads import ForceDirection, ForceFootprint, ForceOffset


@pytest.fixture
def sides(scene):  # noqa: F811
    """Under a jet that blows ahead, to the left, and down."""
    ways = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0]])[np.arange(len(scene.time)) % 3]
    jet = replace(scene.observation.jet, direction=ways, position=scene.cloud.x.mean(axis=0) - 0.3 * ways)
    return scene.under(jet_forces(jet, scene.cloud.x, scene.cloud.area), jet)


def test_a_shift_to_the_right_of_the_nozzle_is_another_one_in_every_sweep(sides):
    right = np.array([[0, -1.0, 0], [1.0, 0, 0]])[np.arange(len(sides.time)) % 3 % 2]
    level = np.arange(len(sides.time)) % 3 < 2  # one that blows down has no side
    shifted = replace(sides.jet, position=sides.jet.position + 0.03 * right)
    expected = jet_forces(shifted, sides.cloud.x, sides.cloud.area)
    found = made(sides, ForceOffset(), [0.03, 0, 0], "own")
    assert found[level] == pytest.approx(expected[level], abs=1e-6 * np.abs(expected).max())
    assert np.abs(made(sides, ForceOffset(), [0.03, 0, 0], "room") - found)[level].max() > 0.01 * np.abs(found).max()


def test_a_jet_that_is_lifted_blows_higher_in_every_sweep(sides):
    angle, level = 0.2, np.arange(len(sides.time)) % 3 < 2
    higher = np.cos(angle) * sides.jet.direction + np.sin(angle) * np.array([0, 0, 1.0])
    expected = jet_forces(replace(sides.jet, direction=higher), sides.cloud.x, sides.cloud.area)
    found = made(sides, ForceDirection(), [angle, 0, 0], "own")
    assert found[level] == pytest.approx(expected[level], abs=1e-6 * np.abs(expected).max())
    as_before = made(sides, ForceDirection(), [0, 0, 0.5], "own")  # rolled
    assert as_before == pytest.approx(sides.forces, abs=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("cause", [ForceDirection(), ForceOffset()])
def test_from_one_side_there_is_no_telling_whose_axes_they_are(cause, sides):
    assert "own" in cause.places(sides)
    steady = replace(sides.jet, direction=np.repeat(sides.jet.direction[:1], len(sides.time), axis=0))
    assert "own" not in cause.places(sides.under(sides.forces, steady))
    without = sides.under(sides.forces, None)
    assert "own" not in cause.places(without) and cause.elsewhere(without, "own") in cause.places(without)


def test_any_axes_do_for_a_jet_that_blows_straight_down(sides):
    turn = Rotation.from_rotvec([0, 0, 0.1])
    down = sides.under(sides.forces, replace(sides.jet, direction=turn.apply(sides.jet.direction)))
    assert np.isfinite(made(down, ForceOffset(), [0.01, 0.02, 0.03], "own")).all()


def test_a_valve_fills_the_jet_where_its_nozzle_is(sides):
    filled = next(r for r in ForceTiming().places(sides) if r.filled and r.jet)
    found, jet = ForceTiming().loads(sides, np.array([0.07]), filled)
    assert jet.position is sides.jet.position and jet.direction is sides.jet.direction
    assert found == pytest.approx(jet_forces(jet, sides.cloud.x, sides.cloud.area), abs=1e-6 * np.abs(found).max())


def test_a_wider_jet_is_as_strong_on_a_wall(scene):  # noqa: F811
    """Against a jet of that width; each of its forces is another one."""
    wider = replace(scene.jet, footprint=1.5 * scene.jet.footprint)
    expected = jet_forces(wider, scene.cloud.x, scene.cloud.area)
    found = made(scene, ForceFootprint(), [np.log(1.5)], None)
    assert found == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())
    assert np.abs(found - scene.forces).max() > 0.1 * np.abs(scene.forces).max()
    assert ForceFootprint().untestable(scene) is None
    assert "jet" in ForceFootprint().untestable(scene.under(scene.forces, None))
