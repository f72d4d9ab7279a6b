"""The native file: other programs open it, an interrupted run keeps its steps, foreign files are refused."""

import json
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pytest
import pyvista

from veo_ti.export import export_npz, export_ply
from veo_ti.store import (
    Sequence,
    SequenceWriter,
    read_npz,
    read_sequence,
    writable_folder,
    write_json_atomic,
    write_sequence,
)

KILLED = """
import os, signal, sys
import numpy as np
from veo_ti.store import SequenceWriter
with SequenceWriter(sys.argv[1], static={"mu": np.arange(7.0)}) as writer:
    for i in range(5):
        writer.append(i, np.full((7, 3), float(i)), {"forces": np.ones((7, 3))})
    os.kill(os.getpid(), signal.SIGKILL)
"""


def sequence(steps: int = 4, count: int = 7) -> Sequence:
    rng = np.random.default_rng(0)
    return Sequence(
        time=np.linspace(0, 1, steps),
        points=rng.random((steps, count, 3)),
        point_data={"forces": rng.random((steps, count, 3)), "observed": rng.random((steps, count)) > 0.5},
        static={"mu": rng.random(count), "x": rng.random((count, 3)), "fixed": rng.random(count) > 0.5},
        arrays={"gravity": np.array([0, 0, -9.81]), "loss": rng.random(11).astype(np.float32)},
        attributes={"mass": 0.25, "options": {"k": 6, "mode": "consistent"}, "name": "leaf", "resumed": None},
    )


def same(a, b):
    np.testing.assert_array_equal(a, b, strict=True)


def test_reading_returns_what_was_written(tmp_path):
    before = sequence()
    after = read_sequence(write_sequence(tmp_path / "a.vtkhdf", before))
    same(after.time, before.time)
    same(after.points, before.points)
    for part in ("point_data", "static", "arrays"):
        assert getattr(after, part).keys() == getattr(before, part).keys()
        for name, values in getattr(before, part).items():
            same(getattr(after, part)[name], values)
    assert after.attributes == before.attributes and {"python", "h5py", "numpy"} <= after.versions.keys()
    assert [p.name for p in tmp_path.iterdir()] == ["a.vtkhdf"]


def test_pyvista_steps_through_positions_and_values(tmp_path):
    written = sequence()
    reader = pyvista.get_reader(write_sequence(tmp_path / "a.vtkhdf", written))
    for i in (2, 0, 3):
        reader.reader.SetStep(i)
        mesh = reader.read()
        same(mesh.points, written.points[i])
        same(mesh["forces"], written.point_data["forces"][i])
        same(mesh["mu"], written.static["mu"])
        same(mesh["x"], written.static["x"])
        same(mesh["fixed"].astype(bool), written.static["fixed"])
        assert mesh.n_cells == mesh.n_points and mesh.n_verts == mesh.n_points


def test_static_values_are_stored_once(tmp_path):
    path = write_sequence(tmp_path / "a.vtkhdf", sequence(steps=4))
    with h5py.File(path) as file:
        assert file["VTKHDF/PointData/mu"].shape == (7,) and file["VTKHDF/PointData/forces"].shape == (28, 3)
        units = json.loads(file["veo_ti/units"].asstr()[()])
        assert units["points"] == "m" and units["mu"] == "Pa" and file["veo_ti"].attrs["schema"] == 1


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_interrupted_run_keeps_its_steps(tmp_path, error):
    written = sequence()
    with pytest.raises(error), SequenceWriter(tmp_path / "a.vtkhdf", static=written.static) as writer:
        writer.append(0.0, written.points[0])
        writer.append(0.1, written.points[1])
        raise error
    assert [p.name for p in tmp_path.iterdir()] == ["a.partial.vtkhdf"]
    same(read_sequence(tmp_path / "a.partial.vtkhdf").points, written.points[:2])
    assert pyvista.read(tmp_path / "a.partial.vtkhdf").n_points == 7


