"""The term that carries a law beside the base material: slopes, projection, frames, and what it does to equilibria."""

from dataclasses import replace

import clouds
import numpy as np
import pytest
import sim_cases
from sim_cases import relative, taylor_rate

from sim.cloud import RestCloud
from sim.direct import Layout
from sim.elastic import Elastic
from sim.energy import Energy
from sim.laws.extra import Fibre, GentStiffening, TensionCompression, VolumetricChange, YeohStiffening
from sim.laws.history import green_strain
from sim.laws.neo_hookean import NeoHookean
from sim.laws.reference import LinearStress
from sim.newton import NewtonOptions, equilibrate
from sim.sensitivity import responses
from sim.terms.loads import AppliedForce
from sim.terms.material import ExtraLaw

LARGEST = {  # of the parameters, each drawn from half of it up
    YeohStiffening: (2.0, 3.0), GentStiffening: (2.0, 0.3), VolumetricChange: (2.0, 1.0),
    TensionCompression: (2.0, 3.0), Fibre: (2.0, 3.0, 0.6, -0.7, 0.4, 1.0), NeoHookean: (2.0, 3.0),
    LinearStress: (1.0, 0.6, -0.4, 0.4, 0.2, -0.2, 0.4),
}  # fmt: skip
TERMS = {law.__name__: (law, False) for law in LARGEST} | {"stabilised": (NeoHookean, True)}


def body() -> Elastic:
    return sim_cases.elastic()


def extra(law, frames: int = 2, seed: int = 0, elastic: Elastic | None = None, **fields) -> ExtraLaw:
    """The law on a body with other parameters and weights at every point and frame."""
    elastic = elastic or body()
    random, N = np.random.default_rng(seed), elastic.cloud.count
    m = np.array(LARGEST[law]) * random.uniform(0.5, 1, (frames, N, len(law.parameters)))
    weight = random.uniform(0.5, 1.5, (frames, N))
    return ExtraLaw(**({"stencil": elastic.stencil, "law": law, "m": m, "weight": weight} | fields))


@pytest.fixture(params=TERMS)
def term(request) -> ExtraLaw:
    law, stabilised = TERMS[request.param]
    return extra(law, stabilised=stabilised)


def way(y: np.ndarray, seed: int = 5) -> np.ndarray:
    """A random change of y that is small beside the spacing of the points."""
    return np.random.default_rng(seed).normal(size=y.shape) * 0.02


def test_gradient_of_the_term_is_the_slope_of_its_energy(term):
    y = sim_cases.bent(term.stencil.cloud)
    p = way(y)
    slope = (term.gradient(y) * p).sum(axis=(1, 2))
    assert np.abs(slope).min() > 0
    assert taylor_rate(term.value, slope, y, p) > 1.9


def test_product_of_the_term_is_the_slope_of_its_gradient_and_symmetric(term):
    y = sim_cases.bent(term.stencil.cloud)
    p, q = way(y), way(y, 6)
    tangent = term.tangent(y)
    linear = relative(term.gradient(y + p) - term.gradient(y), tangent.product(p)) < 1e-12  # then nothing remains
    assert linear or taylor_rate(term.gradient, tangent.product(p), y, p) > 1.9
    there, back = ((tangent.product(a) * b).sum(axis=(1, 2)) for a, b in ((p, q), (q, p)))
    assert np.abs(there - back).max() < 1e-13 * np.linalg.norm(tangent.product(p)) * np.linalg.norm(q)


@pytest.fixture(scope="module")
def small() -> Elastic:
    cloud = RestCloud.build(clouds.block((5, 3, 3), (0.4, 0.2, 0.2), jitter=0.2))
    return Elastic.neo_hookean(cloud, sim_cases.material(cloud))


def dense(tangent, frames: int, count: int) -> np.ndarray:
    """The Hessian of every frame by products with unit vectors, (T, 3N, 3N)."""
    units = np.eye(3 * count).reshape(-1, 1, count, 3)
    return np.stack([tangent.product(np.tile(u, (frames, 1, 1))).reshape(frames, -1) for u in units], axis=2)


