"""The Neo-Hookean law by hand against Taichi's reverse mode, numpy, and the invariances it must have."""

import clouds
import numpy as np
import pytest
from law_kernels import evaluate
from sim_cases import relative, taylor_rate

from sim import runtime
from sim.laws.fields import MaterialFields
from sim.laws.neo_hookean import NeoHookean

COUNT = 50


def by_hand(F: np.ndarray, W: np.ndarray, m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """psi (M,), P (M, 3, 3) and dP[W] (M, 3, 3) of the law's own functions."""
    runtime.ensure()
    psi, P, dP = np.empty(len(F)), np.empty_like(F), np.empty_like(F)
    evaluate(NeoHookean, F, W, m, psi, P, dP)
    return psi, P, dP


def psi_of_paper(F: np.ndarray, m: np.ndarray) -> np.ndarray:
    """mu/2 (I_c - 3) - mu log J + lam/2 (J - 1)^2 in numpy, (M,); complex F gives complex-step derivatives."""
    J = np.linalg.det(F)
    return m[:, 0] / 2 * ((F * F).sum((1, 2)) - 3) - m[:, 0] * np.log(J) + m[:, 1] / 2 * (J - 1) ** 2


def random_points(seed: int, spread: float = 0.4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Turned, sheared F with J > 0, directions W and parameters m over four decades."""
    random = np.random.default_rng(seed)
    turns = np.array([clouds.rotation(a, tuple(random.normal(size=3))) for a in random.uniform(0, 3, 20 * COUNT)])
    F = turns @ (np.eye(3) + random.uniform(-spread, spread, (20 * COUNT, 3, 3)))
    F = F[np.linalg.det(F) > 0.1][:COUNT]
    return F, random.normal(size=F.shape), 10 ** random.uniform(-1, 3, (COUNT, 2))


@pytest.fixture(scope="module")
def fields():
    fields = MaterialFields(NeoHookean, 4)  # smaller than what is loaded, so that it must grow
    yield fields


@pytest.mark.parametrize("seed", [0, 1])
def test_psi_is_the_papers_formula(seed):
    F, W, m = random_points(seed)
    assert by_hand(F, W, m)[0] == pytest.approx(psi_of_paper(F, m), rel=1e-12)


@pytest.mark.parametrize("seed", [0, 1])
def test_piola_is_the_complex_step_of_the_papers_formula(seed):
    F, W, m = random_points(seed)
    power = np.imag(psi_of_paper(F + 1e-30j * W, m)) / 1e-30
    assert (by_hand(F, W, m)[1] * W).sum((1, 2)) == pytest.approx(power, rel=1e-10)


@pytest.mark.parametrize("seed", [0, 1])
def test_piola_is_reverse_mode_of_psi(seed, fields):
    F, W, m = random_points(seed)
    fields.load(F, m)
    assert relative(fields.stress(), by_hand(F, W, m)[1]) < 1e-14


@pytest.mark.parametrize("seed", [0, 1])
def test_dpiola_is_reverse_mode_of_piola(seed, fields):
    F, W, m = random_points(seed)
    fields.load(F, m)
    assert relative(fields.stress_change(W), by_hand(F, W, m)[2]) < 1e-14


def test_dpiola_is_the_slope_of_piola():
    F, W, m = random_points(2, spread=0.2)
    assert taylor_rate(lambda x: by_hand(x, W, m)[1], by_hand(F, W, m)[2], F, W) > 1.9


def test_parameter_gradient_is_reverse_mode_and_the_law_is_linear_in_its_parameters(fields):
    F, W, m = random_points(3)
    fields.load(F, m)
    got = fields.parameter_gradient(W)
    units = [by_hand(F, W, np.tile(unit, (COUNT, 1)))[1] for unit in np.eye(2)]
    assert relative(got, np.stack([(P * W).sum((1, 2)) for P in units], axis=1)) < 1e-14
    assert (got * m).sum(axis=1) == pytest.approx((by_hand(F, W, m)[1] * W).sum((1, 2)), rel=1e-12)


def test_fields_grow_with_what_is_loaded_and_keep_no_trace_of_it(fields):
    F, W, m = random_points(4)
    fields.load(np.tile(F, (9, 1, 1)), np.tile(m, (9, 1)))
    large = fields.stress_change(np.tile(W, (9, 1, 1)))
    assert (large.reshape(9, COUNT, 3, 3) == large[:COUNT]).all()
    fields.load(F, m)
    assert (fields.stress_change(W) == large[:COUNT]).all()


def test_fields_are_shared_by_all_users_of_a_law():
    assert MaterialFields.of(NeoHookean) is MaterialFields.of(NeoHookean)


def test_rest_state_has_no_energy_and_no_stress():
    _, W, m = random_points(5)
    psi, P, _ = by_hand(np.tile(np.eye(3), (COUNT, 1, 1)), W, m)
    assert (psi == 0).all()
    assert (P == 0).all()


def test_tangent_at_rest_is_linear_elasticity():
    _, W, m = random_points(6)
    mu, lam = m[:, :1, None], m[:, 1:, None]
    trace = np.trace(W, axis1=1, axis2=2)[:, None, None]
    hooke = mu * (W + W.swapaxes(1, 2)) + lam * trace * np.eye(3)
    assert relative(by_hand(np.tile(np.eye(3), (COUNT, 1, 1)), W, m)[2], hooke) < 1e-14


@pytest.mark.parametrize("angle", [0.7, 3.0])
def test_energy_is_rotation_invariant_and_stress_turns_along(angle):
    F, W, m = random_points(7)
    R = clouds.rotation(angle)
    psi, P, dP = by_hand(F, W, m)
    left, right = by_hand(R @ F, R @ W, m), by_hand(F @ R, W @ R, m)
    assert left[0] == pytest.approx(psi, rel=1e-11)
    assert right[0] == pytest.approx(psi, rel=1e-11)  # isotropy
    assert relative(left[1], R @ P) < 1e-13
    assert relative(right[1], P @ R) < 1e-13
    assert relative(left[2], R @ dP) < 1e-13


@pytest.mark.parametrize("J", [0.0, -0.3])
def test_energy_is_infinite_where_the_material_is_turned_inside_out(J):
    F, W, m = random_points(8)
    F[:, 2] *= (J / np.linalg.det(F))[:, None]
    if J == 0:
        F[:, 2] = 0.0  # to the last bit
    assert np.isposinf(by_hand(F, W, m)[0]).all()


def dense_tangent(F: np.ndarray, m: np.ndarray) -> np.ndarray:
    """d2psi/dF2 (M, 9, 9), one column per unit direction."""
    units = np.eye(9).reshape(9, 1, 3, 3).repeat(len(F), axis=1)
    return np.stack([by_hand(F, W, m)[2].reshape(-1, 9) for W in units.copy()], axis=2)


def squeezed() -> tuple[np.ndarray, np.ndarray]:
    """States with equal singular values, strong compression and shear, where the tangent is indefinite."""
    F, _, m = random_points(9)
    F[:10] = np.eye(3)
    F[10:20] = 0.6 * F[10:20] / np.cbrt(np.linalg.det(F[10:20]))[:, None, None]
    F[20:30] = clouds.rotation(1.0) @ np.diag([0.5, 0.5, 1.7])
    return F, m


def test_projection_clamps_the_eigenvalues_that_numpy_finds():
    F, m = squeezed()
    values, vectors = np.linalg.eigh(dense_tangent(F, m))
    assert (values.min(axis=1) < -1e-3 * values.max(axis=1)).sum() > 10  # there is something to clamp
    clamped = np.einsum("mik,mk,mjk->mij", vectors, np.maximum(values, 0), vectors)
    size = values.max(axis=1)[:, None, None]
    assert np.abs((NeoHookean.projected(F, m) - clamped) / size).max() < 1e-12


def test_projection_is_positive_semidefinite():
    F, m = squeezed()
    values = np.linalg.eigvalsh(NeoHookean.projected(F, m))
    assert (values.min(axis=1) > -1e-13 * values.max(axis=1)).all()


def test_projection_leaves_a_convex_state_alone():
    F, _, m = random_points(10, spread=0.02)
    F *= 1.3 / np.cbrt(np.linalg.det(F))[:, None, None]
    exact = dense_tangent(F, m)
    convex = np.linalg.eigvalsh(exact).min(axis=1) > 0
    assert convex.sum() > 10
    assert relative(NeoHookean.projected(F, m)[convex], exact[convex]) < 1e-13
