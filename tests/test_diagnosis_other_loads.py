"""Causes that make other loads of the nominal ones: against loads written down directly, one and one after another."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from test_diagnosis import scene  # noqa: F401

from sim.terms.jet import jet_forces
from veo_ti.diagnosis.causes.beside import Beside
from veo_ti.diagnosis.causes.clocks import ClockDrift, ForceTiming, Reading
from veo_ti.diagnosis.causes.loads import HiddenForce
from veo_ti.diagnosis.causes.other_loads import FollowerLoad, ForceDirection, ForceMagnitude, ForceOffset, Strength

TURN, SHIFT = np.array([0.3, -0.2, 0.1]), np.array([0.04, -0.02, 0.01])
R = Rotation.from_rotvec(TURN)
FRAME = 0.1  # [s]
BY_POINTS, BY_JET = Reading(CubicSpline, False), Reading(CubicSpline, True)


def made(scene, cause, theta, place) -> np.ndarray:  # noqa: F811
    """All forces (T, N, 3) [N] under a cause."""
    terms = cause.change(scene, np.asarray(theta, float), place).terms
    return scene.forces + sum(t.force for t in terms)


def turned(forces: np.ndarray) -> np.ndarray:
    return R.apply(forces.reshape(-1, 3)).reshape(forces.shape)


def late(forces: np.ndarray) -> np.ndarray:
    """Of the frame before; the first one is not asked for."""
    return np.concatenate([forces[:1], forces[:-1]])


def saturated(forces: np.ndarray) -> np.ndarray:
    total = np.linalg.norm(forces.sum(axis=1), axis=1)
    share = total / total.max()
    return forces / (share + (1 - share) * np.exp(0.5))[:, None, None]


def carried(scene, forces: np.ndarray) -> np.ndarray:  # noqa: F811
    J = np.linalg.det(scene.F)[..., None, None]
    return np.einsum("tnba,tnb->tna", np.linalg.inv(scene.F) * J, forces)


CAUSES = {
    "late": (ForceTiming(), [FRAME], BY_POINTS, lambda _, f: late(f)),
    "turned": (ForceDirection(), TURN, "force", lambda _, f: turned(f)),
    "saturated": (ForceMagnitude(), [0.5], Strength("saturation", False), lambda _, f: saturated(f)),
    "carried": (FollowerLoad(), [1.0], None, carried),
}


@pytest.mark.parametrize(("first", "then"), [
    ("late", "turned"), ("late", "saturated"), ("late", "carried"), ("turned", "saturated"), ("turned", "carried"),
    ("saturated", "carried"),
])  # fmt: skip
@pytest.mark.parametrize("found_first", [True, False])
def test_of_two_other_loads_one_is_made_of_the_other(scene, first, then, found_first):  # noqa: F811
    """Whichever was found first."""
    (a, theta_a, place_a, does_a), (b, theta_b, place_b, does_b) = CAUSES[first], CAUSES[then]
    pair = (Beside(a, b), [*theta_a, *theta_b], (place_a, place_b))
    if not found_first:
        pair = (Beside(b, a), [*theta_b, *theta_a], (place_b, place_a))
    expected = does_b(scene, does_a(scene, scene.forces))
    size = np.abs(scene.forces).max()
    assert made(scene, *pair)[1:] == pytest.approx(expected[1:], abs=1e-9 * size)
    apart = sum(made(scene, c, theta, place) - scene.forces for c, theta, place, _ in (CAUSES[first], CAUSES[then]))
    assert np.abs(scene.forces + apart - expected)[1:].max() > 0.02 * size  # what each does alone does not add up


def test_a_load_that_turns_is_remembered_as_the_other_cause_made_it(scene):  # noqa: F811
    """Whichever was found first, and what each frame's own motion adds to it is in proportion."""
    change = 0.01 * scene.cloud.spacing * np.random.default_rng(0).normal(size=(1, scene.cloud.count, 3))
    frame, w = int(scene.total_force.argmax()), 0.7
    told = scene.under(turned(scene.forces), scene.jet)
    (expected,) = FollowerLoad().remembered(told, np.array([w]), None)
    for pair, theta, place in (
        (Beside(ForceDirection(), FollowerLoad()), [*TURN, w], ("force", None)),
        (Beside(FollowerLoad(), ForceDirection()), [w, *TURN], (None, "force")),
    ):
        (found,) = pair.remembered(scene, np.array(theta), place)
        assert found.own(frame, change) == pytest.approx(expected.own(frame, change))
        assert np.abs(found.own(frame, change)).max() > 0


