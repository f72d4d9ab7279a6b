"""The way that fingerprints tell: damped, and as far as each parameter can go."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from sim.evidence import Normal
from veo_ti.diagnosis.causes.beside import Beside
from veo_ti.diagnosis.causes.history import Mullins, Softening, StiffnessDrift
from veo_ti.diagnosis.causes.other_loads import FollowerLoad
from veo_ti.diagnosis.way import Way


def bowl(
    bottom: np.ndarray, curvature: np.ndarray, *, room: np.ndarray | None = None, log_mu: np.ndarray | None = None
) -> Way:
    """The way to the bottom of a quadratic bowl, whose first unknowns are a material's if that is given."""
    log_mu = np.zeros((1, 0)) if log_mu is None else log_mu
    room = np.full(len(bottom), np.inf) if room is None else room
    return Way(normal=None, found=None, whole=bottom, curvature=curvature, room=room, log_mu=log_mu)


def test_a_damped_step_goes_down_and_promises_less():
    """The cost of a quadratic bowl is what the step promises, and the undamped step leads to its bottom."""
    random = np.random.default_rng(4)
    root, bottom = random.normal(size=(5, 5)), random.normal(size=5)
    curvature = root @ root.T + np.eye(5)
    way = bowl(bottom, curvature)

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
    way = bowl(bottom, curvature, room=room)
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


@pytest.mark.parametrize("damping", [0.0, 0.5])
def test_a_material_that_would_change_far_is_held_back_and_shortens_nothing_else(damping):
    """No log mu changes by more than is allowed; of all steps that change the material no more, in the mean of
    squares, it is the best, as a constrained minimisation finds it; what may change so far does."""
    random = np.random.default_rng(6)
    root, log_mu = random.normal(size=(5, 5)), random.normal(size=(40, 3))

    def changed(x: np.ndarray) -> float:
        return float(((log_mu @ x[:3]) ** 2).sum())

    curvature, bottom = root @ root.T + 0.1 * np.eye(5), np.array([3.0, -2.0, 1.0, 1.5, -0.5])
    way = bowl(bottom, curvature, log_mu=log_mu)
    farthest = np.abs(log_mu @ way.damped(damping)[:3]).max()
    assert (way.damped(damping, 1.01 * farthest) == way.damped(damping)).all()
    step = way.damped(damping, 0.2 * farthest)
    assert np.abs(log_mu @ step[:3]).max() == pytest.approx(0.2 * farthest, rel=1e-4)
    assert way.promised(step) > way.promised(0.2 * way.damped(damping))
    damped, slope = curvature + damping * np.diag(np.diagonal(curvature)), curvature @ bottom
    expected = minimize(
        lambda x: 0.5 * x @ damped @ x - slope @ x, 0.2 * way.damped(damping), jac=lambda x: damped @ x - slope,
        constraints={"type": "ineq", "fun": lambda x: changed(step) - changed(x)}, tol=1e-12,
    ).x  # fmt: skip
    assert step == pytest.approx(expected, abs=1e-4)


def test_a_bent_step_takes_up_all_of_the_curvature_that_unknowns_can():
    """Of a residual `r - X v + X w + z`, z out of reach of all unknowns, the bent step leaves `r - X v + z`."""
    random, s2, prior = np.random.default_rng(6), 0.04, 1e6
    X, (r, z), (at, v, w) = random.normal(size=(30, 4)), random.normal(size=(2, 30)), random.normal(size=(3, 4))
    z -= X @ np.linalg.lstsq(X, z, rcond=None)[0]

    def normal(at: np.ndarray, r: np.ndarray) -> Normal:
        return Normal(A=X.T @ X, b=X.T @ (r + X @ at), c=float(r @ r), count=len(r))

    way = replace(bowl(v, X.T @ X / s2 + np.eye(4) / prior), normal=normal(at, r))
    there = normal(at + v, r - X @ v + X @ w + z)
    assert way.bent(v, there, s2) == pytest.approx(v + w, abs=1e-6)
    assert way.bent(v, normal(at + v, r - X @ v), s2) == pytest.approx(v, abs=1e-9)  # of a straight way


@pytest.mark.parametrize(("cause", "place"), [(Softening(), Mullins(0.1)), (FollowerLoad(), None)])
def test_as_long_as_there_is_room_a_step_goes_about_as_far_as_it_says(cause, place):
    """And there always is some."""
    for theta in np.array([0.0, 0.5, 0.8, 0.88])[:, None]:
        room = cause.room(theta, place)
        assert room > 0 and 0.6 * room < cause.stepped(theta, room, place) - theta <= room
        if room < 0.3:
            assert cause.stepped(theta, 10 * room, place) - theta < 2 * room


def test_room_is_that_of_each_of_two_causes():
    theta, soft = np.array([0.3, 0.5]), Mullins(0.1)
    room = Beside(StiffnessDrift(), Softening()).room(theta, (0.0, soft))
    assert room.tolist() == [np.inf, *Softening().room(theta[1:], soft)]
