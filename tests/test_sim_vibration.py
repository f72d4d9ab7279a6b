"""Free vibrations: a beam's closed form, oscillators against an integrator, and the lag against nonlinear dynamics."""

from dataclasses import replace

import clouds
import numpy as np
import pytest
import sim_cases
from scipy.integrate import solve_ivp

from sim.cloud import RestCloud
from sim.direct import Layout
from sim.dynamics import simulate
from sim.elastic import Elastic
from sim.energy import Energy
from sim.lame import Lame
from sim.newton import equilibrate
from sim.terms.loads import AppliedForce
from sim.vibration import Vibrations, delay, follow, lag, relax

TIME = np.array([0.0, 0.3, 0.4, 0.9, 1.0, 1.7])  # [s]
PATH = np.array([0.0, 1.0, -0.5, 0.2, 0.2, 0.0])


def _integrated(course, omega: float, zeta: float, time: np.ndarray) -> np.ndarray:
    def slope(t, state):
        return [state[1], -2 * zeta * omega * state[1] - omega**2 * (state[0] - course(t))]

    return solve_ivp(slope, (0, time[-1]), [0, 0], t_eval=time, rtol=1e-9, atol=1e-11, max_step=0.01).y[0]


def _relaxed(course, rate: float, time: np.ndarray) -> np.ndarray:
    def slope(t, x):
        return rate * (course(t) - x)

    return solve_ivp(slope, (0, time[-1]), [0], t_eval=time, rtol=1e-9, atol=1e-11, max_step=0.01).y[0]


def _line(t: float) -> np.ndarray:
    return np.interp(t, TIME, PATH)


def _course(t: np.ndarray) -> np.ndarray:
    return np.sin(4 * t) ** 2


@pytest.mark.parametrize("zeta", [0.0, 0.05, 0.7, 1.0, 2.5])
def test_oscillator_follows_a_broken_line_as_an_integrator_does(zeta):
    omega = np.array([3.0, 11.0])
    x = follow(omega, zeta, np.repeat(PATH[:, None], 2, axis=1), TIME)
    for k, w in enumerate(omega):
        assert np.abs(x[:, k] - _integrated(_line, w, zeta, TIME)).max() < 1e-5


def test_relaxation_follows_a_broken_line_as_an_integrator_does():
    rate = np.array([0.7, 20.0])
    x = relax(rate, np.repeat(PATH[:, None], 2, axis=1), TIME)
    for k, r in enumerate(rate):
        assert np.abs(x[:, k] - _relaxed(_line, r, TIME)).max() < 1e-5


def test_a_smooth_course_seen_at_a_few_frames_is_followed_closer_as_a_smooth_one():
    time = np.linspace(0, 2, 17)  # six frames a period
    seen = _course(time)[:, None]
    rate, omega = np.array([8.0]), np.array([11.0])
    for exact, follower in (
        (_relaxed(_course, 8.0, time), lambda smooth: relax(rate, seen, time, smooth=smooth)),
        (_integrated(_course, 11.0, 0.1, time), lambda smooth: follow(omega, 0.1, seen, time, smooth=smooth)),
    ):
        linear, smooth = (np.abs(follower(way)[:, 0] - exact).max() for way in (False, True))
        assert smooth < 0.02 and smooth < 0.25 * linear


def test_delay_is_what_heavy_damping_leaves_of_the_lag(box):
    """`m x'' + c x' + k (x - p) = 0` without its first term."""
    energy, mass = box
    found = Vibrations.of(energy, mass, count=4)
    one = replace(found, omega=found.omega[:1], shapes=found.shapes[:1])
    u, time = np.clip(np.sin(3 * TIME), 0, None)[:, None, None] * found.shapes[0], 100 * TIME
    zeta = 200.0
    late = lag(one.omega, one.coordinates(u), time, inertia=1.0, damping=zeta)
    slow = delay(one.omega, one.coordinates(u), time, drag=2 * zeta * float(found.omega[0]))
    assert np.abs(late - slow).max() < 1e-3 * np.abs(late).max()


def test_slender_beam_swings_at_the_frequency_of_euler_and_bernoulli():
    """f = 1.8751^2 / (2 pi) sqrt(E I / (rho A L^4)) for nu = 0; shear makes the real one slower by about 1 %."""
    length, width, young, density = 1.0, 0.08, 1e5, 1000.0
    cloud = RestCloud.build(clouds.block((40, 5, 5), (length, width, width)))
    energy = Energy.of(Elastic.neo_hookean(cloud, Lame(mu=young / 2, lam=1e-6 * young)), fixed=cloud.x[:, 0] < 1e-9)
    found = Vibrations.of(energy, density * cloud.volume, count=3)
    expected = 1.8751**2 * np.sqrt(young * width**2 / (12 * density * length**4))
    assert found.omega[:2] == pytest.approx(expected, rel=0.05)
    assert found.omega[0] == pytest.approx(found.omega[1], rel=1e-2)  # both ways across