def test_step_begun_only_is_forgotten(tmp_path, monkeypatch):
    written, put = sequence(), h5py.AttributeManager.modify

    def interrupted(self, name, value):
        if value == 3:
            raise KeyboardInterrupt
        put(self, name, value)

    monkeypatch.setattr(h5py.AttributeManager, "modify", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_sequence(tmp_path / "a.vtkhdf", written)
    same(read_sequence(tmp_path / "a.partial.vtkhdf").points, written.points[:2])
    with h5py.File(tmp_path / "a.partial.vtkhdf") as file:  # one time value too many overruns a buffer in VTK
        assert len(file["VTKHDF/Steps/Values"]) == file["VTKHDF/Steps"].attrs["NSteps"] == 2
    reader = pyvista.get_reader(tmp_path / "a.partial.vtkhdf")
    reader.reader.SetStep(1)
    same(reader.read().points, written.points[1])


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system cannot kill a process outright")
def test_killed_run_keeps_its_flushed_steps(tmp_path):
    root = Path(__file__).parents[1]
    command = [sys.executable, "-c", KILLED, str(tmp_path / "a.vtkhdf")]
    assert subprocess.run(command, cwd=root, check=False).returncode == -signal.SIGKILL
    kept = read_sequence(tmp_path / "a.partial.vtkhdf")
    same(kept.points[:, 0, 0], np.arange(5.0))
    reader = pyvista.get_reader(tmp_path / "a.partial.vtkhdf")
    reader.reader.SetStep(4)
    same(reader.read()["mu"], np.arange(7.0))


def test_failure_leaves_the_earlier_result(tmp_path):
    path = write_sequence(tmp_path / "a.vtkhdf", sequence())
    before = path.read_bytes()
    with pytest.raises(ValueError, match=r"mu must be numbers of shape \(7,\)"):
        write_sequence(path, Sequence(time=np.zeros(1), points=np.zeros((1, 7, 3)), static={"mu": np.ones(3)}))
    assert path.read_bytes() == before and [p.name for p in tmp_path.iterdir()] == ["a.vtkhdf"]


def test_steps_that_do_not_fit_are_named(tmp_path):
    points = np.zeros((7, 3))
    with SequenceWriter(tmp_path / "a.vtkhdf", static={"mu": np.ones(7)}) as writer:
        with pytest.raises(ValueError, match=r"point_data must not repeat names of static; got \['mu'\]"):
            writer.append(0, points, {"mu": np.ones(7)})
        writer.append(0, points, {"f": np.ones(7)})
        with pytest.raises(ValueError, match=r"point_data must hold \['f'\] in each step; got \[\]"):
            writer.append(1, points)
        with pytest.raises(ValueError, match=r"points must have shape \(7, 3\)"):
            writer.append(1, points[:5], {"f": np.ones(5)})
        with pytest.raises(ValueError, match="points must be finite"):
            writer.append(1, points + np.nan, {"f": np.ones(7)})
    assert len(read_sequence(tmp_path / "a.vtkhdf").time) == 1
    with pytest.raises(ValueError, match="sequence must have at least one step"), SequenceWriter(tmp_path / "b.vtkhdf"):
        pass
    with pytest.raises(ValueError, match=r"path must end in \.vtkhdf"):
        SequenceWriter(tmp_path / "a.h5")


def foreign(path):
    with h5py.File(path, "w") as file:
        file["x"] = 1


def newer(path):
    write_sequence(path, sequence())
    with h5py.File(path, "a") as file:
        file["veo_ti"].attrs["schema"] = 99


def cut(path):
    write_sequence(path, sequence())
    path.write_bytes(path.read_bytes()[:-2000])


def gutted(path):
    write_sequence(path, sequence())
    with h5py.File(path, "a") as file:
        del file["VTKHDF/Points"]


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda path: None, "file must exist"),
        (lambda path: path.write_text("words"), r"file must be a complete \.vtkhdf written by veo_ti"),
        (foreign, r"groups must include VTKHDF and veo_ti; got \['x'\]"),
        (newer, "schema must be 1 or older: update veo_ti to read it; got 99"),
        (cut, r"file must be a complete \.vtkhdf written by veo_ti"),
        (gutted, "Points"),
    ],
)
def test_file_that_cannot_be_read_is_one_sentence(tmp_path, spoil, sentence):
    spoil(tmp_path / "a.vtkhdf")
    with pytest.raises(ValueError, match=sentence) as caught:
        read_sequence(tmp_path / "a.vtkhdf")
    assert "\n" not in str(caught.value)


@dataclass(frozen=True)
class Options:
    k: int = 6


def test_json_understands_numpy_and_replaces_the_old_file_whole(tmp_path):
    path = tmp_path / "out" / "metrics.json"
    write_json_atomic(path, {"old": 1})
    write_json_atomic(path, {"mean": np.float64(0.5), "mu": np.arange(2), "options": Options(), "path": Path("x")})
    assert json.loads(path.read_text()) == {"mean": 0.5, "mu": [0, 1], "options": {"k": 6}, "path": "x"}
    for bad in (np.nan, object()):
        with pytest.raises(ValueError, match=r"metrics\.json must hold finite numbers, texts and lists"):
            write_json_atomic(path, {"bad": bad})
    assert json.loads(path.read_text())["mean"] == 0.5 and len(list(path.parent.iterdir())) == 1


def test_unwritable_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match=r"folder must be writable; got '.*file/deeper' \("):
        writable_folder(tmp_path / "file" / "deeper")
    assert writable_folder(tmp_path / "a" / "b").is_dir() and not list((tmp_path / "a" / "b").iterdir())


def test_ply_files_hold_positions_and_scalars(tmp_path):
    written = sequence()
    paths = export_ply(written, tmp_path / "ply", every=2)
    assert [p.name for p in paths] == ["0000.ply", "0002.ply"]
    mesh = pyvista.read(paths[1])
    same(mesh.points, written.points[2].astype(np.float32))
    header = paths[1].read_bytes().split(b"end_header")[0].decode()
    assert "property float mu" in header and "property float forces" not in header


def test_npz_export_holds_every_array(tmp_path):
    written = sequence()
    held = read_npz(export_npz(written, tmp_path / "a.npz"))
    same(held["points"], written.points)
    assert held.keys() == {"time", "points", "forces", "observed", "mu", "x", "fixed", "gravity", "loss"}
