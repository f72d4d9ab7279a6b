"""The elastic energy: patch test, invariances, Taylor rates at states without symmetry, and reproducibility."""

import clouds
import numpy as np
import pytest
import sim_cases

from sim.cloud import CloudOptions, RestCloud
from sim.direct import Layout
from sim.elastic import Elastic, ElasticTangent
from sim.lame import Lame
from sim.laws.history import green_strain
from sim.terms.material import ExtraLaw, Held

F0 = np.array([[1.25, 0.3, -0.1], [-0.2, 0.9, 0.2], [0.1, -0.15, 1.1]])
MODES = ("consistent", "paper")


@pytest.fixture(params=MODES)
def elastic(request) -> Elastic:
    return sim_cases.elastic("jittered", request.param)


def direction(y: np.ndarray, seed: int = 5) -> np.ndarray:
    """A random change of y that is small beside the spacing of the points."""
    return np.random.default_rng(seed).normal(size=y.shape) * 0.02


def piola(F: np.ndarray, mu: float, lam: float) -> np.ndarray:
    """P = mu (F - F^-T) + lam (J - 1) J F^-T."""
    J, H = np.linalg.det(F), np.linalg.inv(F).T
    return mu * (F - H) + lam * (J - 1) * J * H


def homogeneous(kind: str, mode: str = "consistent") -> Elastic:
    return Elastic.neo_hookean(sim_cases.cloud(kind, mode), Lame(mu=1.3, lam=2.1))


@pytest.mark.parametrize("kind", ["jittered", "regular", "poisson"])
def test_patch_of_uniform_strain_pulls_on_its_surface_only(kind):
    elastic = homogeneous(kind)
    y = (elastic.cloud.x @ F0.T)[None]
    traction = elastic.cloud.area @ piola(F0, 1.3, 2.1).T
    assert np.abs(elastic.gradient(y)[0] - traction).max() < 1e-5 * np.abs(traction).max()


def test_plain_scheme_fails_the_patch_test():
    elastic = homogeneous("poisson", "paper")
    y = (elastic.cloud.x @ F0.T)[None]
    traction = elastic.cloud.area @ piola(F0, 1.3, 2.1).T
    assert np.abs(elastic.gradient(y)[0] - traction).max() > 0.1 * np.abs(traction).max()


def test_energy_of_uniform_strain_is_its_closed_form(elastic):
    mu, lam, J = elastic.m[:, 0], elastic.m[:, 1], np.linalg.det(F0)
    psi = mu / 2 * ((F0**2).sum() - 3) - mu * np.log(J) + lam / 2 * (J - 1) ** 2
    energy, smallest = elastic.value((elastic.cloud.x @ F0.T)[None])
    assert energy == pytest.approx((elastic.cloud.volume * psi).sum(), rel=1e-10)
    assert smallest == pytest.approx(J, rel=1e-8)


def test_rest_state_has_no_energy_and_no_force(elastic):
    y = sim_cases.at_rest(elastic.cloud, 1)
    assert elastic.value(y)[0] == pytest.approx(0, abs=1e-15)
    assert np.abs(elastic.gradient(y)).max() < 1e-14


def test_energy_is_invariant_under_rigid_motion_and_forces_turn_along(elastic):
    R, y = clouds.rotation(2.0), sim_cases.bent(elastic.cloud)
    moved = y @ R.T + [3.0, -1.0, 2.0]
    assert elastic.value(moved)[0] == pytest.approx(elastic.value(y)[0], rel=1e-11)
    assert sim_cases.relative(elastic.gradient(moved), elastic.gradient(y) @ R.T) < 1e-10


def test_elastic_forces_and_torques_cancel(elastic):
    y = sim_cases.bent(elastic.cloud)
    force = elastic.gradient(y)
    size = np.abs(force).sum()
    assert np.abs(force.sum(axis=1)).max() < 1e-12 * size
    assert np.abs(np.cross(y, force).sum(axis=1)).max() < 1e-11 * size * np.abs(y).max()


def test_stencils_bent_alike_spring_back_as_the_whole():
    """Each stencil on its own, summed, is the sparse matrix of the energy times the displacement."""
    elastic = sim_cases.elastic("jittered")
    stencil, mu = elastic.stencil, elastic.m[:, 0]
    y = sim_cases.bent(elastic.cloud)
    u, none = y - elastic.cloud.x, np.zeros((*y.shape, 3))
    whole = stencil.divergence(u, none, stencil.stabilisation(mu)[None])
    got = stencil.spring_back(stencil.bent(u), mu)
    assert np.abs(got - whole).max() < 1e-12 * np.abs(whole).max()
    affine = stencil.bent(elastic.cloud.x[None] @ F0.T)
    assert np.abs(affine).max() < 1e-12 * np.abs(elastic.cloud.x).max()


