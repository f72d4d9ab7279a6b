"""The beam's motion on its shapes: closed forms of its parts, finite elements, the full simulation."""

import fem
import numpy as np
import pytest
from beam_shapes import POISSON, TIP, WEIGHT, YOUNG, shapes
from scipy.sparse import eye, kron
from scipy.sparse.linalg import eigsh
from skfem import BilinearForm

from veo_ti.beam import CORNER, DENSITY, SIZE, BeamModel
from veo_ti.beam_dynamics.fitting import effective_count
from veo_ti.beam_dynamics.full import full_markers
from veo_ti.beam_dynamics.heldout import interval
from veo_ti.beam_dynamics.ritz import Physics, Start, beam_elastic, creep, released
from veo_ti.beam_dynamics.setting import _sideways, straightest
from veo_ti.beam_dynamics.sinusoid import ring_down
from veo_ti.body import tie_markers

NOW = Start(rise=0.0)


# Closed forms.


def test_ring_down_of_a_damped_sinusoid_is_recovered_within_its_interval():
    t, random = np.arange(120) / 100, np.random.default_rng(0)
    for f, ratio in ((7.7, 0.05), (4.3, 0.02)):
        w = 2 * np.pi * f
        exact = 4e-3 * np.exp(-ratio * w * t) * np.cos(w * np.sqrt(1 - ratio**2) * t + 0.4) + 3e-4 * np.exp(-2 * t)
        clean = ring_down(t, exact)
        assert clean.frequency == pytest.approx(f * np.sqrt(1 - ratio**2), rel=1e-5)
        assert clean.ratio == pytest.approx(ratio, rel=1e-4)
        assert clean.decrement == pytest.approx(2 * np.pi * ratio / np.sqrt(1 - ratio**2), rel=1e-4)
        noisy = ring_down(t, exact + 5e-5 * random.normal(size=120))
        assert abs(noisy.frequency - clean.frequency) < 3 * noisy.frequency_sd < 0.1
        assert abs(noisy.ratio - ratio) < 3 * noisy.ratio_sd < 0.02


def test_creep_without_mass_is_the_exponential_of_the_standard_linear_solid():
    g, tau = 0.3, 0.2
    rates, amounts = creep(Physics(branches=((g, tau),)))
    assert rates.real == pytest.approx([-1 / ((1 + g) * tau)]) and amounts.real == pytest.approx([g / (1 + g)])
    rates, amounts = creep(Physics(stiffness_damping=0.05))
    assert rates.real == pytest.approx([-1 / 0.05]) and amounts.real == pytest.approx([1])


def test_slow_release_is_the_mean_over_its_moments():
    rate, rise, time = -3 + 20j, 0.08, np.arange(-5, 40) / 100
    shown = released(np.array([rate]), np.array([[2.0 + 0j]]), np.array([2.0]), Start(latency=0.01, rise=rise), time)
    moments = 0.01 + rise * (np.arange(4000) + 0.5) / 4000
    past = time[:, None] - moments
    exact = np.where(past < 0, 2.0, 2 * np.exp(rate * np.maximum(past, 0)).real).mean(axis=1)
    assert shown[:, 0] == pytest.approx(exact, abs=1e-6)


def test_residuals_that_repeat_each_other_count_once():
    random = np.random.default_rng(0)
    white = random.normal(size=(400, 1, 3))
    assert effective_count([white]) == pytest.approx(800, rel=0.15)  # two of three coordinates lie in the plane
    assert effective_count([np.repeat(white, 3, axis=1)]) == pytest.approx(effective_count([white]), rel=1e-6)
    wave = np.sin(np.arange(400) / 5)[:, None, None] * np.ones(3)
    assert effective_count([wave]) < 8


def test_gain_interval_covers_and_leaves_out_zero():
    random = np.random.default_rng(0)
    before, after = (3e-3 * random.normal(size=200)) ** 2, (1e-3 * random.normal(size=200)) ** 2
    low, high = interval([before], [after], 10)
    assert 0 < low < 2 < high < 2.6


# The beam on its shapes.


@pytest.fixture(scope="module")
def model() -> BeamModel:
    return BeamModel.of(300)


