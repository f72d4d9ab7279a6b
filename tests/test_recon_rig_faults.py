"""Planted faults of the synthetic rig: each changes what it should, and nothing else."""

import dataclasses
import json

import numpy as np
import pytest
from test_recon_rig import TINY, changed, contents

from recon.plush.capture import read_capture
from recon.rig.make import make_rig
from recon.rig.options import RigFaults
from recon.rig.truth import read_truth

LEVELS = 8.0  # grey levels of 255: noise of 2 and what the coder leaves out


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return make_rig(tmp_path_factory.mktemp("tiny") / "plain", TINY)


def faulty(tmp_path, **faults):
    return make_rig(tmp_path / "faulty", dataclasses.replace(TINY, faults=RigFaults(**faults)))


def poses(folder):
    """Rotations (F, 3, 3) and shifts (F, 3) [mm] as the file has them."""
    entries = json.loads((folder / "capture/aruco_path.json").read_text())
    return np.array([e["rvecs"] for e in entries]), np.array([e["tvecs"] for e in entries])


def test_nozzle_error_tilts_and_moves_the_written_marker_only(plain, tmp_path):
    folder = faulty(tmp_path, nozzle_deg=8.0, nozzle_mm=5.0)
    assert changed(plain, folder) == {"capture/aruco_path.json"}
    (R, t), (Q, s) = poses(plain), poses(folder)
    angle = np.arccos((np.trace(np.swapaxes(R, 1, 2) @ Q, axis1=1, axis2=2) - 1) / 2)
    np.testing.assert_allclose(np.rad2deg(angle), 8.0, rtol=1e-9)
    np.testing.assert_allclose(np.einsum("fji,fj->fi", R, s - t), np.tile([5.0, 0, 0], (5, 1)), atol=1e-9)
    tilt = np.arccos((R[:, :, 2] * Q[:, :, 2]).sum(1))
    np.testing.assert_allclose(np.rad2deg(tilt), 8.0, rtol=1e-6)  # all of it tilts the stream


def test_missing_camera_has_no_video(plain, tmp_path):
    folder = faulty(tmp_path, missing=("cam0002",))
    gone = {name for name in contents(plain) if "cam0002" in name}
    assert changed(plain, folder) == gone and "capture/cam0002.aligned.mp4" in gone
    assert read_capture(folder).missing[0].startswith("capture/cam0002.aligned.mp4 is missing")


def test_late_camera_shows_earlier_frames(plain, tmp_path):
    folder = faulty(tmp_path, late=(("cam0001", 2),))
    assert changed(plain, folder) == {"capture/cam0001.aligned.mp4"}
    assert read_truth(folder).shown["cam0001"] == [0, 0, 0, 1, 2]
    before, after = (read_capture(f).sources["cam0001"] for f in (plain, folder))
    before, after = (np.stack(list(source.frames())).astype(float) for source in (before, after))
    for place, true in enumerate([0, 0, 0, 1, 2]):
        assert np.sqrt(((after[place] - before[true]) ** 2).mean()) < LEVELS
    assert np.abs(after[3] - before[3]).max() > 3 * LEVELS  # the nozzle has moved on


def test_dropped_frames_shorten_one_video(plain, tmp_path):
    folder = faulty(tmp_path, dropped=(("cam0003", 2),))
    assert changed(plain, folder) == {"capture/cam0003.aligned.mp4"}
    shown = read_truth(folder).shown["cam0003"]
    assert len(shown) == 3 and shown[0] == 0 and sorted(set(shown)) == shown
    with pytest.raises(ValueError, match=r"cam0003\.aligned\.mp4 .*must have 5 frames as the others have; got 3"):
        read_capture(folder)


def test_wrong_scale_stretches_what_was_calibrated(plain, tmp_path):
    folder = faulty(tmp_path, scale=1.1)
    assert changed(plain, folder) == {"capture/calibration.json", "capture/aruco_path.json"}
    before, after = read_capture(plain), read_capture(folder)
    for a, b in zip(before.cameras, after.cameras, strict=True):
        np.testing.assert_allclose(b.centre, 1.1 * a.centre, atol=1e-12)
        np.testing.assert_array_equal(a.K, b.K)
    np.testing.assert_allclose(poses(folder)[1], 1.1 * poses(plain)[1], rtol=1e-12)
    np.testing.assert_array_equal(poses(folder)[0], poses(plain)[0])


def test_inertia_changes_the_motion_and_not_the_loads(plain, tmp_path):
    folder = faulty(tmp_path, inertia=True)
    names = changed(plain, folder)
    assert "truth/motion.npz" in names and "truth/nozzle.npz" not in names and "truth/cloud.npz" not in names
    assert not any(name.endswith(".json") or "plates" in name for name in names)
    still, ringing = read_truth(plain), read_truth(folder)
    np.testing.assert_array_equal(still.points[0], ringing.points[0])
    assert np.abs(still.points - ringing.points).max() > 1e-3