@pytest.mark.parametrize("name", ["YeohStiffening", "TensionCompression", "stabilised"])
def test_assembled_term_is_its_product_exact_or_projected(name, small):
    law, stabilised = TERMS[name]
    term = extra(law, 3, elastic=small, stabilised=stabilised)
    y = sim_cases.bent(small.cloud, 3)
    tangent = term.tangent(y, np.array([False, True, True]))
    H, layout = dense(tangent, 3, small.cloud.count), Layout.of(small)
    for t, blocks in enumerate(tangent.assembled(slice(0, 3))):
        assert relative(layout.matrix(blocks).toarray(), H[t]) < 1e-13
    assert (tangent.assembled(slice(1, 3)) == tangent.assembled(slice(0, 3))[1:]).all()
    own = np.einsum("tiaib->tiab", H.reshape(3, small.cloud.count, 3, small.cloud.count, 3))
    assert relative(tangent.blocks, own) < 1e-13


def test_projected_term_has_no_negative_eigenvalue_where_the_exact_one_has(small):
    term = extra(TensionCompression, elastic=small)
    y = 0.7 * sim_cases.bent(small.cloud)  # tr E < 0: soft against more of the same
    tangents = (term.tangent(y, np.array([False, clamp])) for clamp in (False, True))
    exact, projected = (np.linalg.eigvalsh(dense(tangent, 2, small.cloud.count)) for tangent in tangents)
    assert exact[1, 0] < -1e-3 * exact[1, -1]
    assert projected[1, 0] > -1e-12 * projected[1, -1]
    assert (exact[0] == projected[0]).all()


def test_projection_of_a_convex_state_is_the_exact_tangent(small):
    term = extra(YeohStiffening, elastic=small)
    y = np.stack([1.3 * small.cloud.x, 1.2 * small.cloud.x])  # swollen: B is a multiple of 1
    assert relative(term.tangent(y, np.ones(2, bool)).product(way(y)), term.tangent(y).product(way(y))) < 1e-12


@pytest.mark.parametrize("law", [law for law in LARGEST if law is not NeoHookean])
def test_null_adds_exactly_nothing(law):
    term = extra(law)
    some = (np.arange(term.m.shape[2]) != 1) & (law is not LinearStress)
    null, y = replace(term, m=term.m * some), sim_cases.bent(term.stencil.cloud)
    assert not null.value(y).any()
    assert not null.gradient(y).any()
    assert not null.tangent(y).product(way(y)).any()


def test_frames_do_not_see_each_other(term):
    y = sim_cases.bent(term.stencil.cloud)
    for t, index in enumerate(np.arange(2)[:, None]):
        alone = term.frames(index)
        assert alone.value(y[index]) == term.value(y)[t]
        assert (alone.gradient(y[index])[0] == term.gradient(y)[t]).all()
        assert (alone.tangent(y[index]).product(way(y)[index])[0] == term.tangent(y).product(way(y))[t]).all()


def test_one_row_holds_for_every_frame():
    y, one = sim_cases.bent(body().cloud, 3), extra(YeohStiffening, 1)
    many = replace(one, m=np.repeat(one.m, 3, axis=0), weight=None)
    flat = replace(one, m=one.m[0], weight=None)
    assert (many.gradient(y) == flat.gradient(y)).all()
    assert (flat.frames(np.array([1])).gradient(y[1:2]) == flat.gradient(y)[1:2]).all()
    weighted = replace(many, weight=np.arange(3.0)[:, None] * np.ones(body().cloud.count))
    assert weighted.value(y) == pytest.approx(flat.value(y) * np.arange(3))


def test_instant_between_two_frames_has_their_mean():
    term, y = extra(YeohStiffening, 3, stabilised=True), sim_cases.bent(body().cloud, 1)
    half = replace(term, weight=None).between(1, 0.5)
    assert half.m == pytest.approx(term.m[1:].mean(axis=0, keepdims=True))
    assert np.isfinite(half.gradient(y)).all()


def test_base_law_with_a_weight_scales_the_whole_elastic_energy():
    elastic, y = body(), sim_cases.bent(body().cloud)
    weight = np.array([[0.3], [-0.2]])
    drift = extra(NeoHookean, m=elastic.m, weight=weight * np.ones(elastic.cloud.count), stabilised=True)
    p = way(y)
    assert drift.value(y) == pytest.approx(weight[:, 0] * elastic.value(y)[0], rel=1e-12)
    assert relative(drift.gradient(y), weight[:, None] * elastic.gradient(y)) < 1e-12
    assert relative(drift.tangent(y).product(p), weight[:, None] * elastic.tangent(y).product(p)) < 1e-12


@pytest.mark.parametrize("weight", [0.0, -1.0])
def test_energy_is_infinite_outside_the_law_whatever_the_weight(weight):
    y = sim_cases.at_rest(body().cloud, 2)
    y[1, :, 0] *= -1
    energy = extra(YeohStiffening, weight=np.full((1, body().cloud.count), weight)).value(y)
    assert energy[0] == 0
    assert np.isposinf(energy[1])


