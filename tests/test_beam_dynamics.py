"""The beam's motion diagnosed: closed forms of its parts, planted effects named and sized, silence, the real takes."""

import json

import fem
import numpy as np
import pytest
from scipy.sparse import eye, kron
from scipy.sparse.linalg import eigsh
from skfem import BilinearForm

from veo_ti.beam import CORNER, DENSITY, GRAVITY, SIZE, BeamModel, SettledTake
from veo_ti.beam import POISSON as BEAM_POISSON
from veo_ti.beam_dynamics.fitting import Data, effective_count
from veo_ti.beam_dynamics.full import full_markers
from veo_ti.beam_dynamics.heldout import interval
from veo_ti.beam_dynamics.hypotheses import QUASI_STATIC, Hypothesis
from veo_ti.beam_dynamics.judge import judge
from veo_ti.beam_dynamics.report import write_beam_diagnosis
from veo_ti.beam_dynamics.ritz import Physics, Ritz, Start, beam_elastic, creep, released
from veo_ti.beam_dynamics.run import compared, diagnose_beam
from veo_ti.beam_dynamics.setting import _sideways, straightest
from veo_ti.beam_dynamics.sinusoid import ring_down
from veo_ti.beam_dynamics.takes import Release, read_releases, release_of, split
from veo_ti.body import tie_markers
from veo_ti.cli import main
from veo_ti.markers import settle
from veo_ti.mocap import BeamTake, Markers

TIP = np.array([[0.0, 0.015, 0.036], [0.0, -0.006, 0.024], [0.0, 0.036, 0.006]])  # [m] markers
YOUNG, POISSON = 2.6e5, 0.3  # compressible: no locking, so finite elements and beam theory are oracles
WEIGHT = 0.51  # [N]
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


def shapes(model: BeamModel, load: float, softness: float = 1.0) -> Ritz:
    """About the settled pose of a beam `softness` times as soft as YOUNG."""
    young, x = YOUNG / softness, model.cloud.x
    force = model.force(load)[None]
    y = settle(model.cloud, force, fixed=model.fixed, young=young, poisson=POISSON, start=x[None])[0]
    return Ritz.about(model, beam_elastic(model, young, POISSON), y, tie_markers(x, TIP))


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


# Planted effects.

SOME = (
    QUASI_STATIC, Hypothesis(creep=True), Hypothesis(inertia=True, weight="mass"),
    *(Hypothesis(inertia=True, weight=weight, damping=(damping,)) for weight in ("force", "mass")
      for damping in ("stiffness", "mass")),
    Hypothesis(inertia=True, weight="mass", damping=("stiffness",), creep=True),
)  # fmt: skip
FREE_MASS = Hypothesis(inertia=True, weight="mass", fitted=True, damping=("stiffness",))


def planted(model: BeamModel, physics: dict[str, Physics], noise: float = 3e-5, seed: int = 0) -> Data:
    """Takes with and without a weight that move as told, seen through noise."""
    releases, ritz, random = [], {}, np.random.default_rng(seed)
    time = np.arange(-5, 151) / 100
    for name, load in (("gravity_V2_a", 0.0), ("load52_V2_a", WEIGHT)):
        ritz[name] = shapes(model, load)
        w = ritz[name].markers(physics[name], Start(latency=-0.004, rise=0.03), time)
        w = w + noise * random.normal(size=w.shape)
        still = SettledTake(
            name=name, load=load, held=TIP, displacement=-w[0], base=np.zeros((3, 3)), noise=noise, creep=0.0
        )
        releases.append(Release(settled=still, time=time, w=w))
    return Data(releases=tuple(releases), ritz=ritz, defect={})


def moving(**both) -> dict[str, Physics]:
    """The same physics in both takes, the hung mass in the second."""
    hung = both.pop("hung", 0.0)
    return {"gravity_V2_a": Physics(**both), "load52_V2_a": Physics(**both, hung=hung)}


def test_planted_added_mass_is_named_and_sized(model):
    data = planted(model, moving(inertia=True, stiffness_damping=2e-3, hung=WEIGHT / GRAVITY))
    fits = compared(data, (*SOME, FREE_MASS))
    found = judge(fits, fits[0].effective, 2e-4)
    assert found.kind == "named" and {e.name for e in found.named} == {"inertia", "added_mass", "damping"}
    damping = next(q for q in found.questions if q.cause == "damping")
    assert damping.answers[0][0] == "in proportion to stiffness"
    assert "in proportion to mass (air)" not in damping.open
    free = next(f for f in fits if f.hypothesis == FREE_MASS)
    names = [u.name for u in free.setup.unknowns]
    for name, truth in (("hung_mass", WEIGHT / GRAVITY), ("stiffness_damping", 2e-3)):
        sd = np.sqrt(free.covariance(free.effective)[names.index(name), names.index(name)])
        assert abs(free.theta[names.index(name)] - np.log(truth)) < 3 * sd < 0.1


def test_weight_that_is_a_force_alone_is_not_called_a_mass(model):
    data = planted(model, moving(inertia=True, mass_damping=4.0))
    fits = compared(data, SOME)
    found = judge(fits, fits[0].effective, 2e-4)
    assert {e.name for e in found.named} == {"inertia", "damping"}
    assert found.best.hypothesis.damping == ("mass",) and found.best.hypothesis.weight == "force"


def test_quasi_static_takes_are_not_misfit(model):
    data = planted(model, moving())
    fits = compared(data, SOME)
    found = judge(fits, fits[0].effective, 2e-4)
    assert found.kind == "no_misfit" and found.named == ()


