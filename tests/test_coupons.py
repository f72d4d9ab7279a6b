"""Coupons: closed forms against finite differences and the simulator's laws, planted causes, real rubber, bad input."""

import json

import coupon_trials
import numpy as np
import pytest
from scipy.optimize import brentq
from test_sim_extra_laws import by_hand

from sim.laws.extra import GentStiffening, YeohStiffening
from sim.laws.neo_hookean import NeoHookean
from veo_ti.cli import main
from veo_ti.coupons.curves import NAMES, Coupon, Curve, free_of_pressure, principal
from veo_ti.coupons.data import Data, noise_of, pieces_of
from veo_ti.coupons.dogbone import examine_dogbone, read_dogbone
from veo_ti.coupons.fit import fit
from veo_ti.coupons.laws import Reach, laws
from veo_ti.coupons.machine import machine
from veo_ti.coupons.model import Model
from veo_ti.coupons.predict import mooney_rivlin, r_squared, relative, rms, usual_mooney_rivlin
from veo_ti.coupons.reading import read_coupon, treloar
from veo_ti.coupons.run import diagnose_coupon
from veo_ti.coupons.search import search

REACH = Reach(modes=tuple(NAMES), invariant=8.0, stretch=3.0, stress=1e6)
LAWS = {law.form: law for law in laws(REACH)}
STRETCH = np.array([0.7, 0.9, 1.05, 1.4, 2.0, 2.6])
MU = 3e5


def some(law) -> np.ndarray:
    """Parameters away from the null, inside the law's reach."""
    return 0.4 * law.width * np.where(np.arange(len(law.width)) % 2, -1, 1)


