"""The synthetic rig's recordings: what is written agrees with the truth, read by others' readers and detectors."""

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.ndimage import binary_dilation, distance_transform_edt

from recon.nozzle.path import MARKER
from recon.plush.capture import read_capture
from recon.plush.reconstruction import read_plush
from recon.rig.make import make_rig
from recon.rig.options import RigFaults, RigOptions, parse_faults
from recon.rig.truth import read_truth

SMOKE = RigOptions(cameras=6, frames=6, size=96, reconstruction=400)
TINY = RigOptions(shape="pillow", cameras=4, frames=5, size=88, greys=False)


def contents(folder: Path) -> dict[str, bytes]:
    """Every file by its path."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def changed(first: Path, second: Path) -> set[str]:
    """Files that differ or that only one has, but for what was asked for."""
    a, b = contents(first), contents(second)
    return {name for name in a.keys() | b.keys() if a.get(name) != b.get(name)} - {"truth/options.json"}


@pytest.fixture(scope="module")
def smoke(tmp_path_factory):
    return make_rig(tmp_path_factory.mktemp("smoke") / "plush", SMOKE)


@pytest.fixture(scope="module")
def sharp(tmp_path_factory):
    """Two frames at half the full rig's size, so that there is something to measure."""
    options = RigOptions(shape="dinosaur", cameras=4, frames=3, size=540, greys=False)
    return make_rig(tmp_path_factory.mktemp("sharp") / "dinosaur", options)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    return make_rig(tmp_path_factory.mktemp("tiny") / "plain", TINY)


def test_the_recording_is_read_back_as_it_was_planned(smoke):
    capture, truth = read_capture(smoke), read_truth(smoke)
    assert capture.missing == () and len(capture.cameras) == 18 and len(capture.times) == 6
    np.testing.assert_allclose(capture.times, truth.times, atol=1e-12)
    for camera in capture.cameras:
        true = truth.camera(camera.name)
        assert camera.size == true.size and camera.stream == true.stream
        np.testing.assert_allclose(camera.T_camera_world, true.T_camera_world, atol=1e-12)
        np.testing.assert_allclose(camera.K, true.K, rtol=1e-12)
        np.testing.assert_allclose(camera.distortion, true.distortion, rtol=1e-12)
    assert capture.image("cam0002", 3).shape == (170, 96, 3) and capture.image("cam0002.left", 3).shape == (114, 72)
    assert [truth.camera(f"cam000{i}").role for i in range(1, 7)] == ["train"] * 3 + ["nozzle"] * 3
    np.testing.assert_allclose(truth.camera("cam0001").T_camera_world, np.diag([1.0, -1, -1, 1]), atol=1e-12)


def test_the_rig_has_the_geometry_of_plush(smoke):
    truth = read_truth(smoke)
    middle = (truth.rest.min(0) + truth.rest.max(0)) / 2
    away = {c.name: np.linalg.norm(c.centre - middle) for c in truth.cameras}
    assert 0.74 < away["cam0001"] < 0.86 and 0.28 < np.ptp(truth.rest, axis=0).max() < 0.36
    for i in range(1, 7):
        left, right, colour = (truth.camera(f"cam000{i}{s}").centre for s in (".left", ".right", ""))
        assert np.linalg.norm(left - right) == pytest.approx(0.075) and np.allclose((left + right) / 2, colour)
        # The stored picture lies on its side: its right is up in the upright one, where the right sensor is.
        assert truth.camera(f"cam000{i}").project(right + 0.5 * truth.camera(f"cam000{i}").axis)[0][1] < 85


def test_nozzle_path_is_that_of_the_marker(smoke):
    truth, nozzle = read_truth(smoke), read_plush(smoke).nozzle
    R = truth.T_world_marker[:, :3, :3]
    # by hand: 105 mm above the marker's centre along its y, blowing along its -z
    np.testing.assert_allclose(nozzle.position, truth.T_world_marker[:, :3, 3] + 0.105 * R[:, :, 1], atol=1e-12)
    np.testing.assert_allclose(nozzle.direction, -R[:, :, 2], atol=1e-12)
    assert truth.seen.any(axis=1).all() and nozzle.seen.all()


def test_truth_projects_onto_the_matte(smoke):
    capture, truth = read_capture(smoke), read_truth(smoke)
    for name, frame in (("cam0001", 0), ("cam0002", 2), ("cam0003.right", 4), ("cam0002.left", 5)):
        matte, camera = truth.matte(name, frame) > 127, capture.camera(name)
        pixels, _ = camera.project(truth.points[frame][truth.surface])
        column, row = np.round(pixels).astype(int).T
        shown = np.zeros_like(matte)
        shown[row, column] = True
        assert binary_dilation(matte, iterations=1)[row, column].mean() > 0.999
        assert distance_transform_edt(~shown)[matte].max() < 2.0  # no part of the matte is far from the body


@pytest.mark.parametrize("frame", [0, 1])
def test_marker_is_detected_where_the_truth_projects_it(sharp, frame):
    capture, truth = read_capture(sharp), read_truth(sharp)
    options = cv2.aruco.DetectorParameters()
    options.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, MARKER.dictionary))
    watching = [c for c in truth.cameras if truth.seen[frame, truth.cameras.index(c)]]
    assert len(watching) == 3 and all(c.role == "nozzle" for c in watching)
    for camera in watching:
        image = cv2.cvtColor(capture.image(camera.name, frame), cv2.COLOR_RGB2GRAY)
        corners, ids, _ = cv2.aruco.ArucoDetector(known, options).detectMarkers(image)
        assert ids.ravel().tolist() == [164]
        T = truth.T_world_marker[frame]
        there, _ = camera.project(MARKER.corners @ T[:3, :3].T + T[:3, 3])
        found, side = corners[0][0], np.linalg.norm(there[0] - there[1])
        # OpenCV's corners lie up to a pixel inside, all four alike: their middle does not.
        assert np.abs(found - there).max() < 1.6 and np.abs((found - there).mean(axis=0)).max() < 0.03 * side


