"""What people see of a diagnosis: numbers that are numbers, a page that stands alone, pictures that show something."""

import json
import re
from dataclasses import replace

import imageio.v3 as iio
import numpy as np
import pytest

from sim.basis import FitOptions
from sim.lame import Lame
from veo_ti import cli, stage
from veo_ti.body import sample_box
from veo_ti.diagnosis.causes import CATALOGUE
from veo_ti.diagnosis.experiment import Experiment
from veo_ti.diagnosis.facts import facts
from veo_ti.diagnosis.missing import missing_force
from veo_ti.diagnosis.pictures import missing_force_picture
from veo_ti.diagnosis.report import write_diagnosis
from veo_ti.diagnosis.run import diagnose
from veo_ti.diagnosis.sentence import amount, sentence, size
from veo_ti.diagnosis.verdict import Verdict
from veo_ti.identification import IdentifyOptions, identify
from veo_ti.object import VirtualElasticObject
from veo_ti.observation import Observation
from veo_ti.view import save_picture

HIDDEN = np.array([0.0, 0.03, 0.02])  # N, at the middle of one side
NOISE = 1e-4  # m
OPTIONS = IdentifyOptions(fit=FitOptions(modes=6, ratio_modes=0, iterations=4))
FEW = ("hidden_force", "force_direction", "camera_scale", "gravity_direction", "strain_stiffening")
CAUSES = tuple(cause for cause in CATALOGUE if cause.name in FEW)
KEYS = {
    "limits", "finished", "steps",
    "verdict", "sentence", "causes", "ambiguous_with", "separating_experiment", "ranking", "noise_mm",
    "noise_correlation", "outlier_share", "misfit_z", "misfit_z_after", "rounds", "error_mm", "seconds",
}  # fmt: skip


def observation(hidden: np.ndarray, frames: int = 10) -> Observation:
    """A box of 150 points, fixed at one end, pushed at the other; `hidden` [N] is not in the record."""
    body, t = sample_box([0.1, 0.04, 0.04], 150), np.linspace(0, 1, frames)
    mu = 2e3 * np.exp(0.2 * np.sin(body.x[:, 0] / 0.03))
    box = VirtualElasticObject(
        x=body.x, lame=Lame(mu=mu, lam=4 * mu), volume=body.volume, surface=body.surface, fixed=body.x[:, 0] == 0
    )
    load = np.sin(np.pi * t)[:, None] * [0, 0, -0.06] + np.sin(2 * np.pi * t)[:, None] * [0, 0.05, 0]
    push = box.push_at([0.1, 0.02, 0.04], load, 0.012)
    pull = box.push_at([0.06, 0.0, 0.02], (t > 0)[:, None] * hidden, 0.012)
    y = box.simulate(push, pull).y + NOISE * np.random.default_rng(0).standard_normal((frames, 150, 3))
    y[0] = box.x
    return Observation(
        points=y, forces=push.force, time=t, fixed=box.fixed, surface=box.surface, volume=box.volume, name="a <box>"
    )


@pytest.fixture(scope="module")
def pulled():
    """With a hidden force; gravity cannot be tested, since nobody weighed the box."""
    return diagnose(identify(observation(HIDDEN), options=OPTIONS), CAUSES, second=False)


@pytest.fixture(scope="module")
def sound():
    """With nothing hidden."""
    return diagnose(identify(observation(0 * HIDDEN), options=OPTIONS), CAUSES)


@pytest.fixture(scope="module")
def folder(pulled, tmp_path_factory):
    path = tmp_path_factory.mktemp("diagnosis")
    write_diagnosis(pulled, path)
    return path


def under(diagnosis, kind: str, causes: tuple = (), **changes):
    """The same diagnosis with another verdict."""
    first = replace(diagnosis.rounds[0], verdict=Verdict(kind=kind, causes=causes, sentence=""))
    return replace(diagnosis, rounds=(first, *diagnosis.rounds[1:]), final=diagnosis.baseline, **changes)


def plain(value: object) -> bool:
    """Whether a value and everything in it has a plain Python type."""
    if isinstance(value, dict):
        return all(type(k) is str and plain(v) for k, v in value.items())
    return all(map(plain, value)) if type(value) is list else type(value) in {str, float, int, bool, type(None)}


