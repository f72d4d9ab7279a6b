"""What physics allows of the causes in the loads."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from veo_ti.diagnosis.causes.loads import GravityDirection, HiddenForce

GRAVITY = np.array([0.0, 0.0, -9.81])


def scene(gravity: np.ndarray = GRAVITY, *, scale_known: bool = True) -> SimpleNamespace:
    return SimpleNamespace(observation=SimpleNamespace(gravity=gravity, force_scale_known=scale_known))


def known_to_6_percent(change: np.ndarray) -> np.ndarray:
    return np.full(3, 0.06 * np.linalg.norm(change))


@pytest.mark.parametrize("angle", [0.01, 0.1, 0.5, 1.5, 3.0])
def test_every_tilt_is_a_change_of_gravity(angle):
    tilt = Rotation.from_rotvec(angle * np.array([0.6, 0.8, 0.0]))
    change = tilt.apply(GRAVITY) - GRAVITY
    for error in np.vstack([np.zeros(3), 0.06 * np.linalg.norm(change) * np.eye(3)]):  # as far off as it may be
        assert GravityDirection().plausible(scene(), change + error, known_to_6_percent(change))


@pytest.mark.parametrize("change", [[0, 0, 2.0], [0, 1.0, -1.0], [0, 0, -0.3], [2.0, 0, 3.0]])
def test_what_makes_gravity_stronger_or_weaker_is_no_tilt(change):
    """Of two seeds, 1807 and 1995, a hidden force whose equal in gravity would be like that."""
    spread = known_to_6_percent(np.array(change))
    assert not GravityDirection().plausible(scene(), np.array(change), spread)
    assert GravityDirection().plausible(scene(), np.array(change), 5 * spread)  # nobody knows
    assert GravityDirection().plausible(scene(0 * GRAVITY), np.array(change), spread)  # nor what gravity was
    assert GravityDirection().plausible(scene(scale_known=False), np.array(change), spread)  # or only up to scale


def test_a_tilt_is_likelier_than_chance_by_what_strengths_of_gravity_forces_would_make():
    """A tilt, a little off: against forces as large, in any direction, measured as well as it is."""
    change = Rotation.from_rotvec([0.5, 0.2, 0.0]).apply(GRAVITY) - GRAVITY + [0.0, 0.0, 0.15]
    size, sd, rng = np.linalg.norm(change), 0.2, np.random.default_rng(0)
    ways = rng.normal(size=(400_000, 3))
    forces = size * ways / np.linalg.norm(ways, axis=1, keepdims=True)

    def off(change: np.ndarray) -> np.ndarray:
        return np.linalg.norm(GRAVITY + change, axis=-1) - 9.81

    by_force, by_tilt = (np.abs(m + sd * rng.normal(size=len(ways)) - off(change)) < 0.02 for m in (off(forces), 0.0))
    expected = by_force.mean() / by_tilt.mean()
    assert expected < 0.1
    assert GravityDirection().coincidence(scene(), change, np.full(3, sd)) == pytest.approx(expected, rel=0.07)


def test_nothing_tells_a_tilt_from_a_level_force_or_where_gravity_is_not_known():
    slight = Rotation.from_rotvec([0.1, 0.0, 0.0]).apply(GRAVITY) - GRAVITY
    large = Rotation.from_rotvec([0.6, 0.0, 0.0]).apply(GRAVITY) - GRAVITY
    well = np.full(3, 1e-3)
    assert GravityDirection().coincidence(scene(), large, well) < 1e-3
    assert GravityDirection().coincidence(scene(), large, 1e4 * well) == 1.0  # too little is known of it
    assert GravityDirection().coincidence(scene(), large + 0.1, well) == 1.0  # it is none
    assert GravityDirection().coincidence(scene(), slight, well) == 1.0
    assert GravityDirection().coincidence(scene(0 * GRAVITY), large, well) == 1.0
    assert GravityDirection().coincidence(scene(scale_known=False), large, well) == 1.0
    assert GravityDirection().coincidence(scene(), np.zeros(3), well) == 1.0


def test_only_a_cause_with_a_law_is_lawful():
    assert GravityDirection().lawful and not HiddenForce().lawful


def filmed(gravity: np.ndarray) -> SimpleNamespace:
    time, mass = np.array([1.0, 2.0, 3.0]), np.array([1.0, 2.0])
    return SimpleNamespace(time=time, moving=(time > 1)[:, None, None], mass=mass, **vars(scene(gravity)))


def test_a_change_of_gravity_that_grows_is_half_of_it_half_way():
    still, theta = filmed(0 * GRAVITY), np.array([1.0, -2.0, 0.5])
    for place, share in zip(GravityDirection().places(still), ([0, 1, 1], [0, 0.5, 1]), strict=True):
        (term,) = GravityDirection().change(still, theta, place).terms
        assert term.force == pytest.approx(np.einsum("t,n,a->tna", share, still.mass, theta))
        assert GravityDirection().near(still, place) == [p for p in GravityDirection().places(still) if p != place]


def test_a_tilt_that_grows_is_one_by_half_the_angle_half_way():
    half, whole = (Rotation.from_rotvec([angle, 0, 0]).apply(GRAVITY) - GRAVITY for angle in (0.3, 0.6))
    (term,) = GravityDirection().change(filmed(GRAVITY), whole, "with time").terms
    expected = np.einsum("ta,n->tna", [0 * whole, half, whole], [1.0, 2.0])
    assert term.force == pytest.approx(expected, abs=1e-12)
