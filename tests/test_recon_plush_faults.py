"""What is wrong with a recording in the PLUSH layout: one sentence naming file and camera, or left out and said."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from plush_recordings import SIZE, rig, written_to

from recon.plush.capture import read_capture
from recon.plush.capture_writer import write_capture
from recon.video import write_video


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return written_to(tmp_path_factory.mktemp("plush"))


@pytest.fixture
def plush(written, tmp_path):
    """A copy that a test may damage."""
    shutil.copytree(written[0], tmp_path / "leaf")
    return tmp_path / "leaf"


def truncate(plush):
    path = plush / "capture/cam0003.aligned.mp4"
    path.write_bytes(path.read_bytes()[:2000])


def shorten(plush):
    write_video(plush / "capture/cam0003.aligned.mp4", np.full((4, 72, 96, 3), 90, np.uint8), 40.0)


def slow_down(plush):
    write_video(plush / "capture/cam0003.aligned.mp4", np.full((5, 72, 96, 3), 90, np.uint8), 20.0)


def recalibrate(change):
    def changed(plush):
        path = plush / "capture/calibration.json"
        entries = json.loads(path.read_text())
        change(entries)
        path.write_text(json.dumps(entries))

    return changed


def in_metres(entries):
    for entry in entries.values():
        for row in entry["extrinsic"][:3]:
            row[3] /= 1000


def other_marker(plush):
    path = plush / "capture/aruco_path.json"
    path.write_text(path.read_text().replace("164", "7"))


LYING = [[110, 0, 47.0], [0, 111, 36.0], [0, 0, 1]]
FAULTS = {
    "truncated": (truncate, r"cam0003\.aligned\.mp4 \(cam0003\) must be a complete video"),
    "frames": (shorten, r"cam0003\.aligned\.mp4 \(cam0003\) must have 5 frames as the others have; got 4"),
    "rate": (slow_down, r"cam0003\.aligned\.mp4 \(cam0003\) must have 40 frames a second as the others have; got 20"),
    "uncalibrated": (
        recalibrate(lambda entries: entries.pop("cam0003")),
        r"calibration\.json must hold every camera, also cam0003 of cam0003\.aligned\.mp4",
    ),
    "mirrored": (
        recalibrate(lambda entries: entries["cam0003"]["extrinsic"][0].__setitem__(0, 5.0)),
        r"calibration\.json: cam0003 extrinsic must hold a rotation and a shift",
    ),
    "size": (
        recalibrate(lambda entries: entries["cam0003"].update(resolution_w_h=[640, 480])),
        r"calibration\.json \(cam0003\) resolution_w_h must be 72 x 96 pixels as the upright video; got \(640, 480\)",
    ),
    "lying": (
        recalibrate(lambda entries: entries["cam0003"].update(intrinsic=LYING)),
        r"calibration\.json \(cam0003\) intrinsic must describe the upright picture of 72 x 96 pixels",
    ),
    "metres": (
        recalibrate(in_metres),
        r"calibration\.json \(cam000\d[a-z.]*\) extrinsic must be in millimetres; got [\d.]+ from cam0001 to cam000",
    ),
    "marker": (other_marker, r"aruco_path\.json must be .*; got aruco_ids must be \[164\], the nozzle's marker; got"),
}


@pytest.mark.parametrize("case", FAULTS)
def test_fault_raises_or_is_left_out_and_said(plush, case):
    damage, words = FAULTS[case]
    damage(plush)
    with pytest.raises(ValueError, match=words):
        read_capture(plush)
    capture = read_capture(plush, strict=False)
    assert len(capture.missing) == 1 and capture.image("cam0001", 0).shape == (96, 72, 3)
    left_out = case not in ("metres", "marker")
    assert ("cam0003" in [camera.name for camera in capture.cameras]) != left_out


def test_size_in_either_order_is_understood(plush):
    recalibrate(lambda entries: entries["cam0003"].update(resolution_w_h=list(SIZE[::-1])))(plush)
    assert read_capture(plush).camera("cam0003").size == SIZE


def test_nothing_to_read_is_one_sentence(tmp_path):
    with pytest.raises(ValueError, match=r"input must hold videos capture/cam0001\.aligned\.mp4"):
        read_capture(tmp_path)
    (tmp_path / "cam0001.aligned.mp4").write_text("x")
    with pytest.raises(ValueError, match=r"input must hold a video that can be read; got cam0001"):
        read_capture(tmp_path, strict=False)


def test_what_the_layout_cannot_hold_is_refused(tmp_path):
    tilted = replace(rig()[0], distortion=np.concatenate([np.zeros(12), [0.01, 0]]))
    with pytest.raises(ValueError, match="cam0001 distortion must have no tilted sensor in the PLUSH layout"):
        write_capture(tmp_path, [tilted], 40.0, lambda name: [], [])
    with pytest.raises(ValueError, match="marker pose of frame 1 must hold a rotation and a shift"):
        write_capture(tmp_path, rig()[:1], 40.0, lambda name: [], [None, 2 * np.eye(4)])
    lying = [np.zeros((72, 96, 3), np.uint8)]
    with pytest.raises(ValueError, match=r"cam0001 frames must be 72 x 96 pixels; got \(96, 72\)"):
        write_capture(tmp_path, rig()[:1], 40.0, lambda name: lying, [])