def test_facts_are_complete_and_plain(pulled, sound):
    for diagnosis in (pulled, sound):
        found = facts(diagnosis)
        assert found.keys() == KEYS and plain(found)
        assert sorted(c["name"] for c in found["ranking"]) == sorted(FEW)
        assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_hidden_force_is_named_with_place_size_and_gain(pulled):
    found = facts(pulled)
    (cause,), error = found["causes"], found["error_mm"]
    assert (found["verdict"], cause["name"], found["ambiguous_with"]) == ("named", "hidden_force", [])
    assert re.fullmatch(r"around \(-?\d+, -?\d+, -?\d+\) mm", cause["place"]) and cause["place"] in found["sentence"]
    assert [p["unit"] for p in cause["parameters"]] == ["N"] * 3 + ["m"] * 4  # the force, its spot and its radius
    assert all(p["low"] < p["value"] < p["high"] for p in cause["parameters"][:3])  # a spot stays on a flat face
    assert cause["log_evidence_gain"] > 6 and 0.5 < cause["explained"] <= 1
    assert found["misfit_z_after"] < found["misfit_z"]
    assert all(p["low"] <= p["value"] <= p["high"] for p in cause["parameters"])
    assert error["gained"]["value"] == pytest.approx(error["refit_only"] - error["after"])
    assert f"{error['after']:.2g} mm" in found["sentence"]


def test_untestable_cause_says_why(pulled):
    (gravity,) = [c for c in facts(pulled)["ranking"] if c["name"] == "gravity_direction"]
    assert (gravity["testable"], gravity["log_bayes"], "weigh" in gravity["why_not"]) == (False, None, True)


def test_scored_cause_says_what_would_have_been_seen(sound):
    (scale,) = [c for c in facts(sound)["ranking"] if c["name"] == "camera_scale"]
    assert scale["testable"] and 0 < scale["keep"] <= 1
    assert 1e-5 < scale["parameters"][0]["smallest_detectable"] < 0.1  # 0.1 mm of noise on 20 mm of motion


def test_a_score_promises_what_the_refit_then_explains(pulled):
    found = facts(pulled)
    promised = {c["name"]: c["promised"] for c in found["ranking"]}
    for refitted in found["rounds"][0]["refitted"]:
        assert promised[refitted["name"]] == pytest.approx(refitted["explained"], abs=0.1)
    assert promised["strain_stiffening"] < 0.3 < promised["hidden_force"] and promised["gravity_direction"] is None


def test_nothing_wrong_is_said_with_the_noise(sound):
    found = facts(sound)
    assert (found["verdict"], found["causes"]) == ("no_misfit", [])
    assert found["sentence"].startswith("Nothing is wrong") and f"{found['noise_mm']:.2g} mm" in found["sentence"]
    assert found["noise_mm"] == pytest.approx(1e3 * NOISE, rel=0.2)


def test_stray_positions_are_mentioned(sound):
    noisy = replace(sound, noise=replace(sound.noise, outlier_share=0.012))
    assert "1.2% are stray" in facts(noisy)["sentence"] and "stray" not in facts(sound)["sentence"]


def test_ambiguous_verdict_names_all_that_it_may_be(pulled):
    one = under(pulled, "ambiguous", both := pulled.rounds[0].candidates[:2])
    found, twice = facts(one), facts(replace(one, rounds=one.rounds * 2))
    assert [c["name"] for c in found["causes"]] == [c.name for c in both] and len(both) == 2
    assert [c["round"] for c in twice["causes"]] == [0, 0, 1, 1]
    assert found["ambiguous_with"] == twice["ambiguous_with"] == [both[1].name]
    assert "cannot tell the cause: " in found["sentence"] and "; besides: " in twice["sentence"]
    assert all(twice["sentence"].count(c.name.replace("_", " ")) == 2 for c in both)


def test_what_stands_beside_a_named_cause_may_be_ambiguous(pulled):
    both, asked = pulled.rounds[0].candidates[:2], Experiment(description="a slow push", now=1.0, then=9.0)
    beside = replace(pulled.rounds[0], verdict=Verdict(kind="ambiguous", causes=both, sentence=""), experiment=asked)
    found = facts(replace(pulled, rounds=(pulled.rounds[0], beside)))
    first, second = (c.name.replace("_", " ") for c in both)
    assert [c["name"] for c in found["causes"]] == [c.name for c in pulled.named] and found["ambiguous_with"] == []
    assert [r["separating_experiment"] for r in found["rounds"]] == [None, found["separating_experiment"]]
    assert f"besides: {first} or {second}, which this measurement cannot tell apart" in found["sentence"]
    assert found["sentence"].endswith(f"To tell {first} from {second}, measure a slow push.")


def test_unexplained_verdict_names_the_nearest_but_no_cause(pulled, tmp_path):
    stranger = under(pulled, "unexplained", gain=None)
    found = write_diagnosis(stranger, tmp_path)
    assert found["causes"] == [] and found["error_mm"] is None
    assert "no known cause explains" in found["sentence"] and "nearest is" in found["sentence"]
    assert not (tmp_path / "gain.png").exists() and (tmp_path / "missing_force.png").exists()


