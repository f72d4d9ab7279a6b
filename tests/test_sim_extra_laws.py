"""The laws that stand beside the base material, by hand against Taichi's reverse mode, textbooks and invariances."""

import clouds
import numpy as np
import pytest
from law_kernels import evaluate
from sim_cases import relative, taylor_rate

from sim import runtime
from sim.laws.extra import Fibre, GentStiffening, TensionCompression, VolumetricChange, YeohStiffening
from sim.laws.fields import MaterialFields
from sim.laws.history import green_strain
from sim.laws.neo_hookean import NeoHookean
from sim.laws.reference import LinearStress
from sim.laws.softening import SoftBelow

LAWS = {law.__name__: law for law in (
    YeohStiffening, GentStiffening, VolumetricChange, Fibre, TensionCompression, LinearStress, SoftBelow)}  # fmt: skip
COUNT = 40


def by_hand(law, F: np.ndarray, m: np.ndarray, W: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
    """psi (M,), P (M, 3, 3) and dP[W] (M, 3, 3) of the law's own functions."""
    runtime.ensure()
    F = np.ascontiguousarray(F)
    psi, P, dP = np.empty(len(F)), np.empty_like(F), np.empty_like(F)
    evaluate(law, F, np.zeros_like(F) if W is None else np.ascontiguousarray(W), np.ascontiguousarray(m), psi, P, dP)
    return psi, P, dP


def states(seed: int, spread: float = 0.3) -> np.ndarray:
    """Turned and sheared F (M, 3, 3) with J > 0, without any symmetry."""
    random = np.random.default_rng(seed)
    turns = np.array([clouds.rotation(a, tuple(random.normal(size=3))) for a in random.uniform(0, 3, 10 * COUNT)])
    F = turns @ (np.eye(3) + random.uniform(-spread, spread, (10 * COUNT, 3, 3)))
    return F[np.linalg.det(F) > 0.2][:COUNT]


def invariant(F: np.ndarray) -> np.ndarray:
    """I = I_c - 3 - 2 ln J, (...)."""
    return (F * F).sum((-1, -2)) - 3 - 2 * np.log(np.linalg.det(F))


def parameters(law, F: np.ndarray, seed: int = 0) -> np.ndarray:
    """Moduli over two decades and strengths of either size, (M, P); Gent's below locking, from nearly nothing up."""
    random = np.random.default_rng(seed)
    modulus, strength = 10 ** random.uniform(0, 2, len(F)), 10 ** random.uniform(-1, 1, len(F))
    if law is LinearStress:
        S = random.normal(size=F.shape) * 0.1 * modulus[:, None, None]
        return LinearStress.pack(modulus, S + S.swapaxes(1, 2))
    if law is GentStiffening:
        strength = 10 ** random.uniform(-3, -0.5, len(F)) / invariant(F)
    if law is SoftBelow:  # clearly below the largest load, and clearly above
        I1, above = invariant(F), np.arange(len(F)) % 4 == 0
        return np.stack([modulus, strength / 10, I1 * strength, I1 * np.where(above, 0.3, 3.0)], axis=1)
    m = np.stack([modulus, strength], axis=1)
    if law is not Fibre:
        return m
    axis, push = random.normal(size=(len(F), 3)), random.uniform(0, 1, (len(F), 1))
    return np.concatenate([m, axis / np.linalg.norm(axis, axis=1, keepdims=True), push], axis=1)


def energy_in_numpy(law, F: np.ndarray, m: np.ndarray) -> np.ndarray:
    """The formulas of the catalogue, (M,)."""
    I1, J, E = invariant(F), np.linalg.det(F), green_strain(F)
    first, second = m[:, 0], m[:, 1]
    if law is YeohStiffening:
        return first * second / 2 * I1**2
    if law is GentStiffening:
        return -first / (2 * second) * np.log(1 - second * I1) - first / 2 * I1
    if law is VolumetricChange:
        return second * first / 2 * (np.log(J) ** 2 - (J - 1) ** 2)
    if law is Fibre:
        s = (np.einsum("mij,mj->mi", F, m[:, 2:5]) ** 2).sum(axis=1) - 1
        return first * second / 2 * (np.maximum(s, 0) ** 2 + m[:, 5] * np.minimum(s, 0) ** 2)
    if law is TensionCompression:
        return first * second / 3 * np.trace(E, axis1=1, axis2=2) ** 3
    if law is SoftBelow:
        s, most = m[:, 2], m[:, 3]
        return -first * second / 2 * s * (np.log(np.cosh(most / s)) - np.log(np.cosh(np.maximum(most - I1, 0) / s)))
    S = np.stack([m[:, k] for k in (1, 6, 5, 6, 2, 4, 5, 4, 3)], axis=1).reshape(-1, 3, 3)
    return (first[:, None, None] * E**2 + S * E).sum((1, 2))


@pytest.fixture(params=LAWS)
def law(request):
    return LAWS[request.param]


@pytest.mark.parametrize("seed", [0, 1])
def test_psi_is_the_formula_of_the_catalogue(law, seed):
    F = states(seed)
    m = parameters(law, F, seed)
    # Gent's formula in numpy cancels to second order in x = g I > 1e-3.
    assert by_hand(law, F, m)[0] == pytest.approx(energy_in_numpy(law, F, m), rel=1e-8)


@pytest.mark.parametrize("seed", [0, 1])
def test_piola_is_reverse_mode_of_psi(law, seed):
    F = states(seed)
    m, fields = parameters(law, F, seed), MaterialFields.of(law)
    fields.load(F, m)
    # Gent's psi by the formula, beyond x = 0.02, has lost four digits that its slope has not.
    assert relative(fields.stress(), by_hand(law, F, m)[1]) < (1e-11 if law is GentStiffening else 1e-13)


@pytest.mark.parametrize("most", [0.3, 3.0])
def test_gents_tangent_is_reverse_mode_below_and_beyond_its_limit(most):
    F, W, fields = states(1), np.random.default_rng(9).normal(size=(COUNT, 3, 3)), MaterialFields.of(GentStiffening)
    m = np.stack([np.full(COUNT, 2.0), most / invariant(F)], axis=1)
    fields.load(F, m)
    _, P, dP = by_hand(GentStiffening, F, m, W)
    assert relative(fields.stress(), P) < 1e-11 and relative(fields.stress_change(W), dP) < 1e-13


@pytest.mark.parametrize("name", [name for name in LAWS if name != "LinearStress"])  # which compiles for 20 s
@pytest.mark.parametrize("seed", [0, 1])
def test_dpiola_is_reverse_mode_of_piola(name, seed):
    law, F, W = LAWS[name], states(seed), np.random.default_rng(seed + 9).normal(size=(COUNT, 3, 3))
    m, fields = parameters(law, F, seed), MaterialFields.of(law)
    fields.load(F, m)
    assert relative(fields.stress_change(W), by_hand(law, F, m, W)[2]) < 1e-13


def test_dpiola_is_symmetric(law):
    F, (V, W) = states(3), np.random.default_rng(3).normal(size=(2, COUNT, 3, 3))
    m = parameters(law, F)
    there, back = ((by_hand(law, F, m, a)[2] * b).sum((1, 2)) for a, b in ((V, W), (W, V)))
    assert np.abs(there - back).max() < 1e-13 * np.abs(there).max()


def test_dpiola_is_the_slope_of_piola(law):
    F, W = states(2, 0.2), 0.1 * np.random.default_rng(3).normal(size=(COUNT, 3, 3))
    m = parameters(law, F)
    assert taylor_rate(lambda x: by_hand(law, x, m)[1], by_hand(law, F, m, W)[2], F, W) > 1.9


def test_energy_and_stress_vanish_at_rotations(law):
    random = np.random.default_rng(4)
    R = np.array([clouds.rotation(a, tuple(random.normal(size=3))) for a in random.uniform(0, 3, COUNT)])
    m = parameters(law, states(4))
    if law is LinearStress:
        stress = by_hand(law, R, m)[1]
        m[:, 1:] = 0.0
        assert np.abs(stress).max() > 1.0  # it is there at rest
    for F in (R, np.tile(np.eye(3), (COUNT, 1, 1))):
        psi, P, _ = by_hand(law, F, m)
        assert np.abs(psi).max() < 1e-13 * m[:, 0].max()
        assert np.abs(P).max() < 1e-13 * m[:, 0].max()
    assert (psi == 0).all() and (P == 0).all()


def test_energy_does_not_see_a_rotation_and_the_stress_turns_along(law):
    F, W, R = states(5), np.random.default_rng(5).normal(size=(COUNT, 3, 3)), clouds.rotation(2.2)
    m = parameters(law, F)
    (psi, P, dP), turned = by_hand(law, F, m, W), by_hand(law, R @ F, m, R @ W)
    assert turned[0] == pytest.approx(psi, rel=1e-9, abs=1e-12)
    assert relative(turned[1], R @ P) < 1e-12
    assert relative(turned[2], R @ dP) < 1e-12


@pytest.mark.parametrize("name", [n for n in LAWS if n not in ("Fibre", "LinearStress")])
def test_isotropic_law_does_not_see_how_the_material_lies(name):
    F, R = states(6), clouds.rotation(1.1)
    m = parameters(LAWS[name], F)
    assert by_hand(LAWS[name], F @ R, m)[0] == pytest.approx(by_hand(LAWS[name], F, m)[0], rel=1e-9)


@pytest.mark.parametrize("name", ["YeohStiffening", "GentStiffening", "VolumetricChange", "SoftBelow"])
def test_energy_is_infinite_where_the_material_is_turned_inside_out(name):
    F = states(7)
    m = parameters(LAWS[name], F)
    F[:, 2] *= -1
    assert np.isposinf(by_hand(LAWS[name], F, m)[0]).all()


LOADING = {  # stretches at J = 1 and the nominal stress of W(I_1) over 2 dW/dI_1
    "uniaxial": (lambda s: (s, s**-0.5, s**-0.5), lambda s: s - s**-2),
    "equibiaxial": (lambda s: (s, s, s**-2), lambda s: s - s**-5),
    "pure shear": (lambda s: (s, np.ones_like(s), 1 / s), lambda s: s - s**-3),
}


def nominal_stress(law, stretches: tuple[np.ndarray, ...], m: np.ndarray) -> np.ndarray:
    """P_11 of base and law (M,) at J = 1 where a pressure that does no work clears the third face."""
    F = np.stack(stretches, axis=1)[:, :, None] * np.eye(3)
    P = by_hand(law, F, m)[1] + by_hand(NeoHookean, F, np.stack([m[:, 0], m[:, 0]], axis=1))[1]
    return P[:, 0, 0] - P[:, 2, 2] * stretches[2] / stretches[0]


@pytest.mark.parametrize("mode", LOADING)
def test_yeoh_of_an_incompressible_point_is_the_textbooks(mode):
    s, (stretches, shape) = np.linspace(0.5, 3.0, COUNT), LOADING[mode]
    mu, beta = 3.0, 0.7
    first = sum(v**2 for v in stretches(s)) - 3
    C1, C2 = mu / 2, mu * beta / 2
    got = nominal_stress(YeohStiffening, stretches(s), np.tile([mu, beta], (COUNT, 1)))
    assert got == pytest.approx(2 * shape(s) * (C1 + 2 * C2 * first), rel=1e-10)


@pytest.mark.parametrize("mode", LOADING)
def test_gent_of_an_incompressible_point_is_the_textbooks(mode):
    s, (stretches, shape) = np.linspace(0.7, 1.8, COUNT), LOADING[mode]
    mu, jm = 3.0, 12.0
    first = sum(v**2 for v in stretches(s)) - 3
    got = nominal_stress(GentStiffening, stretches(s), np.tile([mu, 1 / jm], (COUNT, 1)))
    assert got == pytest.approx(mu * jm / (jm - first) * shape(s), rel=1e-10)


def test_gent_becomes_neo_hooke_and_before_it_yeoh_as_its_limit_grows():
    F = states(8)
    base = by_hand(NeoHookean, F, np.tile([1.0, 0.0], (COUNT, 1)))[1]
    for jm in (1e4, 1e8, 1e12):
        psi, P, _ = by_hand(GentStiffening, F, np.tile([1.0, 1 / jm], (COUNT, 1)))
        yeoh = by_hand(YeohStiffening, F, np.tile([1.0, 0.5 / jm], (COUNT, 1)))
        assert relative(P, yeoh[1]) < 20 / jm + 1e-12
        assert psi == pytest.approx(yeoh[0], rel=20 / jm + 1e-12)
        assert relative(base + P, base) < 20 / jm
    assert not by_hand(GentStiffening, F, np.tile([1.0, 0.0], (COUNT, 1)))[1].any()


def test_volumetric_change_of_one_makes_the_volume_term_logarithmic():
    F, lam = states(9), 2.0
    pressure = by_hand(VolumetricChange, F, np.tile([lam, 1.0], (COUNT, 1)))[1]
    base = by_hand(NeoHookean, F, np.tile([0.0, lam], (COUNT, 1)))[1]
    J, H = np.linalg.det(F)[:, None, None], np.linalg.inv(F).swapaxes(1, 2)
    assert relative(base + pressure, lam * np.log(J) * H) < 1e-12


def test_gent_goes_on_along_its_tangent_beyond_nineteen_twentieths_of_its_limit():
    """Pulled further and further: the slope of the energy is the stress, and from there on that of a parabola in I."""
    s, mu, g = np.linspace(1.1, 3.0, 6000), 3.0, 0.5
    F = np.stack(LOADING["uniaxial"][0](s), axis=1)[:, :, None] * np.eye(3)
    psi, P, _ = by_hand(GentStiffening, F, np.tile([mu, g], (len(s), 1)))
    work = (0.5 * (P[1:] + P[:-1]) * np.diff(F, axis=0)).sum((1, 2))
    assert np.diff(psi) == pytest.approx(work, rel=1e-4)
    x = g * invariant(F)
    beyond = x > 0.95
    assert 0.2 < beyond.mean() < 0.8 and np.isfinite(psi).all()
    slope = np.gradient(psi[beyond], invariant(F)[beyond])[1:-1]
    assert slope == pytest.approx(mu / 2 * (19 + 400 * (x[beyond][1:-1] - 0.95)), rel=1e-4)


def test_a_material_is_soft_far_below_its_largest_load_and_as_ever_from_it_on():
    F, d = states(8), 0.7  # of the shear stress
    I1, mu = invariant(F), np.full(COUNT, 2.0)
    base = by_hand(NeoHookean, F, np.stack([mu, 0 * mu], axis=1))[1]
    for largest, lost in ((I1 + 1.0, d), (I1, 0.0), (0.5 * I1, 0.0), (0 * I1, 0.0)):
        m = np.stack([mu, 0 * mu + d, 0 * mu + 0.02, largest], axis=1)
        assert by_hand(SoftBelow, F, m)[1] == pytest.approx(-lost * base, abs=1e-12)