FAULTS = [
    ({"m": np.ones((7, 2))}, "m must have shape"),
    ({"m": np.full((160, 2), np.nan)}, "m must be finite"),
    ({"weight": np.ones((3, 160))}, "m and weight must have one row or equally many"),
    ({"weight": np.ones(160)}, "weight must have shape"),
]


@pytest.mark.parametrize("fields, message", FAULTS)
def test_wrong_arrays_are_named(fields, message):
    with pytest.raises(ValueError, match=message):
        extra(YeohStiffening, **fields)


def test_another_number_of_frames_is_refused():
    with pytest.raises(ValueError, match="y must have as many frames"):
        extra(YeohStiffening, 2).gradient(sim_cases.at_rest(body().cloud, 3))


LOAD = np.array([[0.03, 0.0, -0.015], [0.0, 0.0, 0.0], [0.0, 0.02, -0.02]])  # [N] on a body of about 1 Pa


def bar(*terms: ExtraLaw) -> Energy:
    energy = sim_cases.clamped(body(), LOAD)
    return replace(energy, terms=(*energy.terms, *terms))


def solved(energy: Energy, **options) -> np.ndarray:
    rest = sim_cases.at_rest(body().cloud, len(LOAD))
    found = equilibrate(energy, rest, options=NewtonOptions(**options)).require_converged()
    assert found.iterations.max() < 20
    return found.y


def uniform(law, *values: float) -> ExtraLaw:
    """The same law everywhere."""
    return extra(law, m=np.tile(values, (body().cloud.count, 1)), weight=None)


@pytest.mark.parametrize("law, strength", [(YeohStiffening, 50.0), (GentStiffening, 40.0), (Fibre, 3.0)])
def test_stiffened_bar_moves_less(law, strength):
    axis = (1.0, 0.0, 0.0, 1.0) if law is Fibre else ()
    plain, stiff = solved(bar()), solved(bar(uniform(law, 2.0, strength, *axis)))
    moved = [np.linalg.norm(y - body().cloud.x, axis=2).max(axis=1) for y in (plain, stiff)]
    assert moved[0][0] > 0.1  # [m] on a bar of one
    assert (moved[1][[0, 2]] < 0.9 * moved[0][[0, 2]]).all()
    assert moved[1][1] == 0


@pytest.mark.parametrize("linear", ["two-level", "direct"])
def test_solvers_agree_on_a_bar_that_stiffens(linear):
    energy = bar(uniform(YeohStiffening, 2.0, 50.0))
    assert relative(solved(energy, linear=linear, tolerance=1e-10), solved(energy, tolerance=1e-10)) < 1e-9


def test_drift_is_a_load_that_shrinks():
    weight = np.array([[0.0], [0.5], [1.0]]) * np.ones(body().cloud.count)
    drift = replace(uniform(NeoHookean, 1.0, 1.0), m=body().m, weight=weight, stabilised=True)
    weaker = sim_cases.clamped(body(), LOAD / (1 + weight[:, :1]))
    assert relative(solved(bar(drift), tolerance=1e-10), solved(weaker, tolerance=1e-10)) < 1e-9


def test_free_bar_takes_the_strain_that_its_material_would_rather_have():
    A = np.diag([0.2, -0.1, 0.05])
    y = solved(bar(uniform(LinearStress, *LinearStress.pack(5e3, -1e4 * A))))[1]  # no load; the base resists by 1e-4
    far = body().cloud.deformation_gradient(y[None])[0, body().cloud.x[:, 0] > 0.5]
    assert green_strain(far) == pytest.approx(np.tile(A, (len(far), 1, 1)), abs=0.03)


def test_response_of_a_stiffened_bar_is_the_slope_of_its_equilibrium():
    energy = bar(uniform(YeohStiffening, 2.0, 50.0))
    force = np.random.default_rng(0).normal(size=(len(LOAD), body().cloud.count, 3)) * 1e-4
    y = solved(energy, tolerance=1e-11)

    def moved(h: float) -> np.ndarray:
        more = AppliedForce(force=h * force)
        return solved(replace(energy, terms=(*energy.terms, more)), tolerance=1e-11)

    got = np.stack([dy[0] for dy in responses(energy, y, lambda index: force[index, None])])
    assert relative((moved(0.1) - moved(-0.1)) / 0.2, got) < 1e-4