def energy(form: str, s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """W / mu of a form's addition to the Neo-Hookean law, from the literature; s (n, 3) of any volume."""
    I1, I2 = (s**2).sum(axis=1), (s[:, 0] * s[:, 1]) ** 2 + (s[:, 0] * s[:, 2]) ** 2 + (s[:, 1] * s[:, 2]) ** 2
    I = I1 - 3  # noqa: E741
    if form == "yeoh":
        return t[0] / 2 * I**2
    if form == "yeoh_cubic":
        return t[0] / 2 * I**2 + t[1] / 2 * I**3
    if form == "gent":
        return -np.log(1 - t[0] * I) / (2 * t[0]) - I / 2
    if form == "knowles":
        b, n = np.exp(t[1]), 1 - t[0]
        return ((1 + b * I) ** n - 1) / (2 * b * n) - I / 2
    if form == "ogden":
        alpha = 2 + t[0]
        return 2 / alpha**2 * ((s**alpha).sum(axis=1) - 3) - I / 2
    if form == "mooney_rivlin":
        return t[0] / 2 * (I2 - 3)
    if form == "carroll":
        return t[0] * np.sqrt(3) * (np.sqrt(I2) - np.sqrt(3))
    if form == "gent_thomas":
        return 3 * t[0] / 2 * np.log(I2 / 3)
    x, rest = t[0] * I1 / 3, t[0]  # eight_chain: integral of (3 - x)/(1 - x) over I1
    first = (I1 - 6 / t[0] * np.log(1 - x)) / 2 * (1 - rest) / (3 - rest)
    return first - I1 / 2


@pytest.mark.parametrize("form", LAWS)
def test_slope_is_the_derivative_of_the_energy(form):
    law, t = LAWS[form], some(LAWS[form])
    s, h = principal("UT", STRETCH) * np.array([1.0, 1.1, 0.95]), 1e-6
    shifts = np.eye(3) * h
    numeric = np.stack([(energy(form, s + d, t) - energy(form, s - d, t)) / (2 * h) for d in shifts], axis=1)
    np.testing.assert_allclose(law.slope(s, t), numeric, rtol=2e-7, atol=1e-8)


@pytest.mark.parametrize("mode", NAMES)
@pytest.mark.parametrize("form", LAWS)
def test_stress_is_the_derivative_of_the_energy_along_the_test(form, mode):
    law, t, h = LAWS[form], some(LAWS[form]), 1e-6
    pulled = 2 if mode == "ET" else 1  # directions that do work

    def W(stretch):
        s = principal(mode, stretch)
        return MU * (0.5 * ((s**2).sum(axis=1) - 3) + energy(form, s, t))

    numeric = (W(STRETCH + h) - W(STRETCH - h)) / (2 * h) / pulled
    np.testing.assert_allclose(Model(causes=(law,)).stress(mode, STRETCH, MU, t), numeric, rtol=1e-6, atol=1e-2)


@pytest.mark.parametrize("cause", [*laws(REACH), *machine(REACH)], ids=lambda c: c.form)
def test_every_cause_vanishes_at_its_null(cause):
    null, plain = np.zeros(len(cause.parameters)), np.zeros(0)
    for mode in NAMES:
        with_cause = Model(causes=(cause,)).stress(mode, STRETCH, MU, null)
        np.testing.assert_allclose(with_cause, Model().stress(mode, STRETCH, MU, plain), rtol=1e-12)


def test_textbook_stresses_agree():
    for effect, form, t in (
        ("yeoh", "yeoh", 0.02),
        ("mooney_rivlin", "mooney_rivlin", 0.17),
        ("gent_thomas", "gent_thomas", 0.8),
    ):
        for mode in NAMES:
            mine = Model(causes=(LAWS[form],)).stress(mode, STRETCH, MU, np.array([t]))
            np.testing.assert_allclose(mine, coupon_trials.plant(effect, mode, STRETCH, MU, 0.5), rtol=1e-12)


@pytest.mark.parametrize(("mode", "modulus"), [("UT", 3.0), ("ET", 6.0), ("PS", 4.0)])
def test_small_strain_moduli_are_those_of_an_incompressible_solid(mode, modulus):
    e = 1e-5
    for law in (None, LAWS["yeoh"], LAWS["gent"], LAWS["ogden"], LAWS["mooney_rivlin"], LAWS["gent_thomas"]):
        model, t = (Model(), np.zeros(0)) if law is None else (Model(causes=(law,)), some(law))
        mu = MU * (1 + t[0]) if law is not None and law.name == "second_invariant" and law.form != "ogden" else MU
        assert model.stress(mode, np.array([1 + e]), MU, t)[0] / (modulus * mu * e) == pytest.approx(1, rel=5e-5)


@pytest.mark.parametrize(("form", "law"), [("yeoh", YeohStiffening), ("gent", GentStiffening)])
@pytest.mark.parametrize("mode", NAMES)
def test_stress_is_that_of_the_simulators_law(form, law, mode):
    s, t = principal(mode, STRETCH), some(LAWS[form])
    F = s[:, :, None] * np.eye(3)
    m = np.tile([MU, t[0]], (len(F), 1))
    P = by_hand(NeoHookean, F, np.tile([MU, 0.0], (len(F), 1)))[1] + by_hand(law, F, m)[1]
    theirs = free_of_pressure(s, np.einsum("nii->ni", P))
    np.testing.assert_allclose(Model(causes=(LAWS[form],)).stress(mode, STRETCH, MU, t), theirs, rtol=1e-9)


@pytest.mark.parametrize("mode", NAMES)
def test_simulators_solid_tends_to_it_as_volume_hardens(mode):
    t, errors = some(LAWS["yeoh"]), []
    exact = Model(causes=(LAWS["yeoh"],)).stress(mode, np.array([1.8]), MU, t)[0]
    for lam in (1e2 * MU, 1e4 * MU):

        def state(free, lam=lam):
            s = np.array([[1.8, free, free] if mode == "UT" else [1.8, 1.8 if mode == "ET" else 1.0, free]])
            F = s[:, :, None] * np.eye(3)
            m = np.array([[MU, lam]]), np.array([[MU, t[0]]])
            return np.einsum("nii->ni", by_hand(NeoHookean, F, m[0])[1] + by_hand(YeohStiffening, F, m[1])[1])[0]

        free = brentq(lambda x: state(x)[2], 0.1, 1.2, xtol=1e-14)
        errors.append(abs(state(free)[0] / exact - 1))
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(100, rel=0.2)  # linear in mu / lam


def test_series_spring_shares_the_stretch():
    cause = next(c for c in machine(REACH) if c.name == "machine_compliance")
    give, own = 4e-7, np.linspace(1.05, 2.5, 9)
    P = Model().stress("UT", own, MU, np.zeros(0))
    shown = Model(causes=(cause,)).stress("UT", own + give * P, MU, np.array([give]))
    np.testing.assert_allclose(shown, P, rtol=3e-6)  # a table of 1500 rows


def noisy(causes=(), theta=(), *, modes=("UT", "ET", "PS"), noise=0.01, seed=0, top=3.5) -> list[Curve]:
    random, l = np.random.default_rng(seed), np.linspace(1.05, top, 25)  # noqa: E741
    model = Model(causes=tuple(causes))
    return [
        Curve.of(m, l, model.stress(m, l, MU, np.array(theta)) * (1 + noise * random.normal(size=25))) for m in modes
    ]


def test_order_of_points_does_not_matter():
    curve = treloar().curves[0]
    turned = Curve.of("UT", curve.stretch[::-1], curve.stress[::-1])
    np.testing.assert_array_equal(turned.stretch, curve.stretch)
    assert search([turned], most=1).best.gained == search([curve], most=1).best.gained


def test_noise_is_found_from_what_neighbours_do_not_share():
    found = [noise_of(c)[0] for seed in range(20) for c in noisy([LAWS["gent"]], [0.03], noise=0.02, seed=seed)]
    assert np.median(found) == pytest.approx(0.02, rel=0.15)


def test_pieces_hold_every_point_once():
    curve = treloar().curves[0]
    data = Data.of([curve])
    np.testing.assert_allclose(data.mean.sum(axis=1), 1)
    assert data.mean.shape == (len(np.unique(pieces_of(curve))), len(curve))


def test_intervals_hold_the_planted_parameters():
    law, inside = LAWS["yeoh"], []
    for seed in range(30):
        found = fit(Model(causes=(law,)), Data.of(noisy([law], [0.05], seed=seed)))
        inside.append(abs(found.theta[0] - 0.05) < 1.96 * found.sd[0])
    assert np.mean(inside) >= 0.9  # wider than noise alone would make them: 1.5 % is never excluded


def test_scale_of_stress_is_only_a_scale():
    curves = noisy([LAWS["gent"]], [0.03])
    soft = [Curve.of(c.mode, c.stretch, c.stress / 1000) for c in curves]
    one, other = (fit(Model(causes=(LAWS["gent"],)), Data.of(c)) for c in (curves, soft))
    assert other.mu * 1000 == pytest.approx(one.mu, rel=1e-4)
    assert other.theta[0] == pytest.approx(one.theta[0], rel=1e-4)


@pytest.mark.parametrize("seed", range(2))
def test_silent_where_nothing_is_planted(seed):
    assert search(noisy(seed=seed, noise=0.02, modes=("UT", "PS")), most=1).kind == "no_misfit"


@pytest.mark.parametrize(("form", "theta"), [("yeoh", 0.06), ("gent", 0.03), ("gent_thomas", 0.7)])
def test_planted_cause_is_named(form, theta):
    found = search(noisy([LAWS[form]], [theta], modes=("UT", "PS")))
    assert (found.kind, found.named) == ("named", (LAWS[form].name,))


@pytest.mark.parametrize("effect", ["fung", "mooney_rivlin", "strain_offset", "machine_compliance", "grip_slip"])
def test_hidden_effect_is_never_called_by_another_name(effect):
    planted, _, kind, named, told, _ = coupon_trials.trial(5, effect, modes=("UT",))
    result = coupon_trials.outcome(planted, kind, named, told)
    assert result != "wrong"
    assert result != "missed"


def test_one_mode_leaves_softening_and_the_second_invariant_open_and_asks_for_another():
    found = diagnose_coupon(treloar(), modes=["UT"])
    assert found.found.named == ("strain_stiffening",)
    beside = {name for c in (found.found.best, *found.found.rivals) for name in c.names} - {"strain_stiffening"}
    assert beside == {"second_invariant", "strain_softening"}
    assert found.experiment.mode == "ET"
    assert found.experiment.separation > 10
    again = max(e.separation for e in found.library if e.mode == "UT")
    assert again < found.experiment.separation / 3  # more of the same mode would tell little


def test_treloar_uniaxial_predicts_the_other_modes():
    found = diagnose_coupon(treloar(), modes=["UT"])
    errors = {c.mode: {k: rms(relative(c, p)) for k, p in found.folds[0].predicted(c).items()} for c in found.held}
    for mode in ("ET", "PS"):
        assert errors[mode]["after"] < 0.6 * errors[mode]["refit_only"]
        assert errors[mode]["after"] < errors[mode]["hold_residual"]
    assert found.gain.confirmed
    assert found.gain.coverage > 0.8


def test_following_the_advice_settles_it():
    curves = {c.mode: c for c in treloar().curves}
    gentle = curves["ET"].part(curves["ET"].stretch <= 2.1)
    found = search([curves["UT"], gentle])
    assert (found.named, found.rivals) == (("strain_stiffening", "second_invariant"), ())


def test_usual_mooney_rivlin_fit_to_uniaxial_data_fails_on_the_equibiaxial_test():
    curves = {c.mode: c for c in treloar().curves}
    C = usual_mooney_rivlin([curves["UT"]])
    assert r_squared(curves["UT"], mooney_rivlin(curves["UT"], *C)) == pytest.approx(0.8935, abs=1e-4)
    assert r_squared(curves["ET"], mooney_rivlin(curves["ET"], *C)) == pytest.approx(-5748.6, abs=0.1)


def test_embedded_table_is_the_measured_one(measured):
    for own, theirs in zip(treloar().curves, read_coupon(measured("rubber/Treloar_1944.npz")).curves, strict=True):
        assert own.mode == theirs.mode
        np.testing.assert_allclose(own.stress, theirs.stress, rtol=1e-6)


def test_kawabata_needs_more_than_the_first_invariant(measured):
    found = search(read_coupon(measured("rubber/Kawabata_1981.npz")).curves)
    assert "second_invariant" in found.named


def test_ecoflex_stiffens_and_predicts_itself_further(measured):
    found = diagnose_coupon(read_coupon(measured("silicone_tensile/Ecoflex_00-30.csv")), up_to=8.0)
    assert found.found.named == ("strain_stiffening",)
    assert found.gain.errors["after"] < 0.5 * found.gain.errors["refit_only"]


def test_dogbone_tells_contraction_and_no_stress(measured):
    found = examine_dogbone(read_dogbone(measured("dogbone_3ddic/dogbone_points.npz")))
    assert 0.40 < found.contraction.low < found.contraction.high < 0.45
    assert [state for state, _ in found.odd] == [12]
    assert found.slips == ()


def strip(tmp_path, slip=0.0):
    """A made strip of Poisson's ratio 0.5, whose grip slips by `slip` [mm] from state 10 on."""
    random, grip = np.random.default_rng(0), np.arange(20.0)
    x = np.stack([random.uniform(-25, 25, 300), random.uniform(-2, 2, 300), np.zeros(300)], axis=1)
    l = 1 + (grip - slip * (grip >= 10)) / 72  # noqa: E741
    y = x[None] * np.stack([l, l**-0.5, l**-0.5], axis=1)[:, None] + 0.003 * random.normal(size=(20, 300, 3))
    path = tmp_path / "strip.npz"
    np.savez(path, points_aligned_mm=y, valid=np.ones(300, bool), grip_displacement_mm=grip)
    return path


def test_made_strip_contracts_by_half_and_its_slip_is_seen(tmp_path):
    still, slipped = (examine_dogbone(read_dogbone(strip(tmp_path, slip))) for slip in (0.0, 0.3))
    assert still.contraction.value == pytest.approx(0.5, abs=0.01)
    assert still.slips == ()
    state, size = max(slipped.slips, key=lambda s: s[1])
    assert (state, 1e3 * size) == (10, pytest.approx(0.3, abs=0.05))


def test_command_leaves_numbers_pictures_and_a_page(tmp_path, capsys):
    assert main(["coupon", "treloar", "--out", str(tmp_path), "--fit", "ut"]) == 0
    facts = json.loads((tmp_path / "coupon.json").read_text())
    assert json.loads(capsys.readouterr().out)["verdict"] == facts["verdict"] == "named"
    assert facts["separating_experiment"]["mode"] == "ET"
    assert facts["folds"][0]["held_out"][0]["usual_mooney_rivlin_r_squared"] == pytest.approx(-5748.6, abs=0.1)
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png") == 5
    assert "://" not in page.split("</style>")[1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mode,stretch,stress_MPa\nUT,1.1,0.1\n", "UT curve must have at least 4 points off rest; got 1"),
        ("mode,stretch,stress_MPa\nXX,1.1,0.1\n", "mode must be one of UT, ET, PS; got XX"),
        ("mode,stretch,stress_MPa\nUT,1.1,soft\n", "stress_MPa must be a number in every row; got 'soft' in row 2"),
        (
            "mode,stretch,stress_MPa\nUT,1.1,-1\nUT,1.2,-2\nUT,1.3,-3\nUT,1.4,-4\n",
            "UT stress must be positive in tension and negative in compression; got the opposite or zeros",
        ),
        ("a,b\n1,2\n", "columns must hold mode, stretch, stress_MPa or eng_strain, eng_stress_MPa; got a, b"),
        (
            "eng_strain,eng_stress_MPa\n0.1,1\n0.3,2\n0.2,1.5\n",
            "eng_strain must grow throughout: unloading is not read; got a step back in row 4",
        ),
        ("", "columns must hold mode, stretch, stress_MPa or eng_strain, eng_stress_MPa; got nothing"),
    ],
)  # fmt: skip
def test_bad_file_is_one_sentence(tmp_path, text, message):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(ValueError) as error:
        read_coupon(path)
    assert str(error.value) == message


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"modes": ["BI"]}, "fit must name modes of the coupon, UT, ET, PS; got BI"),
        ({"up_to": 0.5}, "up-to must be a stretch above 1; got 0.5"),
        ({"up_to": 1.13}, "the fitted part of UT must have at least 4 points; got 2"),
    ],
)
def test_bad_division_is_one_sentence(options, message):
    with pytest.raises(ValueError) as error:
        diagnose_coupon(treloar(), **options)
    assert str(error.value) == message


def test_coupon_without_curves_is_refused():
    with pytest.raises(ValueError, match="coupon must hold at least one curve; got none"):
        Coupon(name="", curves=())