def fem_frequency() -> float:
    """The first bending frequency by quadratic hexahedra [Hz]."""
    lower = np.array(CORNER)
    mu, lam = YOUNG / (2 * (1 + POISSON)), YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    constant = [lambda x, value=value: np.full(len(x), value) for value in (mu, lam)]
    mesh = fem.box_mesh(lower, lower + np.array(SIZE), (8, 3, 3))
    body = fem.FemBody.build(mesh, *constant, lambda x: x[:, 0] < CORNER[0] + 1e-9)
    K = fem.stiffness(body, np.zeros_like(body.nodes))
    M = kron(BilinearForm(lambda u, v, w: DENSITY * u * v).assemble(body.basis), eye(3)).tocsr()
    inner = np.flatnonzero(~body.fixed.ravel())
    return float(np.sqrt(eigsh(K[inner][:, inner], 1, M[inner][:, inner], sigma=0)[0][0]) / (2 * np.pi))


def test_frequency_on_shapes_is_that_of_finite_elements_and_nearly_of_a_slender_beam(model):
    found = shapes(model, 0.0).ring(Physics(inertia=True))[0]
    slender = 3.5160 / (2 * np.pi) * np.sqrt(YOUNG * SIZE[2] ** 2 / 12 / DENSITY) / SIZE[0] ** 2
    assert found == pytest.approx(fem_frequency(), rel=0.04)  # the cloud's stiffness
    assert 0.85 * slender < found < slender  # shear makes a beam of three widths softer


def test_hung_mass_lowers_the_frequency_as_rayleigh_says(model):
    ritz = shapes(model, WEIGHT)
    free, mass = ritz.ring(Physics(inertia=True))[0], DENSITY * np.prod(SIZE)
    hung = ritz.ring(Physics(inertia=True, hung=0.5 * mass))[0]
    assert hung == pytest.approx(free / np.sqrt(1 + 0.5 / 0.2357), rel=0.04)
    string = ritz.ring(Physics(inertia=True, hung=0.5 * mass, on_string=True))[0]
    assert string == pytest.approx(hung, rel=0.03)  # the edge moves up and down, hardly along


def test_straightest_cloud_does_not_hand_its_swing_sideways():
    sideways = []
    for model in (straightest(200, range(6)), max((BeamModel.of(200, s) for s in range(6)), key=_sideways)):
        ritz, physics = shapes(model, WEIGHT), Physics(inertia=True, hung=0.05, mass_damping=1.0)
        w = ritz.markers(physics, NOW, np.arange(150) / 100)
        sideways.append(np.abs(w[:, :, 1]).max() / np.abs(w[:, :, 2]).max())
    assert sideways[0] < 0.1 and sideways[0] < 0.5 * sideways[1]


def test_damping_ratios_are_rayleighs_and_a_relaxing_solids(model):
    ritz = shapes(model, 0.0)
    w = 2 * np.pi * ritz.ring(Physics(inertia=True))[0]
    a, b, g, tau = 2.0, 1e-3, 0.1, 0.03
    ratio = ritz.ring(Physics(inertia=True, mass_damping=a, stiffness_damping=b))[1]
    assert ratio == pytest.approx(a / (2 * w) + b * w / 2, rel=1e-3)
    frequency, ratio = ritz.ring(Physics(inertia=True, branches=((g, tau),)))
    roots = np.roots([tau, 1, tau * w**2 * (1 + g), w**2])  # s^2 + w^2 (1 + g s tau / (1 + s tau)) = 0
    root = roots[roots.imag.argmax()]
    assert frequency == pytest.approx(root.imag / (2 * np.pi), rel=1e-3)
    assert ratio == pytest.approx(-root.real / abs(root), rel=2e-2)


@pytest.mark.parametrize(
    "physics",
    [
        Physics(inertia=True, stiffness_damping=2e-3, mass_damping=1.0, fittings=5e-3),
        Physics(inertia=True, stiffness_damping=2e-3, branches=((0.1, 0.2),)),
        Physics(inertia=True, stiffness_damping=2e-3, hung=0.03, on_string=True),
    ],
)
def test_small_motion_on_shapes_is_that_of_the_full_simulation(model, physics):
    """Half a second at a twentieth of the softness, where the tip sinks by 0.3 mm and nothing is nonlinear."""
    soft = 0.05
    ritz, elastic = shapes(model, 0.0, soft), beam_elastic(model, YOUNG / soft, POISSON)
    time, start, ties = np.arange(50) / 100 * np.sqrt(soft), Start(rise=0.01), tie_markers(model.cloud.x, TIP)
    full = full_markers(model, elastic, ritz, ties, physics, start, 0.0, time)
    off = full - ritz.markers(physics, start, time)
    size = np.abs(full).max()
    assert np.sqrt(np.mean(off[:, :, 2] ** 2)) < 0.02 * size  # steps of a quarter of a radian: 0.25 % of the frequency
    assert np.abs(off).max() < 0.06 * size
