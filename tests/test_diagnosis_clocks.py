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


def test_one_way_never_goes_beyond_the_frames_and_one_is_smooth(pulsed):
    smooth, tight = (read(pulsed, ForceTiming(), 0.05, place) for place in ForceTiming().places(pulsed))
    assert tight.min() >= 0 and tight.max() <= 1
    assert smooth.min() < -0.01 and smooth.max() > 1.01
    assert ForceTiming().near(pulsed, ForceTiming().places(pulsed)[0]) == [ForceTiming().places(pulsed)[1]]
