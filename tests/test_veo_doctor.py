"""The doctor: says what is wrong in a sentence, survives what it looks at, and is right about this machine."""

import subprocess
import sys
import time

import pytest

from sim._open3d import load_open3d
from veo_ti import doctor


def test_examine_names_everything_once_and_gives_advice():
    findings = doctor.examine()
    names = [finding.name for finding in findings]
    assert len(set(names)) == len(names) and set(doctor.PACKAGES) < set(names)
    assert all(finding.sentence for finding in findings if not finding.ok)
    ok = {finding.name: finding.ok for finding in findings}
    assert ok["numpy"] and ok["Taichi kernel on the CPU"] and ok["ffmpeg"]


@pytest.mark.parametrize(("code", "said", "words"), [
    (1, "ImportError: libEGL.so.1: cannot open shared object file: No such file", "apt install libegl1"),
    (1, "ImportError: libodd.so.7: cannot open shared object file", "apt-file search libodd.so.7"),
    (1, "ModuleNotFoundError: No module named 'other.part'", "pip install other"),
    (-11, "", "SIGSEGV"),
    (None, "", "did not answer in time"),
    (1, "RuntimeError: out of luck", "out of luck"),
    (3, "", "exit code 3"),
])
def test_every_ending_has_its_advice(code, said, words):
    assert words in doctor.explain("thing", code, said)


def test_absent_module_is_advised_by_its_name_on_pypi():
    said = "ModuleNotFoundError: No module named 'cv2'"
    assert "pip install opencv-python-headless" in doctor.explain("opencv-python-headless", 1, said)


def test_crash_in_a_package_is_a_finding(monkeypatch):
    monkeypatch.setitem(doctor.PACKAGES, "numpy", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    finding = doctor._package("numpy")
    assert not finding.ok and "SIGSEGV" in finding.sentence


def test_camera_search_that_hangs_ends_in_time(monkeypatch):
    monkeypatch.setattr(doctor, "CAMERA_PROBE", "import time\ntime.sleep(60)")
    start = time.monotonic()
    finding = doctor._cameras()
    assert time.monotonic() - start < 10 and not finding.ok and "5 s" in finding.sentence


def test_open3d_loads_and_measures_a_distance():
    o3d = load_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.create_box())
    distance = scene.compute_signed_distance(o3d.core.Tensor([[0.5, 0.5, 1.25]], dtype=o3d.core.float32))
    assert distance.numpy()[0] == pytest.approx(0.25, abs=1e-6)


def test_missing_open3d_is_one_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(RuntimeError, match="veo doctor"):
        load_open3d()


def test_package_imports_fast_and_loads_nothing_heavy():
    heavy = "{'numpy', 'taichi', 'torch', 'open3d', 'pyvista', 'h5py', 'scipy'}"
    code = f"import sys, veo_ti; sys.exit(len({heavy} & set(sys.modules)) + ('examine' not in dir(veo_ti)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_package_names_load_on_first_use():
    import veo_ti

    assert veo_ti.examine is doctor.examine
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = veo_ti.nothing