def test_stabilisation_sees_no_affine_motion_and_every_other():
    elastic = sim_cases.elastic()
    without = RestCloud.build(elastic.cloud.x, options=CloudOptions(stabilisation=0.0))
    plain = Elastic.neo_hookean(without, sim_cases.material(without))
    affine, bent = (elastic.cloud.x @ F0.T)[None], sim_cases.bent(elastic.cloud)
    assert elastic.value(affine)[0] == pytest.approx(plain.value(affine)[0], rel=1e-9)
    assert (elastic.value(bent)[0] > 1.0001 * plain.value(bent)[0]).all()


def test_energy_is_infinite_where_a_point_is_inside_out(elastic):
    y = sim_cases.at_rest(elastic.cloud, 2)
    y[1, :, 0] *= -1
    energy, smallest = elastic.value(y)
    assert np.isfinite(energy[0])
    assert np.isposinf(energy[1])
    assert smallest == pytest.approx([1.0, -1.0])


@pytest.mark.parametrize("seed", [0, 1])
def test_gradient_is_the_slope_of_the_energy(elastic, seed):
    y = sim_cases.bent(elastic.cloud, seed=seed)
    way = direction(y, seed)
    slope = (elastic.gradient(y) * way).sum(axis=(1, 2))
    assert sim_cases.taylor_rate(lambda z: elastic.value(z)[0], slope, y, way) > 1.9


@pytest.mark.parametrize("seed", [0, 1])
def test_hessian_product_is_the_slope_of_the_gradient(elastic, seed):
    y = sim_cases.bent(elastic.cloud, seed=seed)
    way = direction(y, seed)
    assert sim_cases.taylor_rate(elastic.gradient, elastic.tangent(y).product(way), y, way) > 1.9


def dense(tangent: ElasticTangent) -> np.ndarray:
    """The Hessian of every frame by products with unit vectors, (T, 3N, 3N)."""
    T, N = tangent.F.shape[:2]
    columns = [tangent.product(np.tile(unit.reshape(1, N, 3), (T, 1, 1))).reshape(T, -1) for unit in np.eye(3 * N)]
    return np.stack(columns, axis=2)


@pytest.fixture(scope="module")
def small() -> Elastic:
    cloud = RestCloud.build(clouds.block((5, 3, 3), (0.4, 0.2, 0.2), jitter=0.2))
    return Elastic.neo_hookean(cloud, sim_cases.material(cloud))


@pytest.mark.parametrize("project", [(False, False), (True, True), (False, True)])
def test_assembled_hessian_is_the_product_and_symmetric(small, project):
    tangent = small.tangent(sim_cases.bent(small.cloud), np.array(project))
    H, blocks = dense(tangent), tangent.assembled(slice(0, 2))
    for t in range(2):
        assert sim_cases.relative(Layout.of(small).matrix(blocks[t]).toarray(), H[t]) < 1e-13
    assert sim_cases.relative(H, H.swapaxes(1, 2)) < 1e-13


def test_slices_of_frames_assemble_the_same(small):
    tangent = small.tangent(sim_cases.bent(small.cloud, 3), np.array([False, True, True]))
    every = tangent.assembled(slice(0, 3))
    assert (tangent.assembled(slice(1, 3)) == every[1:]).all()
    assert (tangent.assembled(slice(1, 2)) == every[1:2]).all()


def test_projected_hessian_has_no_negative_eigenvalue_where_the_exact_one_has(small):
    y = sim_cases.bent(small.cloud) * [0.5, 1.0, 1.0]
    exact, projected = (np.linalg.eigvalsh(dense(small.tangent(y, np.full(2, p)))) for p in (False, True))
    assert (exact.min(axis=1) < -1e-3 * exact.max(axis=1)).all()
    assert (projected.min(axis=1) > -1e-12 * projected.max(axis=1)).all()


def test_projected_hessian_is_the_exact_one_at_rest(small):
    y = sim_cases.at_rest(small.cloud, 1)
    exact, projected = (small.tangent(y, np.full(1, p)).assembled(slice(0, 1)) for p in (False, True))
    assert sim_cases.relative(projected, exact) < 1e-12