def test_mattes_agree_with_what_differs_from_the_empty_stage(sharp):
    capture, truth = read_capture(sharp), read_truth(sharp)
    for frame in range(3):
        matte = truth.matte("cam0001", frame) > 127
        near = binary_dilation(matte, iterations=12)  # the nozzle is not the object
        differs = cv2.absdiff(capture.image("cam0001", frame), truth.plate("cam0001")).max(axis=2) > 24
        assert (matte & differs).sum() / (matte | (differs & near)).sum() > 0.97
        soft = truth.matte("cam0001", frame)
        assert ((soft > 0) & (soft < 255)).sum() > 0.5 * 2 * np.sqrt(np.pi * matte.sum())  # edges are not hard


def test_colours_are_the_same_in_all_cameras(sharp):
    """Cloth looks alike from everywhere: what a node looks like in two cameras differs by noise and mattress only."""
    capture, truth = read_capture(sharp), read_truth(sharp)
    names, seen = ["cam0001", "cam0002", "cam0004"], []
    facing = node_normals(truth)
    for name in names:
        camera = truth.camera(name)
        pixels, _ = camera.project(truth.points[0])
        way = (camera.centre - truth.points[0]) / np.linalg.norm(camera.centre - truth.points[0], axis=1)[:, None]
        inner = cv2.erode(truth.matte(name, 0), np.ones((5, 5)))
        column, row = np.round(pixels).astype(int).T
        colour = cv2.GaussianBlur(capture.image(name, 0), (3, 3), 0)[row, column].astype(float)
        good = truth.surface & ((way * facing).sum(1) > 0.6) & (inner[row, column] == 255)
        seen.append(np.where(good[:, None], colour, np.nan))
    off = seen[0] - seen[2]
    both = np.isfinite(off).all(axis=1)
    assert both.sum() > 100 and np.abs(np.nanmedian(off, axis=0)).max() < 6
    assert np.corrcoef(seen[0][both].mean(1), seen[2][both].mean(1))[0, 1] > 0.7


def node_normals(truth):
    p, t = truth.points[0], truth.triangles
    face = np.cross(p[t[:, 1]] - p[t[:, 0]], p[t[:, 2]] - p[t[:, 0]])
    out = np.zeros_like(p)
    np.add.at(out, t, face[:, None])
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-30)


def test_reconstruction_is_the_truth_at_its_points(smoke):
    folder, truth = read_plush(smoke), read_truth(smoke)
    rest = folder.points(0)
    assert rest.shape == (400, 3) and len(folder.frame_numbers) == 6 and 0 < folder.fixed.sum() < 200
    for frame in (2, 5):
        np.testing.assert_allclose(folder.points(frame), truth.warp(rest, frame), atol=2e-5)
    assert any("simulation" in said for said in folder.missing)


def test_same_seed_same_bytes_and_another_seed_another_recording(tiny, tmp_path):
    again = make_rig(tmp_path / "again", TINY)
    assert changed(tiny, again) == set()
    other = make_rig(tmp_path / "other", dataclasses.replace(TINY, seed=1))
    assert {"capture/cam0001.aligned.mp4", "capture/calibration.json"} <= changed(tiny, other)


def test_interrupted_recording_goes_on_and_another_one_is_refused(tmp_path):
    folder = make_rig(tmp_path / "a", TINY)
    whole, video = contents(folder), folder / "capture/cam0003.aligned.mp4"
    kept = (folder / "capture/cam0002.aligned.mp4").stat().st_mtime_ns
    video.unlink()
    said = []
    make_rig(folder, TINY, progress=said.append)
    assert contents(folder) == whole and (folder / "capture/cam0002.aligned.mp4").stat().st_mtime_ns == kept
    assert any("cam0003 frame 5 of 5" in line for line in said) and not any("cam0002" in line for line in said)
    with pytest.raises(ValueError, match="must be a new folder or hold a recording with the same options"):
        make_rig(folder, dataclasses.replace(TINY, seed=1))


def test_options_that_no_rig_can_be_are_one_sentence():
    for wrong, sentence in (
        ({"shape": "cat"}, "shape must be one of plush, dinosaur, pillow, leaf; got cat"),
        ({"cameras": 20}, "cameras must be 4 to 19; got 20"),
        ({"frames": 1}, "frames must be at least 2; got 1"),
        ({"size": 10}, "size must be 88 to 2160 pixels; got 10"),
        ({"faults": RigFaults(missing=("cam0021",))}, "fault must name one of the 19 cameras"),
        ({"faults": RigFaults(late=(("cam0002", 48),))}, "fault late must be fewer frames than there are"),
    ):
        with pytest.raises(ValueError, match=sentence):
            RigOptions(**wrong)


def test_faults_are_read_from_words():
    words = [
        "nozzle-deg=8",
        "nozzle-mm=-5",
        "missing=cam0003",
        "late=cam0002:3",
        "late=cam0001:1",
        "scale=1.1",
        "inertia",
    ]
    assert parse_faults(words) == RigFaults(
        nozzle_deg=8, nozzle_mm=-5, missing=("cam0003",), late=(("cam0002", 3), ("cam0001", 1)), scale=1.1, inertia=True
    )
    for word in ("late=cam0002", "inertia=yes", "wobble=3", "missing=cam3", "scale=big"):
        with pytest.raises(ValueError, match="fault must"):
            parse_faults([word])
    assert json.loads(json.dumps(dataclasses.asdict(parse_faults(words))))["scale"] == 1.1
