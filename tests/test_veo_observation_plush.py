"""PLUSH folders read as observations."""

import numpy as np
import pytest

from recon.plush.reconstruction import NozzlePath
from recon.plush.reconstruction_writer import write_nozzle, write_reconstruction, write_simulation
from veo_ti.observation import Observation


def plush_folder(path, *, simulation=True):
    """Ten frames of 30 points; the cleaned cloud is every other one; point 0 is taped down, point 1 led by a string."""
    rng = np.random.default_rng(5)
    vertices = rng.random((1, 30, 3)) * 0.3 + 0.0005 * rng.standard_normal((10, 30, 3))
    vertices[:, 0] = vertices[0, 0]
    vertices[:, 2] = vertices[0, 2] + np.linspace(0, 0.05, 10)[:, None]
    cleaned = np.arange(0, 30, 2)
    write_reconstruction(
        path, vertices=vertices, colors=rng.random((30, 3)), object_index=cleaned, fixed=np.array([0, 1])
    )
    direction = rng.standard_normal((10, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    nozzle = NozzlePath(position=rng.random((10, 3)), direction=direction, seen=np.arange(10) != 4)
    write_nozzle(path, nozzle)
    sampled = np.array([0, 1, 3, 5, 8])
    seen = vertices[7:9][:, cleaned[sampled]]
    choice = {"training": np.array([0, 3, 4]), "validation": np.array([7, 8]), "sampled": sampled}
    if simulation:
        write_simulation(path, **choice, seen=seen, simulated=seen + 0.001)
    return vertices[:, cleaned], nozzle, sampled


def test_plush_folder_becomes_an_observation_in_metres(tmp_path):
    points, nozzle, sampled = plush_folder(tmp_path / "leaf")
    o = Observation.load(tmp_path / "leaf")
    frames = [0, 3, 7, 8]  # 4 is a training frame in which the nozzle's marker was not seen
    np.testing.assert_allclose(o.points, points[frames][:, sampled], atol=1e-7)  # stored in single precision
    np.testing.assert_allclose(o.time, np.array(frames) / 40)
    np.testing.assert_allclose(o.jet.position, nozzle.position[frames], atol=1e-12)
    np.testing.assert_allclose(o.jet.direction, nozzle.direction[frames], atol=1e-12)
    np.testing.assert_array_equal(o.jet.force, [0, 1, 1, 1])
    np.testing.assert_array_equal(o.fixed, [True, False, False, False, False])
    np.testing.assert_array_equal(o.handles, [False, True, False, False, False])
    np.testing.assert_array_equal(o.split()[1], [2, 3])
    assert not o.force_scale_known and o.forces is None and o.name == "leaf"


def test_plush_folder_without_simulation_uses_all_seen_frames(tmp_path):
    plush_folder(tmp_path / "leaf", simulation=False)
    o = Observation.load(tmp_path / "leaf")
    assert o.points.shape == (9, 15, 3) and o.held_out is None


def test_plush_folder_without_nozzle_says_so(tmp_path):
    plush_folder(tmp_path / "leaf")
    (tmp_path / "leaf/capture/aruco_path.json").unlink()
    with pytest.raises(ValueError, match=r"nozzle's path; got .*aruco_path\.json is missing"):
        Observation.load(tmp_path / "leaf")
