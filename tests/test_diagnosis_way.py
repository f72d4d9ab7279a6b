"""The way that fingerprints tell: damped, and as far as each parameter can go."""

import numpy as np
import pytest
from scipy.optimize import minimize

from veo_ti.diagnosis.causes.beside import Beside
from veo_ti.diagnosis.causes.history import Softening, StiffnessDrift
from veo_ti.diagnosis.causes.other_loads import FollowerLoad
from veo_ti.diagnosis.way import Way


def test_a_damped_step_goes_down_and_promises_less():
    """The cost of a quadratic bowl is what the step promises, and the undamped step leads to its bottom."""
    random = np.random.default_rng(4)
    root, bottom = random.normal(size=(5, 5)), random.normal(size=5)
    curvature = root @ root.T + np.eye(5)
    way = Way(normal=None, found=None, whole=bottom, curvature=curvature, room=np.full(5, np.inf))

    def cost(x: np.ndarray) -> float:
        return float(0.5 * (x - bottom) @ curvature @ (x - bottom))

    steps = [way.damped(damping) for damping in (0.0, 0.1, 1.0, 10.0)]
    promised = [way.promised(step) for step in steps]
    assert promised == pytest.approx([cost(np.zeros(5)) - cost(step) for step in steps])
    assert promised[0] == pytest.approx(way.gain) == pytest.approx(cost(np.zeros(5)))
    assert (np.diff(promised) < 0).all() and promised[-1] > 0


@pytest.mark.parametrize("damping", [0.0, 0.5])
def test_beside_what_has_no_room_the_others_do_what_is_best(damping):
    """As a bounded minimisation of the same bowl finds it; what is promised is what that brings."""
    random = np.random.default_rng(5)
    root, bottom = random.normal(size=(5, 5)), random.normal(size=5)
    curvature, room = root @ root.T + 0.1 * np.eye(5), np.full(5, np.inf)
    room[4] = bottom[4] = 0.7
    bottom[4] += 0.5
    way = Way(normal=None, found=None, whole=bottom, curvature=curvature, room=room)
    damped = curvature + damping * np.diag(np.diagonal(curvature))
    slope = curvature @ bottom
    expected = minimize(
        lambda x: 0.5 * x @ damped @ x - slope @ x, np.zeros(5), jac=lambda x: damped @ x - slope,
        bounds=[(None, None)] * 4 + [(None, room[4])], tol=1e-12,
    ).x  # fmt: skip
    step = way.damped(damping)
    assert expected[4] == room[4] or damping
    assert step == pytest.approx(expected, abs=1e-4)
    cost = [0.5 * (x - bottom) @ curvature @ (x - bottom) for x in (np.zeros(5), step)]
    assert way.promised(step) == pytest.approx(cost[0] - cost[1])
    if not damping:
        assert way.gain == pytest.approx(cost[0] - cost[1]) and (step == way.change).all()


@pytest.mark.parametrize("cause", [Softening(), FollowerLoad()])
def test_as_long_as_there_is_room_a_step_goes_about_as_far_as_it_says(cause):
    """And there always is some."""
    for theta in np.array([0.0, 0.5, 0.8, 0.88])[:, None]:
        room = cause.room(theta)
        assert room > 0 and 0.6 * room < cause.stepped(theta, room) - theta <= room
        if room < 0.3:
            assert cause.stepped(theta, 10 * room) - theta < 2 * room


def test_room_is_that_of_each_of_two_causes():
    theta = np.array([0.3, 0.5])
    assert Beside(StiffnessDrift(), Softening()).room(theta).tolist() == [np.inf, *Softening().room(theta[1:])]