def test_modes_are_orthonormal_in_the_mass_and_leave_the_fixed_points(box):
    energy, mass = box
    found = Vibrations.of(energy, mass, count=8)
    gram = np.einsum("kna,n,lna->kl", found.shapes, mass, found.shapes)
    assert np.abs(gram - np.eye(8)).max() < 1e-9
    assert (np.diff(found.omega) > -1e-9).all() and not found.shapes[:, energy.fixed].any()


def test_lag_is_what_nonlinear_dynamics_adds_to_small_motions(box):
    energy, mass = box
    time = np.linspace(0, 3.0, 25)
    force = np.zeros((25, energy.elastic.cloud.count, 3))
    force[:, energy.elastic.cloud.x[:, 0] > 0.95, 2] = 1e-5 * np.clip(np.sin(4 * time), 0, None)[:, None]
    loaded = Energy.of(energy.elastic, [AppliedForce(force=force)], energy.fixed)
    slow = equilibrate(loaded, np.repeat(energy.elastic.cloud.x[None], 25, axis=0)).y
    fast = simulate(loaded, time=time, mass=mass, substeps="auto").y
    modes = Vibrations.of(loaded, mass, count=40)
    p = modes.coordinates(slow - energy.elastic.cloud.x)
    late = modes.motion(lag(modes.omega, p, time, inertia=1.0, damping=0.0))
    assert np.linalg.norm(fast - slow - late) < 0.05 * np.linalg.norm(fast - slow)
    assert np.linalg.norm(fast - slow) > 0.1 * np.linalg.norm(slow - energy.elastic.cloud.x)


def test_no_mass_no_lag_and_a_mass_must_be_positive(box):
    energy, mass = box
    found = Vibrations.of(energy, mass, count=4)
    assert not lag(found.omega, np.ones((6, 4)), TIME, inertia=0.0, damping=0.1).any()
    assert not delay(found.omega, np.ones((6, 4)), TIME, drag=0.0).any()
    with pytest.raises(ValueError, match="mass must be positive"):
        Vibrations.of(energy, 0 * mass)


@pytest.fixture(scope="module")
def box() -> tuple[Energy, np.ndarray]:
    """A jittered clamped box of 1 Pa and 10 g: its slowest vibration takes some seconds."""
    cloud = sim_cases.cloud()
    energy = Energy.of(Elastic.neo_hookean(cloud, Lame(mu=1.0, lam=2.0)), fixed=cloud.x[:, 0] < 1e-9)
    return energy, 0.05 * cloud.volume / cloud.volume.sum()


def test_stiffness_of_a_change_tunes_every_frequency_and_joins_the_modes(box):
    """A bar that stiffens towards one end: against the frequencies of stiffer bars, and its own Hessian at rest."""
    energy, mass = box
    change = energy.elastic.m * (0.5 + energy.elastic.cloud.x[:, :1])
    step = 1e-4
    ahead, behind = (
        Vibrations.of(replace(energy, elastic=energy.elastic.with_parameters(energy.elastic.m + s * change)), mass, 6)
        for s in (step, -step)
    )
    modes = Vibrations.of(energy, mass, 6)
    found, outward = modes.changed(energy.elastic, change, np.arange(6))
    assert np.diagonal(found) == pytest.approx(modes.omega * (ahead.omega - behind.omega) / step, rel=1e-4)

    changed = replace(energy, elastic=energy.elastic.with_parameters(change))
    blocks = changed.tangent(energy.elastic.cloud.x[None]).assembled(slice(0, 1))[0]
    hessian, shapes = Layout.of(energy.elastic).matrix(blocks), modes.shapes.reshape(6, -1)
    expected = shapes @ (hessian @ shapes.T)
    assert np.abs(expected - np.diag(np.diagonal(expected))).max() > 0.01 * np.abs(expected).max()
    assert found == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())

    # The slowest mode joins those that are not among the six as well, which are six times as fast and more.
    turned = (ahead.shapes[0] - np.sign((ahead.shapes[0] * behind.shapes[0]).sum()) * behind.shapes[0]) / (2 * step)
    turned *= np.sign((ahead.shapes[0] * modes.shapes[0]).sum())
    turned -= modes.motion(modes.coordinates(turned[None]))[0]
    assert np.linalg.norm(outward[0] - turned) < 0.05 * np.linalg.norm(turned)
