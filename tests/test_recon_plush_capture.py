"""The PLUSH layout of a recording: by hand from its description, and through our own writer."""

import json
import shutil

import numpy as np
import pytest
from plush_recordings import FRAMES, SIZE, marker_poses, written_to

from recon.images import write_image
from recon.plush.capture import read_capture
from recon.video import VideoFile, write_video


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return written_to(tmp_path_factory.mktemp("plush"))


@pytest.fixture
def plush(written, tmp_path):
    """A copy that a test may damage."""
    shutil.copytree(written[0], tmp_path / "leaf")
    return tmp_path / "leaf"


def test_a_folder_made_by_hand_is_read_as_its_description_says(tmp_path):
    place = tmp_path / "dog" / "capture"
    upright = np.zeros((2, 96, 72, 3), np.uint8)
    upright[:, :32, :24] = [200, 60, 30]
    for name in ("cam0001", "cam0002"):
        lying = np.rot90(upright, k=-1, axes=(1, 2))  # clockwise: the reader turns it back
        write_video(place / f"{name}.aligned.mp4", lying, 40.0)
    entry = {
        "distortion": [0.0] * 12,
        "extrinsic": np.eye(4).tolist(),
        "intrinsic": [[100.0, 0, 35.0], [0, 101.0, 48.0], [0, 0, 1]],
        "resolution_w_h": [72, 96],
    }
    aside = np.eye(4)
    aside[:3, 3] = [-500.0, 0, 0]
    both = {"cam0001": entry, "cam0002": entry | {"extrinsic": aside.tolist()}}
    (place / "calibration.json").write_text(json.dumps(both))
    marker = {"aruco_ids": [164], "rvecs": np.eye(3).tolist(), "tvecs": [10.0, 20.0, 800.0]}
    (place / "aruco_path.json").write_text(json.dumps([None, marker]))
    capture = read_capture(tmp_path / "dog")
    np.testing.assert_array_equal(capture.times, [0, 0.025])
    # 10, 20, 800 mm in the file's world is 0.010, -0.020, -0.800 m in ours, and 35 + 100 * 10 / 800 across
    pixel, depth = capture.camera("cam0001").project(np.array([0.010, -0.020, -0.800]))
    np.testing.assert_allclose([*pixel, depth], [36.25, 48 + 101 * 20 / 800, 0.8], rtol=1e-12)
    np.testing.assert_allclose(capture.camera("cam0002").centre, [0.5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(capture.nozzle.position[1], [0.010, -0.125, -0.800], rtol=1e-12)
    np.testing.assert_array_equal(capture.nozzle.seen, [False, True])
    shown = capture.image("cam0001", 1).astype(float)
    assert shown.shape == (96, 72, 3)
    np.testing.assert_allclose(shown[4:28, 4:20].mean(axis=(0, 1)), [200, 60, 30], atol=3)
    assert shown[40:].mean() < 3 and shown[:, 30:].mean() < 3


def test_everything_written_is_read_back_to_rounding(written):
    folder, scene, cameras = written
    capture = read_capture(folder, test=["cam0003"])
    assert sorted(capture.names) == sorted(camera.name for camera in cameras) and capture.missing == ()
    for camera in cameras:
        got = capture.camera(camera.name)
        for part in ("T_camera_world", "K"):
            np.testing.assert_allclose(getattr(got, part), getattr(camera, part), atol=1e-12)
        np.testing.assert_array_equal(got.distortion, camera.distortion)
        assert (got.size, got.stream) == (camera.size, camera.stream)
        assert got.role == ("test" if camera.name == "cam0003" else "train")
        for frame, sent in enumerate(scene.frames(camera)):
            off = np.abs(capture.image(camera.name, frame).astype(int) - sent)
            assert off.shape == sent.shape and off.mean() < 4  # H.265 and half the colour pixels
    np.testing.assert_allclose(capture.times, np.arange(FRAMES) / 40, atol=1e-15)
    for frame, T in enumerate(marker_poses()):
        assert capture.nozzle.seen[frame] == (T is not None)
        if T is not None:
            expected = T @ [0, 0.105, 0, 1], T @ [0, 0, -1, 0]
            np.testing.assert_allclose(capture.nozzle.position[frame], expected[0][:3], atol=1e-12)
            np.testing.assert_allclose(capture.nozzle.direction[frame], expected[1][:3], atol=1e-12)
    lying = VideoFile(folder / "capture/cam0001.aligned.mp4")
    assert lying.size == SIZE[::-1] and read_capture(folder / "capture").names == capture.names


MISSING = {
    "capture/calibration.json": "the videos can be viewed and the cameras calibrated, but nothing reconstructed",
    "capture/aruco_path.json": "no forces are known; points can be viewed but no material identified",
    "capture/cam0003.aligned.mp4": "cam0003 is left out",
}


@pytest.mark.parametrize("part", MISSING)
def test_missing_part_is_said_with_what_can_still_be_done(plush, part):
    (plush / part).unlink()
    capture = read_capture(plush)
    assert capture.missing == (f"{part} is missing: {MISSING[part]}.",)
    assert len(capture.cameras) == {"calibration.json": 0, "cam0003.aligned.mp4": 4}.get(part.split("/")[1], 5)
    assert capture.image("cam0001", 2).shape == (96, 72, 3)
    assert (capture.nozzle is None) == part.endswith("path.json")


def test_colour_alone_is_enough(plush):
    for side in ("left", "right"):
        (plush / f"capture/cam0002.{side}.aligned.mp4").unlink()
    capture = read_capture(plush)
    assert len(capture.cameras) == 3
    assert capture.missing[-1] == "no left and right videos: the colour ones are enough for a reconstruction."


def test_mattes_and_plates_beside_the_layout_are_read(plush):
    for frame in range(FRAMES):
        write_image(plush / f"capture/mattes/cam0001/{frame:08d}.png", np.full((96, 72), 10 * frame, np.uint8))
    write_image(plush / "capture/plates/cam0002.left.png", np.full((96, 72), 7, np.uint8))
    capture = read_capture(plush)
    assert list(capture.mattes) == ["cam0001"] and capture.matte("cam0001", 3).max() == 30
    assert list(capture.plates) == ["cam0002.left"] and capture.plates["cam0002.left"].shape == (96, 72)
    (plush / "capture/mattes/cam0001/00000002.png").unlink()
    with pytest.raises(ValueError, match="mattes/cam0001 must hold 5 mattes; got 4"):
        read_capture(plush)


def test_cameras_that_do_not_teach_are_chosen_by_name_or_device(written):
    capture = read_capture(written[0], test=["cam0002"], nozzle_only=["cam0003", "cam0002.left"])
    roles = {camera.name: camera.role for camera in capture.cameras}
    left, right = {"cam0002.left": "nozzle"}, {"cam0002.right": "test"}
    assert roles == {"cam0001": "train", "cam0002": "test", "cam0003": "nozzle"} | left | right
    with pytest.raises(ValueError, match=r"cameras chosen must be among the 5 that have videos; got \['cam0009'\]"):
        read_capture(written[0], test=["cam0009"])
