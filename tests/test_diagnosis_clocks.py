"""Causes in the clocks: what a load does between frames is not known; both ways of reading it keep to the frames."""

from types import SimpleNamespace

import numpy as np
import pytest

from veo_ti.diagnosis.causes.clocks import ClockDrift, ForceTiming


@pytest.fixture
def pulsed() -> SimpleNamespace:
    """A force that is off, sets in, stays and ends."""
    course = np.array([0, 0, 0, 1.0, 1.0, 1.0, 0, 0, 0])
    return SimpleNamespace(time=0.1 * np.arange(9), forces=course[:, None, None] * np.ones((1, 2, 3)), jet=None)


def read(scene: SimpleNamespace, cause, theta: float, place) -> np.ndarray:
    """The force on one point along one axis."""
    return (scene.forces + cause.change(scene, np.array([theta]), place).terms[0].force)[:, 0, 0]


@pytest.mark.parametrize("way", [0, 1])
def test_a_delay_of_whole_frames_is_the_load_of_other_frames(pulsed, way):
    place = ForceTiming().places(pulsed)[way]
    assert read(pulsed, ForceTiming(), 0.1, place)[1:] == pytest.approx(pulsed.forces[:-1, 0, 0])
    assert read(pulsed, ForceTiming(), -0.1, place)[:-1] == pytest.approx(pulsed.forces[1:, 0, 0])


@pytest.mark.parametrize("way", [0, 1])
def test_a_clock_half_as_fast_meets_every_other_frame(pulsed, way):
    place = ClockDrift().places(pulsed)[way]
    assert read(pulsed, ClockDrift(), -0.5, place)[::2] == pytest.approx(pulsed.forces[:5, 0, 0])


@pytest.mark.parametrize(
    ("lost", "expected"), [(-2, [0, 1, 2, 2.5, 2.5, 3, 4, 5, 6]), (2, [0, 1, 2, 5, 6, 7, 8, 9, 9])]
)
def test_a_clock_that_stops_is_late_from_then_on_and_one_that_jumps_early(lost, expected):
    """Loads in proportion to time tell when they are of; after the last frame they go on by a frame at most."""
    forces = np.arange(9.0)[:, None, None] * np.ones((1, 2, 3))
    scene = SimpleNamespace(time=0.1 * np.arange(9), forces=forces, jet=None)
    stops = [place for place in ClockDrift().places(scene) if place.since is not None]
    assert all(0.1 < place.since < 0.8 for place in stops)
    found = read(scene, ClockDrift(), lost / 8, next(p for p in stops if p.since == pytest.approx(0.25)))
    assert found == pytest.approx(np.array(expected, float), abs=1e-9)


def test_a_clock_may_also_have_stopped_at_moments_nearby_and_the_load_gone_on_smoothly(pulsed):
    stop = next(place for place in ClockDrift().places(pulsed) if place.since == pytest.approx(0.35))
    near = ClockDrift().near(pulsed, stop)
    assert {round(place.since, 2) for place in near} == {0.25, 0.35, 0.45} and stop not in near
    assert len(near) == len(set(near)) == 5  # in two ways each


def test_one_way_never_goes_beyond_the_frames_and_one_is_smooth(pulsed):
    late = ForceTiming().places(pulsed)[:2]
    smooth, tight = (read(pulsed, ForceTiming(), 0.05, place) for place in late)
    assert tight.min() >= 0 and tight.max() <= 1
    assert smooth.min() < -0.01 and smooth.max() > 1.01
    assert ForceTiming().near(pulsed, late[0]) == ForceTiming().places(pulsed)[1:]
    assert ClockDrift().near(pulsed, late[0]) == ClockDrift().places(pulsed)[1:]


@pytest.mark.parametrize("delay", [0.05, 0.2])
def test_through_a_volume_that_fills_a_swinging_load_swings_later_and_less(delay):
    """Steadily, by `1 / sqrt(1 + (omega delay)^2)` and the phase `atan(omega delay)`: a low pass of first order."""
    time, omega = 0.05 * np.arange(120), 3.0
    scene = SimpleNamespace(time=time, forces=np.sin(omega * time)[:, None, None] * np.ones((1, 2, 3)), jet=None)
    filled = ForceTiming().laws(scene)[-1]
    assert filled.filled
    expected = np.sin(omega * time - np.arctan(omega * delay)) / np.hypot(1, omega * delay)
    steady = time > 10 * delay + 0.5
    found = read(scene, ForceTiming(), delay, filled)
    assert found[steady][:-1] == pytest.approx(expected[steady][:-1], abs=2e-3)
    assert found[0] == 0 and np.abs(read(scene, ForceTiming(), 0.0, filled) - scene.forces[:, 0, 0]).max() < 1e-12
