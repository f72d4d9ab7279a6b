"""Memory of a material against closed forms: a Maxwell branch under ramp, hold and sine; damage of the largest load."""

import clouds
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim.laws.history import green_strain, largest, viscous
from sim.laws.softening import damage, damage_slope

TAU = 0.3  # [s]


def viscous_strain(E: np.ndarray, time: np.ndarray, tau: float) -> np.ndarray:
    """E_v of strains E (T, ...)."""
    memory = viscous(time, tau)
    return memory.past(E) + memory.own.reshape(-1, *[1] * (E.ndim - 1)) * E


def pattern(seed: int = 0) -> np.ndarray:
    """A symmetric strain at each of five points, (5, 3, 3)."""
    E = np.random.default_rng(seed).normal(size=(5, 3, 3)) * 0.1
    return E + E.swapaxes(1, 2)


def uneven(count: int, end: float, seed: int = 1) -> np.ndarray:
    """Times (T,) [s] from 0 to `end` without a fixed step."""
    return np.concatenate([[0.0], np.sort(np.random.default_rng(seed).uniform(0, end, count - 2)), [end]])


@pytest.mark.parametrize("count", [3, 40])
def test_viscous_strain_of_a_ramp_lags_by_tau(count):
    time = uneven(count, 2.0)
    got = viscous_strain(time[:, None, None, None] * pattern(), time, TAU)
    lag = time - TAU * (1 - np.exp(-time / TAU))
    np.testing.assert_allclose(got, lag[:, None, None, None] * pattern(), atol=1e-15)


def test_viscous_strain_of_a_held_strain_relaxes_to_it():
    rise, time = 0.1, np.concatenate([[0.0, 0.1], 0.1 + uneven(20, 3.0)[1:]])
    E = np.minimum(time / rise, 1.0)
    at_rise = 1 - TAU / rise * (1 - np.exp(-rise / TAU))
    expected = np.where(time < rise, 0.0, 1 - (1 - at_rise) * np.exp(-(time - rise) / TAU))
    np.testing.assert_allclose(viscous_strain(E, time, TAU), expected, atol=1e-15)


def test_viscous_strain_solves_its_equation_for_any_piecewise_linear_strain():
    time, E = uneven(12, 2.0), np.random.default_rng(2).normal(size=12)
    E[0] = 0.0
    exact = [0.0]
    for t in range(11):  # kink by kink, so that the integrator sees smooth pieces

        def rate(s, v, t=t):
            return (np.interp(s, time, E) - v) / TAU

        piece = solve_ivp(rate, (time[t], time[t + 1]), [exact[-1]], rtol=1e-11, atol=1e-13)
        exact.append(piece.y[0, -1])
    np.testing.assert_allclose(viscous_strain(E, time, TAU), exact, atol=1e-9)


def test_more_frames_on_the_same_lines_change_nothing():
    time, E = uneven(9, 2.0), np.random.default_rng(3).normal(size=9)
    E[0] = 0.0
    finer = np.sort(np.concatenate([time, np.random.default_rng(4).uniform(0, 2.0, 30)]))
    got = viscous_strain(np.interp(finer, time, E), finer, TAU)[np.searchsorted(finer, time)]
    np.testing.assert_allclose(got, viscous_strain(E, time, TAU), atol=1e-14)


def test_viscous_strain_of_a_long_and_a_short_memory():
    time, E = uneven(30, 2.0), np.random.default_rng(5).normal(size=30)
    E[0] = 0.0
    fast, slow = viscous_strain(E, time, 1e-9), viscous_strain(E, time, 1e9)
    np.testing.assert_allclose(fast[1:], E[1:], atol=1e-5)
    area = np.concatenate([[0.0], np.cumsum(np.diff(time) * (E[1:] + E[:-1]) / 2)])
    np.testing.assert_allclose(slow * 1e9, area, atol=1e-6)  # 1 - (1 - e^-x)/x keeps 1e-16 of x = 1e-11


@pytest.mark.parametrize("time, tau", [([0.0, 1.0, 1.0], 1.0), ([0.0, 1.0], 1.0), ([0.0, 1.0, 2.0], 0.0)])
def test_wrong_times_are_refused(time, tau):
    with pytest.raises(ValueError, match=r"(time|tau|E) must"):
        viscous_strain(np.zeros((3, 2)), np.array(time), tau)


def test_largest_strain_so_far_is_kept():
    size = np.array([0.0, 0.0, 1e-30, 0.5, 1.0, 0.7, 0.2, 1.4, 0.0])[:, None]
    E = size[..., None, None] * pattern(3)
    memory = largest(E)
    got = memory.own * E + memory.past(E)
    np.testing.assert_allclose(got, np.maximum.accumulate(size)[..., None, None] * pattern(3), atol=1e-15)