def test_gain_that_was_not_measured_or_may_be_chance_is_said(pulled):
    assert "was not measured" in sentence(replace(pulled, gain=None))
    assert "may be chance" in sentence(replace(pulled, gain=replace(pulled.gain, gained_mm=(0.1, -0.1, 0.3))))


def test_sizes_are_read_in_everyday_units():
    read = amount(0.012, "m"), amount(np.pi, "rad"), amount(2.0, "N"), amount(0.3, "-")
    assert read == ("12 mm", "180 degrees", "2 N", "0.3")
    by_name = {cause.name: cause for cause in CATALOGUE}
    assert size(by_name["force_offset"], np.array([3e-3, 0, 4e-3]), (-np.ones(3), np.ones(3))) == "shift 5 mm"
    drift, theta = by_name["stiffness_drift"], np.array([0.02])
    assert size(drift, theta, drift.interval(theta, np.array([0.001]))) == "drift 0.02 ± 0.00196 1/session"


def test_page_stands_alone_and_begins_with_the_sentence(pulled, folder):
    page = (folder / "diagnosis.html").read_text(encoding="utf-8")
    assert page.index(sentence(pulled)) < page.index("<h2>")
    assert not re.search(r"https?://|@import|url\(|<script|<box>", page)
    assert page.count("data:image/png;base64,") == 5
    headings = re.findall("<h2>(.*?)</h2>", page)
    assert {"What is wrong", "Evidence for and against", "The missing force", "What the extension gained",
            "What could not be tested", "What would have been seen"} <= set(headings)  # fmt: skip


def test_folder_holds_the_facts_and_pictures_that_show_something(pulled, folder):
    assert json.loads((folder / "diagnosis.json").read_text()) == facts(pulled)
    pictures = sorted(folder.glob("*.png"))
    assert [p.stem for p in pictures] == ["gain", "missing_force", "ranking", "residual", "residual_over_time"]
    for path in pictures:
        picture = iio.imread(path)[..., :3].astype(int)
        assert (abs(picture - picture[0, 0]).max(axis=-1) > 30).mean() > 0.01  # not blank


def test_page_of_a_sound_simulation_has_no_missing_force(sound, tmp_path):
    write_diagnosis(sound, tmp_path)
    assert not (tmp_path / "missing_force.png").exists()
    assert "The missing force" not in (tmp_path / "diagnosis.html").read_text(encoding="utf-8")


def test_missing_force_points_where_the_hidden_one_does_and_vanishes_without_one(pulled, sound):
    totals = []
    for diagnosis in (pulled, sound):
        scene, noise = diagnosis.baseline.scene, diagnosis.noise
        variance = noise.sigma**2 * noise.correlation
        found = missing_force(diagnosis.identification, scene, diagnosis.baseline.shown, variance, frame=9)  # no load
        totals.append(found.total[1:])  # across the box: along it, a little strain takes a large force
    along = totals[0] @ HIDDEN[1:] / np.linalg.norm(HIDDEN)
    assert along > 0.8 * np.linalg.norm(totals[0])
    assert 0.4 < along / np.linalg.norm(HIDDEN) < 2.5  # a smaller force further out bends the box as much
    assert np.linalg.norm(totals[1]) < 0.1 * np.linalg.norm(HIDDEN)


def test_arrows_are_drawn_with_and_without_opengl(pulled, tmp_path, monkeypatch):
    blue = []
    for renderer in ("as this machine can", "in software"):
        if renderer == "in software":
            monkeypatch.setattr(stage, "can_render", lambda: False)
        picture = iio.imread(save_picture(missing_force_picture(pulled), tmp_path / "arrows.png")).astype(int)
        blue.append((picture[..., 2] - picture[..., 0] > 40).mean())
    assert min(blue) > 0.002 and max(blue) < 1.5 * min(blue)


@pytest.mark.parametrize("command", ["diagnose", "run"])
def test_wrong_input_is_one_sentence(command, tmp_path, capsys):
    assert cli.main([command, "no_such_file.npz", "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err.strip()
    assert "no_such_file.npz" in said and len(said.splitlines()) == 1


def test_command_line_writes_both_pages_and_prints_the_facts(tmp_path, capsys):
    observation(0 * HIDDEN, frames=5).save(tmp_path / "box.npz")
    common = [str(tmp_path / "box.npz"), "--modes", "4", "--out"]
    assert cli.main(["run", *common, str(tmp_path / "out")]) == 0
    said = capsys.readouterr()
    found = json.loads(said.out)["diagnosis"]
    assert found.keys() == KEYS and found["sentence"] in " ".join(said.err.split())
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"report.html", "metrics.json", "diagnosis.html", "diagnosis.json"} <= names
    assert not any(name.startswith("checkpoint") for name in names)