def test_quasi_static_takes_from_file_to_page(tmp_path):
    """Takes that jump into the pose where the model settles at POISSON, through the door that the command uses."""
    model, random = BeamModel.of(200), np.random.default_rng(0)
    force = model.force(0.0)[None]
    y = settle(model.cloud, force, fixed=model.fixed, young=2.4e5, poisson=BEAM_POISSON, start=model.cloud.x[None])[0]
    drop = tie_markers(model.cloud.x, TIP).positions(y - model.cloud.x)
    time = np.arange(-5, 151) / 100
    w = np.where(time[:, None, None] < 0, -drop, 0) + 1e-5 * random.normal(size=(156, 3, 3))
    still = SettledTake(
        name="gravity_V2_a", load=0.0, held=TIP, displacement=drop, base=np.zeros((3, 3)), noise=1e-5, creep=0.0
    )
    d = diagnose_beam(
        {"gravity_V2_a": Release(settled=still, time=time, w=w)}, points=200, passes=0, hypotheses=SOME[:2]
    )
    found = write_beam_diagnosis(d, tmp_path)
    assert found["verdict"] == "no_misfit" and found["causes"] == [] and found["error_mm"] is None
    assert found["sentence"].startswith("Nothing is wrong that these takes could show")
    assert (tmp_path / "report.html").read_text().count("data:image/png;base64") == 3


def test_creep_without_mass_is_named_as_such(model):
    data = planted(model, moving(branches=((0.3, 0.4),)))
    fits = compared(data, SOME)
    found = judge(fits, fits[0].effective, 2e-4)
    assert found.kind == "named" and [e.name for e in found.named] == ["viscoelasticity"]


# Input.


def test_release_is_relative_to_the_settled_pose_and_to_the_base():
    p = np.repeat(np.arange(18.0).reshape(1, 6, 3) / 100, 400, axis=0)
    p[:50, :3, 2] += 7e-3
    p[50:60] += 1e-3  # the plate and all that is on it
    markers = Markers(time=np.arange(400) / 100, positions=p, residual=np.zeros((400, 6)), labels=tuple("abcdef"))
    take = BeamTake(markers=markers, release_frame=50, rest_frames=40, tip_load=0.0)
    found = release_of("gravity_V2_a", take)
    assert found.time[5] == 0 and found.time[-1] == pytest.approx(1.5)
    assert found.tip[:5] == pytest.approx(7e-3) and np.abs(found.w[5:]).max() < 1e-12
    with pytest.raises(ValueError, match=r"take must last 4.0 s after the release; got 3.49 s in gravity_V2_a"):
        release_of("gravity_V2_a", take, window=3.0)


def test_folder_without_takes_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"folder must hold beam_\*\.npz takes"):
        read_releases(tmp_path)


def test_command_line_sends_beam_takes_here(tmp_path, monkeypatch, capsys):
    (tmp_path / "beam_gravity_V2_a.npz").touch()
    found = {"sentence": "It rings."}
    monkeypatch.setattr("veo_ti.beam_dynamics.report.run_beam_diagnosis", lambda *_, progress: found)
    assert main(["diagnose", str(tmp_path), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out) == found and "It rings." in said.err
    for command, option in (("diagnose", "--modes=20"), ("diagnose", "--effort=9.5"), ("run", "--every=3")):
        assert main([command, str(tmp_path), "--out", str(tmp_path / "out"), option]) == 2
        name, value = option.split("=")
        assert f"{name} must be left out" in (said := capsys.readouterr().err) and said.endswith(f"got {value}\n")


# The real takes, on few points and hypotheses, by the shapes alone.

REAL = (
    QUASI_STATIC, Hypothesis(creep=True), Hypothesis(inertia=True),
    *(Hypothesis(inertia=True, weight=weight, damping=damping, creep=creep, fittings=fittings)
      for weight, fittings in (("force", False), ("string", False), ("string", True))
      for damping, creep in (((), True), (("stiffness", "mass"), False), (("stiffness", "mass"), True))),
    Hypothesis(inertia=True, weight="string", damping=("stiffness", "mass"), creep=True, fitted=True),
    Hypothesis(inertia=True, weight="string", damping=("stiffness", "mass"), creep=True, fitted=True, fittings=True),
)  # fmt: skip


def test_real_beam_lacks_inertia_with_damping_and_its_weight_is_a_mass(measured, tmp_path):
    releases = read_releases(measured("beam_mocap"))
    fitted, unseen = split(releases)
    assert [r.label for r in fitted] == ["gravity a", "52 g a"] and [r.label for r in unseen] == ["gravity b", "52 g b"]
    d = diagnose_beam(releases, points=200, passes=0, hypotheses=REAL)
    found = write_beam_diagnosis(d, tmp_path)
    assert found["verdict"] == "named"
    named = {c["name"]: c for c in found["causes"]}
    assert {"inertia", "added_mass", "damping", "viscoelasticity"} <= set(named)
    assert found["ranking"][0]["name"] == "inertia" and "inertia with damping" in found["sentence"]
    hung = found["hung_mass"]["fitted"]
    assert 0.04 < hung["low"] < hung["value"] < hung["high"] < 0.06  # 52 g by the scales
    assert found["fitted_error_mm"]["after"] < 0.15 * found["fitted_error_mm"]["before"]
    assert found["error_mm"]["after"] < 0.4 * found["error_mm"]["refit_only"] and d.gain.gained[1] > 0.5
    for name in ("gravity_V2_b", "load52_V2_b"):
        r = d.ringing[name]
        assert r.predicted.frequency == pytest.approx(r.measured.frequency, rel=0.02)
        assert r.predicted.ratio == pytest.approx(r.measured.ratio, rel=0.25)
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png;base64") == 5 and "://" not in page
    assert json.loads((tmp_path / "diagnosis.json").read_text()) == found
