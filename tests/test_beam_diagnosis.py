"""The beam's motion diagnosed: planted effects named and sized, silence, the real takes."""

import json

import numpy as np
import pytest
from beam_shapes import TIP, WEIGHT, shapes

from veo_ti.beam import GRAVITY, POISSON, BeamModel, SettledTake
from veo_ti.beam_dynamics.fitting import Data
from veo_ti.beam_dynamics.hypotheses import QUASI_STATIC, Hypothesis
from veo_ti.beam_dynamics.judge import judge
from veo_ti.beam_dynamics.report import write_beam_diagnosis
from veo_ti.beam_dynamics.ritz import Physics, Start
from veo_ti.beam_dynamics.run import compared, diagnose_beam
from veo_ti.beam_dynamics.takes import Release, read_releases, release_of, split
from veo_ti.body import tie_markers
from veo_ti.cli import main
from veo_ti.markers import settle
from veo_ti.mocap import BeamTake, Markers


@pytest.fixture(scope="module")
def model() -> BeamModel:
    return BeamModel.of(300)


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
    y = settle(model.cloud, force, fixed=model.fixed, young=2.4e5, poisson=POISSON, start=model.cloud.x[None])[0]
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