def test_two_strains_of_about_the_same_size_do_not_take_turns():
    A, B = (E / np.linalg.norm(E, axis=(1, 2), keepdims=True) for E in (pattern(3), pattern(4)))

    def kept(size: float) -> np.ndarray:
        E = np.stack([A, size * B, 0 * A])
        return largest(E).past(E)[-1]

    assert np.abs(kept(1 + 1e-6) - kept(1 - 1e-6)).max() < 1e-4


def test_largest_of_two_directions_is_that_of_the_larger_strain():
    small, large = pattern(5), pattern(6)
    small *= 0.6 * np.linalg.norm(large, axis=(1, 2), keepdims=True) / np.linalg.norm(small, axis=(1, 2), keepdims=True)
    E = np.stack([large, small, 0 * large])
    memory = largest(E)
    got = memory.own * E + memory.past(E)
    assert np.abs(got - large).max() < 1e-3 * np.abs(large).max()


def test_beyond_a_yield_strain_what_stays_is_the_largest_strain_less_that():
    sizes = np.array([0.0, 0.05, 0.2, 0.5, 0.3, 0.0, 0.1])
    way = pattern(5) / np.linalg.norm(pattern(5), axis=(1, 2), keepdims=True)
    E = sizes[:, None, None, None] * way
    for yields in (0.0, 0.1, 0.6):
        memory = largest(E, yields)
        got = memory.own * E + memory.past(E)
        expected = np.maximum(np.maximum.accumulate(sizes) - yields, 0)[:, None, None, None] * way
        assert np.abs(got - expected).max() < 1e-3 * np.abs(E).max()


def stretched(s: np.ndarray) -> np.ndarray:
    """Turned uniaxial stretches s (T,) at J = 1, two points of which the second stands still, (T, 2, 3, 3)."""
    F = np.array([np.diag([v, v**-0.5, v**-0.5]) for v in s])
    return np.stack([clouds.rotation(0.7) @ F, np.tile(clouds.rotation(1.9), (len(s), 1, 1))], axis=1)


def test_damage_is_that_of_the_largest_load_so_far():
    s = np.array([1.0, 1.5, 1.2, 1.4, 1.6, 1.0, 0.9])
    invariant = s**2 + 2 / s - 3
    largest = np.array([invariant[: t + 1].max() for t in range(len(s))])
    got = damage(stretched(s), 0.5)
    np.testing.assert_allclose(got[:, 0], 1 - 1 / (1 + largest / 0.5), atol=1e-14)
    np.testing.assert_allclose(got[:, 1], 0.0, atol=1e-14)
    soon = damage(stretched(s), 0.5, soon=True)
    np.testing.assert_allclose(soon[:, 0], 1 - np.exp(-largest / 0.5), atol=1e-14)


@pytest.mark.parametrize("soon", [False, True])
def test_damage_grows_at_the_rate_it_says(soon):
    s, step = 1.5, 1e-6
    D, more = (damage(stretched(np.array([v])), 0.5, soon=soon)[0, 0] for v in (s, s + step))
    rate = damage_slope(D, 0.5, soon=soon) * (2 * s - 2 / s**2)  # of I = s^2 + 2 / s - 3
    assert (more - D) / step == pytest.approx(rate, rel=1e-4)


def test_damage_grows_and_stays_below_one():
    F = np.eye(3) + np.random.default_rng(6).uniform(-0.2, 0.2, (20, 7, 3, 3))
    D = damage(F, 0.3)
    assert D.shape == (20, 7)
    assert (np.diff(D, axis=0) >= 0).all()
    assert 0 <= D.min() <= D.max() < 1


@pytest.mark.parametrize(("share", "rises"), [(0.88, True), (0.9, False)])
def test_stress_of_a_damaged_material_rises_up_to_eight_ninths(share, rises):
    strain = np.linspace(0.0, 5e-3, 500)[1:]
    F = np.eye(3) + strain[:, None, None, None] * pattern(3)[:1]
    stress = (1 - share * damage(F, 1e-6)[:, 0]) * strain
    assert (np.diff(stress) > 0).all() == rises


def test_damage_refuses_what_is_inside_out_or_has_no_scale():
    F = np.tile(np.eye(3), (2, 1, 1, 1))
    with pytest.raises(ValueError, match="scale must"):
        damage(F, 0.0)
    with pytest.raises(ValueError, match="F must have J > 0"):
        damage(-F, 1.0)


def test_green_strain_does_not_see_a_rotation():
    F = np.eye(3) + np.random.default_rng(7).uniform(-0.3, 0.3, (4, 3, 3))
    np.testing.assert_allclose(green_strain(clouds.rotation(2.0) @ F), green_strain(F), atol=1e-15)
    np.testing.assert_allclose(green_strain(np.diag([2.0, 1.0, 0.5])), np.diag([1.5, 0.0, -0.375]))
