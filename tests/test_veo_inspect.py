"""Inspecting a recording: who is out of step, what is missing, what the pictures show, a page that needs nothing."""

import json
import re
import shutil

import imageio.v3 as iio
import numpy as np
import pytest
from ellipsoid_scene import RADII, Scene, ring, swaying

from recon.cameras import look_at
from recon.exchange.nerfstudio_writer import write_transforms
from recon.plush.capture import read_capture
from recon.plush.capture_writer import write_capture
from recon.rig.make import make_rig
from recon.rig.options import RigOptions
from recon.rig.truth import read_truth
from recon.sync import estimate_offsets, motion_energy
from veo_ti import stage
from veo_ti.inspect import inspect_folder
from veo_ti.inspect_object import nozzle_regions, object_matte

FRAMES = 32
PICTURES = ("contact_sheet.png", "rig.png", "sync.png", "nozzle.png")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Five cameras, the third 2 frames late; the marker is not seen in four frames."""
    folder = tmp_path_factory.mktemp("rec") / "leaf"
    scene, cameras = Scene(swaying(FRAMES), late=(("cam0003", 2),)), ring(5)
    by_name = {camera.name: camera for camera in cameras}
    markers = [
        np.linalg.inv(look_at(0.3 * np.array([np.cos(a), 0.2, np.sin(a)]), np.zeros(3), np.array([0, 1.0, 0])))
        for a in np.linspace(0, 3, FRAMES)
    ]
    markers[8:12] = [None] * 4
    write_capture(folder, cameras, 40.0, lambda name: scene.frames(by_name[name]), markers)
    return folder


@pytest.fixture(scope="module")
def inspected(recorded, tmp_path_factory):
    """The folder of results, the facts, and what was said meanwhile."""
    out, said = tmp_path_factory.mktemp("inspected"), []
    return out, inspect_folder(recorded, out, say=said.append), said


def test_a_whole_recording_is_understood(inspected):
    out, facts, said = inspected
    assert facts == json.loads((out / "inspect.json").read_text())
    late = {f"cam{i:04d}": 0 for i in range(1, 6)} | {"cam0003": 2}
    assert facts["offset_frames"] == late and facts["cameras"] == facts["calibrated"] == 5
    assert "5 cameras, 32 frames at 40 frames a second; out of step: cam0003 by +2 frames" in facts["sentence"]
    assert facts["nozzle_frames_seen"] == 28 and facts["frames"] == FRAMES
    assert facts["missing"] == ["no left and right videos: the colour ones are enough for a reconstruction."]
    np.testing.assert_allclose(facts["hull_middle_m"], swaying(FRAMES)[FRAMES // 2], atol=0.012)
    size = np.array(facts["hull_size_mm"])
    assert (size >= 2e3 * RADII).all() and (size < 2e3 * RADII + 90).all()  # a pixel is 7 mm
    assert any("cam0004" in line for line in said)


def test_the_page_needs_nothing_and_names_everything(inspected):
    page = (inspected[0] / "inspect.html").read_text(encoding="utf-8")
    assert not re.search(r"https?://|@import|url\(|<script", page)
    assert page.count("data:image/png;base64,") == len(PICTURES)
    assert all(f"<td>cam{i:04d}</td>" in page for i in range(1, 6)) and "Recording leaf" in page
    for name in PICTURES:
        image = iio.imread(inspected[0] / name)[..., :3].astype(float)
        assert min(image.shape[:2]) > 150 and image.std() > 8, name


def test_the_sheet_shows_every_camera(inspected):
    """Five bright objects, one in each of five tiles of 228 pixels."""
    sheet = iio.imread(inspected[0] / "contact_sheet.png")[..., :3].astype(float)
    for tile in np.split(sheet[30:300, : 5 * 228], 5, axis=1):
        dark, bright = (tile.max(axis=2) < 40).mean(), ((tile.max(axis=2) > 60) & (tile.min(axis=2) < 230)).mean()
        assert dark > 0.6 and 0.02 < bright < 0.3


def test_the_rig_is_drawn_without_opengl_too(recorded, inspected, tmp_path, monkeypatch):
    monkeypatch.setattr(stage, "can_render", lambda: False)
    inspect_folder(recorded, tmp_path, frames=2)
    one, other = (iio.imread(out / "rig.png")[..., :3].astype(float) for out in (inspected[0], tmp_path))
    assert one.shape == other.shape
    dark = [image.min(axis=2) < 160 for image in (one, other)]
    assert (dark[0] & dark[1]).sum() > 0.5 * max(d.sum() for d in dark)


def test_what_is_damaged_or_missing_is_named_and_the_rest_shown(recorded, tmp_path):
    folder = tmp_path / "leaf"
    shutil.copytree(recorded, folder)
    broken = folder / "capture/cam0002.aligned.mp4"
    broken.write_bytes(broken.read_bytes()[:3000])
    (folder / "capture/aruco_path.json").unlink()
    entries = json.loads((folder / "capture/calibration.json").read_text())
    del entries["cam0004"]
    (folder / "capture/calibration.json").write_text(json.dumps(entries))
    facts = inspect_folder(folder, tmp_path / "out", frames=20)
    words = " ".join(facts["missing"])
    assert "cam0002.aligned.mp4 (cam0002) must be a complete video" in words
    assert "also cam0004 of cam0004.aligned.mp4" in words and "capture/aruco_path.json is missing" in words
    assert facts["cameras"] == 4 and facts["calibrated"] == 3 and facts["nozzle_frames_seen"] is None
    assert not (tmp_path / "out/nozzle.png").exists() and facts["hull_size_mm"] is not None
    assert "things are missing or wrong" in facts["sentence"]


def test_without_calibration_the_pictures_are_still_shown(recorded, tmp_path):
    shutil.copytree(recorded, tmp_path / "leaf")
    (tmp_path / "leaf/capture/calibration.json").unlink()
    facts = inspect_folder(tmp_path / "leaf", tmp_path / "out", frames=4)
    assert facts["calibrated"] == 0 and facts["offset_frames"] == {f"cam{i:04d}": None for i in range(1, 6)}
    assert (tmp_path / "out/contact_sheet.png").exists() and not (tmp_path / "out/rig.png").exists()
    assert any("no hull of the object" in note for note in facts["missing"])


def test_a_nerfstudio_folder_is_inspected_too(tmp_path):
    cameras, scene = [camera.undistorted() for camera in ring(4)], Scene(swaying(2))
    by_name = {camera.name: camera for camera in cameras}
    write_transforms(tmp_path / "in", cameras, np.array([0, 0.1]), lambda name: scene.frames(by_name[name]))
    facts = inspect_folder(tmp_path / "in", tmp_path / "out")
    assert facts["calibrated"] == 4 and facts["hull_size_mm"] is not None and facts["missing"] == []
    with pytest.raises(ValueError, match="FOLDER must be a folder with a recording; got"):
        inspect_folder(tmp_path / "in/transforms.json", tmp_path / "out")


def test_the_nozzle_is_no_part_of_the_object(tmp_path):
    """A rig recording without mattes: the marker is bright where the cameras see it, and not in the object."""
    folder = make_rig(tmp_path / "plush", RigOptions(cameras=7, frames=3, size=160, greys=False))
    capture, truth, notes = read_capture(folder), read_truth(folder), []
    regions, checked = nozzle_regions(folder, capture, 1, notes), 0
    for camera, seen in zip(truth.cameras, truth.seen[1], strict=True):
        if not seen:
            continue
        image, (column, row) = capture.image(camera.name, 1), camera.project(truth.T_world_marker[1][:3, 3])[0]
        here = np.hypot(*(np.indices(image.shape[:2]) - np.reshape([row, column], (2, 1, 1)))) < 8
        assert (object_matte(capture, camera.name, 1, image, 32, None) & here).sum() > 10
        assert not (object_matte(capture, camera.name, 1, image, 32, regions[camera.name]) & here).any()
        checked += 1
    assert checked == 3 and notes == []
    facts = inspect_folder(folder, tmp_path / "out")
    more = np.array(facts["hull_size_mm"]) - 1e3 * np.ptp(truth.points[1], axis=0)
    assert (more > 0).all() and (more < 90).all()  # a pixel is 4 mm, outlines grow by 2, and there are few cameras
    np.testing.assert_allclose(facts["hull_middle_m"], truth.points[1].mean(axis=0), atol=0.03)
    assert "too few frames to tell whether the cameras are in step" in facts["sentence"]


@pytest.mark.parametrize("seed", range(3))
def test_offsets_are_found_whatever_the_gain_and_noise(seed):
    rng = np.random.default_rng(seed)
    true = np.array([0, 0, 4, 0, -7, 1, 0, 0])
    motion = np.abs(np.convolve(rng.normal(size=160), np.ones(4) / 4, "valid"))
    curves = [motion[20 - k : 120 - k] for k in true]
    energy = np.stack(
        [gain * c + rng.normal(0, 0.05, 100) + gain for gain, c in zip(1 + np.arange(8), curves, strict=True)]
    )
    energy[7] = rng.random(100)
    sync = estimate_offsets(energy)
    np.testing.assert_array_equal(sync.known, [True] * 7 + [False])
    np.testing.assert_array_equal(sync.offset[:7], true[:7])
    assert not estimate_offsets(energy[:, :10]).known.any()


def test_motion_energy_is_the_mean_change_of_brightness():
    images = [np.full((96, 72, 3), value, np.uint8) for value in (10, 14, 14, 4)]
    np.testing.assert_allclose(motion_energy(images), [4, 0, 10], atol=1e-5)
