"""What cameras make of a motion: against what is seen of an object that stands still."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from veo_ti.diagnosis.causes.measurement import CameraPose, CameraScale


def still_object(frames: int) -> tuple[np.ndarray, SimpleNamespace]:
    """Its points (4, 3) and a scene of it."""
    x, time = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]]), np.arange(float(frames))
    return x, SimpleNamespace(cloud=SimpleNamespace(x=x), time=time, moving=(time > 0)[:, None, None])


def test_a_scale_that_grows_is_half_of_it_half_way():
    x, still = still_object(3)
    y = np.repeat(x[None], 3, axis=0)
    seen = CameraScale().change(still, np.array([0.1, 0, 0, 0]), "with time").observe(y, np.arange(3))
    middle = x.mean(axis=0)
    assert seen == pytest.approx(middle + np.array([1, 1.05, 1.1])[:, None, None] * (y - middle))


def test_a_camera_that_was_knocked_at_sees_all_turned_and_shifted_from_then_on():
    x, still = still_object(30)
    turn, shift = Rotation.from_rotvec([0.1, -0.2, 0.3]), np.array([0.5, 0.25, -1.0])
    y = np.repeat(x[None], 30, axis=0)
    theta = np.concatenate([turn.as_rotvec(), shift])
    seen = CameraPose().change(still, theta, 12).observe(y, np.arange(30))
    middle = x.mean(axis=0)
    assert seen[:12] == pytest.approx(y[:12])
    assert seen[12:] == pytest.approx(y[12:] + turn.apply(x - middle) - (x - middle) + shift)


@pytest.mark.parametrize("frames", [5, 10, 30, 90])
def test_every_moment_with_frames_before_and_after_it_is_tried_or_lies_between_those_that_are(frames):
    _, still = still_object(frames)
    places = CameraPose().places(still)
    near = {t for place in places for t in CameraPose().near(still, place)} | set(places)
    assert near == set(range(1 + frames // 8, frames - frames // 8))
    assert len(places) <= 12
