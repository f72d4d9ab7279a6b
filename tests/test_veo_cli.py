"""The command line: instant help, one sentence for wrong input, files where they were asked for."""

import json
import subprocess
import sys

import numpy as np
import pytest

from sim.lame import Lame
from veo_ti import cli
from veo_ti.body import sample_box
from veo_ti.diagnosis.causes import CATALOGUE
from veo_ti.object import VirtualElasticObject
from veo_ti.observation import Observation


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with an object and a measurement of it that is nothing but rest and one small push."""
    path = tmp_path_factory.mktemp("object")
    body = sample_box([0.2, 0.05, 0.05], 300)
    beam = VirtualElasticObject(
        x=body.x, lame=Lame.from_young(np.full(300, 2e4), 0.3), volume=body.volume, surface=body.surface,
        fixed=body.x[:, 0] == 0, mass=0.05,
    )  # fmt: skip
    beam.save(path / "object.vtkhdf")
    push = beam.push_at([0.2, 0.025, 0.05], np.linspace(0, 1, 5)[:, None] * [0, 0, -0.05], radius=0.02)
    pose = beam.simulate(push)
    Observation(
        points=pose.y, forces=push.force, time=np.arange(5.0), fixed=beam.fixed, surface=beam.surface,
        volume=beam.volume,
    ).save(path / "measured.npz")  # fmt: skip
    return path


def test_help_loads_no_heavy_package():
    code = "import sys, veo_ti.cli; print(sorted({'taichi', 'torch', 'open3d', 'pyvista', 'scipy'} & set(sys.modules)))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["identify", "no_such_file.npz"], "no_such_file.npz"),
        (["evaluate", "nowhere", "example"], "must exist"),
        (["simulate", "{folder}"], "must be given --force, --gravity or --contact"),
        (["simulate", "{folder}", "--force", "1,2"], "must have the form"),
        (["simulate", "{folder}", "--contact", "cone:1,2,3"], "must be one of plane, sphere, capsule, box, mesh"),
        (["simulate", "{folder}", "--contact", "sphere:1,2"], "must be 4 numbers"),
    ],
)
def test_wrong_input_is_one_sentence_and_status_2(arguments, words, folder, tmp_path, capsys):
    arguments = [a.format(folder=folder) for a in arguments]
    assert cli.main([*arguments, "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip()
    assert words in said
    assert "Traceback" not in said


def test_unwritable_folder_is_named(folder, tmp_path, capsys):
    (tmp_path / "file").write_text("not a folder")
    assert cli.main(["render", str(folder), "--out", str(tmp_path / "file")]) == 2
    assert "file" in capsys.readouterr().err


def test_interruption_is_status_130(monkeypatch, tmp_path, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "_identify", interrupted)
    assert cli.main(["identify", "example", "--out", str(tmp_path)]) == 130
    assert "goes on from there" in capsys.readouterr().err


def test_evaluation_of_the_own_simulation_finds_no_error(folder, tmp_path):
    assert cli.main(["evaluate", str(folder), str(folder / "measured.npz"), "--out", str(tmp_path)]) == 0
    assert json.loads((tmp_path / "metrics.json").read_text())["error_mm"]["max"] < 1e-3  # single precision in the file


def test_simulation_with_every_kind_of_load_writes_its_film(folder, tmp_path):
    loads = ["--force", "0,0,-0.02@0.2,0.025,0.05,0.02", "--gravity", "0,0,-1", "--steps", "3"]
    contact = ["--contact", "sphere:0.2,0.025,-0.03,0.03@0,0,0.01"]
    assert cli.main(["simulate", str(folder), *loads, *contact, "--out", str(tmp_path)]) == 0
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["converged"]
    assert (tmp_path / "motion.mp4").stat().st_size > 1000
    assert VirtualElasticObject.load(tmp_path / "simulation.vtkhdf").x.shape == (300, 3)


def test_pictures_of_an_object(folder, tmp_path):
    assert cli.main(["render", str(folder), "--out", str(tmp_path)]) == 0
    assert {"mu.png", "mu_inside.png", "lam.png", "sensitivity.png", "mu.mp4"} <= {p.name for p in tmp_path.iterdir()}


def test_causes_lists_the_whole_catalogue(capsys):
    assert cli.main(["causes"]) == 0
    said = capsys.readouterr().out
    for cause in CATALOGUE:
        assert cause.name in said
        assert all(f"{p.name} [{p.unit}]" in said for p in cause.parameters)