def test_no_load_turns_much_further_than_the_surface():
    """However far a slope promises to gain."""
    steps = np.array([0.1, 1.0, 10.0])
    shares = np.array([FollowerLoad().stepped(np.zeros(1), np.array([step]), None)[0] for step in steps])
    assert shares[0] == pytest.approx(0.1, rel=0.05) and (np.diff(shares) > 0).all() and 1 < shares[-1] <= 1.2


@pytest.mark.parametrize("place", ["nozzle", "force"])
def test_a_jet_that_is_shifted_and_turned_is_one_jet(scene, place):  # noqa: F811
    """Turned about its nozzle after it was shifted; or its forces turned where the shifted one acts."""
    jet, cloud = scene.observation.jet, scene.cloud
    shifted = replace(jet, position=jet.position + SHIFT)
    both = replace(shifted, direction=R.apply(jet.direction))
    where_it_acts = turned(jet_forces(shifted, cloud.x, cloud.area))
    expected = jet_forces(both, cloud.x, cloud.area) if place == "nozzle" else where_it_acts
    for cause, theta, at in (
        (Beside(ForceOffset(), ForceDirection()), [*SHIFT, *TURN], (None, place)),
        (Beside(ForceDirection(), ForceOffset()), [*TURN, *SHIFT], (place, None)),
    ):
        assert made(scene, cause, theta, at) == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize(("law", "theta", "valve"), [
    ("saturation", -np.log(1 + 1.7), lambda s: (1 + 1.7) * s / (1 + 1.7 * s)), ("power", 0.4, lambda s: s**1.4),
    ("dead", -np.log(1 - 0.5), lambda s: np.maximum(s - 0.5, 0) / (1 - 0.5)),
    ("dead", -np.log(1 + 0.25), lambda s: (s > 0) * (s + 0.25) / (1 + 0.25)),
])  # fmt: skip
def test_a_valve_changes_the_jet_however_much_of_it_the_object_meets(scene, law, theta, valve):  # noqa: F811
    """Against a jet of other strengths; by the total of each frame the same law is another one."""
    jet, cloud = scene.observation.jet, scene.cloud
    most = jet.force.max()
    expected = jet_forces(replace(jet, force=most * valve(jet.force / most)), cloud.x, cloud.area)
    found, by_total = (made(scene, ForceMagnitude(), [theta], Strength(law, of_jet)) for of_jet in (True, False))
    size = np.linalg.norm(expected)
    assert np.linalg.norm(found - expected) < 1e-6 * size < 1e-3 * np.linalg.norm(by_total - expected)


def test_what_is_told_of_the_loads_is_what_both_make_of_them(scene):  # noqa: F811
    pair, theta, place = Beside(ForceTiming(), ForceDirection()), np.array([FRAME, *TURN]), (BY_JET, "nozzle")
    told = pair.told(scene, theta, place)
    assert told.forces == pytest.approx(made(scene, pair, theta, place))
    assert told.jet.direction[1:] == pytest.approx(R.apply(scene.jet.direction)[:-1])
    assert replace(told, y=told.y).forces is told.forces  # of every scene that is made of it
    assert HiddenForce().told(scene, theta, None) is scene


@pytest.mark.parametrize(("cause", "theta", "when"), [
    (ForceTiming(), FRAME / 2, lambda t: t - FRAME / 2), (ClockDrift(), -0.3, lambda t: 0.7 * t),
])  # fmt: skip
def test_between_frames_the_air_blows_between_their_places(scene, cause, theta, when):  # noqa: F811
    """A steady jet that wanders evenly, in steps as wide as its footprint: where it blows at other times is known."""
    jet = scene.observation.jet
    t, along = scene.time, np.linspace(0.1, 1.3, len(scene.time))
    position = np.stack([along, 0 * t + 0.2, 0 * t + 1.0], axis=1)
    steady = replace(jet, position=position, force=np.full(len(t), 0.03), footprint=0.1)
    filmed = replace(scene, observation=replace(
        scene.observation, jet=steady, forces=jet_forces(steady, scene.cloud.x, scene.cloud.area)
    ))  # fmt: skip
    there = replace(steady, position=position + np.outer((when(t) - t) / FRAME, position[1] - position[0]))
    expected = jet_forces(there, scene.cloud.x, scene.cloud.area)
    off = [np.linalg.norm((made(filmed, cause, [theta], place) - expected)[1:]) for place in (BY_JET, BY_POINTS)]
    assert off[0] < 1e-6 * np.linalg.norm(expected) and off[1] > 0.02 * np.linalg.norm(expected)


def test_without_a_jet_the_load_is_read_point_by_point(scene):  # noqa: F811
    bare = replace(scene, observation=replace(scene.observation, jet=None))
    assert not any(place.jet for place in ForceTiming().places(bare))
    assert ForceTiming().elsewhere(bare, BY_JET) == BY_POINTS
    assert ForceTiming().elsewhere(scene, BY_JET) == BY_JET