@pytest.mark.parametrize("column", [0, 1])
def test_parameter_gradient_is_what_a_change_of_one_parameter_does_to_the_force(elastic, column):
    y = sim_cases.bent(elastic.cloud)
    w, change = direction(y, 1), np.zeros_like(elastic.m)
    change[:, column] = np.random.default_rng(2).normal(size=len(change))
    # Linear in the parameters: the difference is exact whatever its step.
    ahead, behind = (elastic.with_parameters(elastic.m + s * 0.1 * change).gradient(y) for s in (1, -1))
    difference = (w * (ahead - behind)).sum() / 0.2
    assert (elastic.parameter_gradient(y, w) * change).sum() == pytest.approx(difference, rel=1e-9)


def test_parameter_gradient_acts_point_by_point(elastic):
    y = sim_cases.bent(elastic.cloud)
    w, got = direction(y, 1), elastic.parameter_gradient(y, direction(y, 1))
    for point in (0, 77):
        change = np.zeros_like(elastic.m)
        change[point] = elastic.m[point]
        power = (w * elastic.with_parameters(change).gradient(y)).sum()
        assert (got * change).sum() == pytest.approx(power, rel=1e-9)


def test_frames_do_not_see_each_other(elastic):
    y = sim_cases.bent(elastic.cloud, 3)
    way, all_frames = direction(y), elastic.tangent(y)
    for t in range(3):
        alone = elastic.tangent(y[t : t + 1])
        assert elastic.value(y[t : t + 1])[0] == elastic.value(y)[0][t]
        assert (elastic.gradient(y[t : t + 1])[0] == elastic.gradient(y)[t]).all()
        assert (alone.product(way[t : t + 1])[0] == all_frames.product(way)[t]).all()


def test_parameter_gradient_adds_up_over_frames(elastic):
    y = sim_cases.bent(elastic.cloud, 3)
    w = direction(y)
    parts = sum(elastic.parameter_gradient(y[t : t + 1], w[t : t + 1]) for t in range(3))
    assert sim_cases.relative(elastic.parameter_gradient(y, w), parts) < 1e-13


def test_two_runs_agree_to_the_bit(elastic):
    y = sim_cases.bent(elastic.cloud, 4)
    way = direction(y)
    again = Elastic.neo_hookean(RestCloud.build(elastic.cloud.x, options=elastic.cloud.options), sim_cases.material(
        elastic.cloud))
    assert (again.value(y)[0] == elastic.value(y)[0]).all()
    assert (again.gradient(y) == elastic.gradient(y)).all()
    assert (again.tangent(y).product(way) == elastic.tangent(y).product(way)).all()
    assert (again.parameter_gradient(y, way) == elastic.parameter_gradient(y, way)).all()


@pytest.mark.parametrize("what", ["elastic", "a law", "a stabilised law", "what stencils hold"])
def test_what_each_stencil_does_adds_up_to_the_gradient(what):
    elastic, random = sim_cases.elastic(), np.random.default_rng(0)
    stencil, y, N = elastic.stencil, sim_cases.bent(elastic.cloud), elastic.cloud.count
    terms = {"elastic": elastic, "what stencils hold": Held.of(stencil, random.normal(size=elastic.each(y).shape))}
    for name, stabilised in (("a law", False), ("a stabilised law", True)):
        own = {"weight": random.uniform(0.5, 1.5, (2, N)), "stabilised": stabilised}
        terms[name] = ExtraLaw(stencil=stencil, law=elastic.law, m=elastic.m, **own)
    whole = np.concatenate([stencil.gathered(each, np.ones((1, N))) for each in terms[what].each(y)])
    assert sim_cases.relative(whole, terms[what].gradient(y)) < 1e-12


def test_changes_of_the_strain_and_the_pull_of_a_stress_are_each_others_transpose():
    """`sum size V S : sym F^T dp/dx = p . f`, and the first is the slope of the Green strain."""
    elastic, random = sim_cases.elastic(), np.random.default_rng(0)
    stencil, y, h = elastic.stencil, sim_cases.bent(elastic.cloud, 1), 1e-6
    F = elastic.cloud.deformation_gradient(y)[0]
    p, size = random.normal(size=(3, *y[0].shape)), random.uniform(1, 2, elastic.cloud.count)
    S = random.normal(size=(3, *F.shape))
    S = S + S.swapaxes(2, 3)
    dE = stencil.strained(p, F)
    work = np.einsum("n,knab,knab->k", size * elastic.cloud.volume, S, dE)
    np.testing.assert_allclose((p * stencil.pull(S, F, size)).sum(axis=(1, 2)), work, rtol=1e-10)
    ahead, behind = (green_strain(elastic.cloud.deformation_gradient(y + s * h * p)) for s in (1, -1))
    assert sim_cases.relative(dE, (ahead - behind) / (2 * h)) < 1e-6
