"""From replayed packets to the PLUSH layout: which pictures come together, which way up, with which cameras."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from oak_fakes import COLOUR, GREY, bench, found, number_in, replay, small_rig, steady, still

from recon.cameras import Camera
from recon.oak.aligned import finish_recording, rig_cameras
from recon.oak.eeprom import recorded_cameras
from recon.oak.rig import record_rig
from recon.plush.calibration import write_calibration
from recon.plush.capture import read_capture
from recon.plush.capture_writer import write_markers
from recon.plush.markers import read_markers
from recon.video import VideoFile

COUNT = 20
NAMES = ("cam0001", "cam0001.left", "cam0002", "cam0002.left")


def recorded(folder, *queues, **options):
    spec = small_rig(len(queues) // 2, **options)
    record_rig(spec, folder, find=lambda: found(len(queues) // 2), start=bench(*queues), record=still)
    return folder


def finished(folder, **options):
    return finish_recording(folder, recorded_cameras(folder), rig_calibrated=False, **options)


def numbers(folder, name):
    """The numbers that an aligned video shows once turned upright and back to how the sensor saw it."""
    video = VideoFile(folder / "capture" / f"{name}.aligned.mp4", turned=True, grey="." in name)
    return [number_in(np.rot90(image, -1)) for image in video.frames()]


def test_only_pictures_that_were_taken_together_remain_in_every_video(tmp_path):
    colour, grey = steady(COUNT), steady(COUNT, 10_003_000, jitter_us=(0, 900, -900))
    late = [t + 5 * 25_000 + 4_000 for t in colour]  # this device starts five pictures later
    queues = (
        replay(COLOUR, colour), replay(GREY, grey),
        replay(COLOUR, late, lost=[16, 17, 18, 19]), replay(GREY, late),
    )  # fmt: skip
    done = finished(recorded(tmp_path, *queues))
    # by hand: device 1's picture 5 meets device 2's picture 0, and so on; device 2's last four never came
    first, second = list(range(5, COUNT)), list(range(15))
    shown = {name: numbers(tmp_path, name) for name in NAMES}
    assert shown == {"cam0001": first, "cam0001.left": first, "cam0002": second, "cam0002.left": second}
    assert done.groups.dropped.tolist() == [5, 5, 1, 5]
    assert done.groups.incomplete == 10 and done.groups.spread.max() < 0.0125
    assert done.sentences[0].startswith("15 complete groups of 4 streams")
    capture = read_capture(tmp_path)
    assert [c.name for c in capture.cameras] == list(NAMES) and len(capture.times) == 15
    for camera, known in zip(capture.cameras, recorded_cameras(tmp_path), strict=True):
        np.testing.assert_allclose(camera.T_camera_world, known.T_camera_world, atol=1e-9)
        np.testing.assert_allclose(camera.K, known.K)


def test_groups_file_says_which_picture_came_when(tmp_path):
    times = steady(COUNT)
    seen = [i for i in range(COUNT) if i != 3]  # the grey sensor missed one picture, and counted on
    grey = replay(GREY, [times[i] + 2_000 for i in seen], sequence=seen)
    done = finished(recorded(tmp_path, replay(COLOUR, times), grey))
    rows = list(csv.reader((tmp_path / "recording" / "groups.csv").read_text().splitlines()))
    assert rows[0] == ["time_s", "cam0001_picture", "cam0001_late_ms", "cam0001.left_picture", "cam0001.left_late_ms"]
    assert rows[1] == ["0.000000", "0", "-1.000", "0", "1.000"]
    assert rows[4] == ["0.100000", "4", "-1.000", "3", "1.000"]
    facts = json.loads((tmp_path / "recording" / "groups.json").read_text())
    assert facts["complete"] == COUNT - 1 and facts["streams"]["cam0001.left"]["dropped_by_camera"] == 1
    assert facts["streams"]["cam0001"]["left_out"] == 1 and not facts["rig_calibrated"]
    np.testing.assert_allclose(done.clocks.offset, [-1e-3, 1e-3], atol=1e-9)
    np.testing.assert_allclose(done.clocks.drift, 0, atol=1e-9)


@pytest.mark.parametrize("turned_deg", [0, 90, 180, 270])
def test_pictures_and_cameras_are_turned_alike(tmp_path, turned_deg):
    """The bright corner that the sensor saw is where the turned camera says that this pixel is."""
    times = steady(8)
    folder = recorded(tmp_path, replay(COLOUR, times), replay(GREY, times), turned_deg=turned_deg)
    cameras = {c.name: c for c in recorded_cameras(folder)}
    finished(folder)
    for name, size in (("cam0001", COLOUR), ("cam0001.left", GREY)):
        video = VideoFile(tmp_path / "capture" / f"{name}.aligned.mp4", turned=True, grey="." in name)
        assert video.size == cameras[name].size
        upright = list(video.frames())
        assert [number_in(np.rot90(image, -turned_deg // 90)) for image in upright] == list(range(8))
        middle = np.array([size[0] / 2, size[1] / 2])  # the principal point of a lying camera of the fake EEPROM
        quarter = {0: middle, 90: [middle[1], size[0] - 1 - middle[0]], 180: np.array(size) - 1 - middle,
                   270: [size[1] - 1 - middle[1], middle[0]]}  # fmt: skip
        np.testing.assert_allclose(cameras[name].K[:2, 2], quarter[turned_deg])


def test_finishing_again_gives_the_same_and_may_leave_a_camera_out(tmp_path):
    times = steady(COUNT)
    folder = recorded(tmp_path, *(replay(size, times) for size in (COLOUR, GREY, COLOUR, GREY)))
    first = finished(folder)
    kept = {name: numbers(folder, name) for name in NAMES}
    second = finished(folder)
    np.testing.assert_array_equal(first.groups.index, second.groups.index)
    assert {name: numbers(folder, name) for name in NAMES} == kept
    assert not list((folder / "recording").glob(".*"))  # nothing but what was recorded stays there
    poses = [np.eye(4) if i % 2 else None for i in range(len(first.groups.index))]
    write_markers(folder / "capture/aruco_path.json", poses)
    finished(folder)  # a track of the same groups stays, one of others would be wrong
    assert sum(pose is not None for pose in read_markers(folder / "capture/aruco_path.json")) == len(poses) // 2
    said = finished(folder, without=["cam0001"]).sentences
    assert "aruco_path.json belonged to other groups and was emptied: veo track." in said
    assert not any(pose is not None for pose in read_markers(folder / "capture/aruco_path.json"))
    left = sorted(p.name for p in (folder / "capture").glob("*.mp4"))
    assert left == ["cam0002.aligned.mp4", "cam0002.left.aligned.mp4"]


def test_pictures_behind_a_missing_packet_are_left_out_up_to_the_next_keyframe(tmp_path):
    times = steady(COUNT)
    folder = recorded(tmp_path, replay(COLOUR, times, lost=[3]), replay(GREY, times))
    done = finished(folder)
    # keyframes are 0, 8 and 16: without packet 3, pictures 4 to 7 cannot be decoded
    whole = [i for i in range(COUNT) if i not in range(3, 8)]
    assert numbers(folder, "cam0001") == numbers(folder, "cam0001.left") == whole
    assert done.sentences[1] == "Pictures that cannot be decoded were left out: 4 of cam0001."
    rows = (folder / "recording" / "groups.csv").read_text().splitlines()
    assert rows[4].split(",")[1] == "7" and rows[4].split(",")[3] == "8"  # lines of the times files: packet 3 has none
    np.testing.assert_array_equal(finished(folder).groups.index, done.groups.index)


def test_camera_that_was_lost_early_can_be_left_out(tmp_path):
    times = steady(60)
    lost = RuntimeError("unplugged")
    queues = (replay(COLOUR, times[:4], end=lost), replay(GREY, times[:4], end=lost))
    folder = recorded(tmp_path, *queues, replay(COLOUR, times), replay(GREY, times))
    done = finished(folder)
    assert len(done.groups.index) == 4 and done.groups.incomplete == 56
    assert done.sentences[1] == "cam0001 ended up to 1.4 s before the others: leave it out to pair the rest."
    assert len(finished(folder, without=["cam0001"]).groups.index) == 60
    assert numbers(folder, "cam0002") == list(range(60))


def test_given_rig_calibration_is_written_unchanged(tmp_path):
    times = steady(8)
    folder = recorded(tmp_path, replay(COLOUR, times), replay(GREY, times))
    T = np.eye(4)
    T[:3, 3] = 0.1, 0.2, 0.3
    cameras = [replace(camera, T_camera_world=T) for camera in any_cameras()]
    path = write_calibration(tmp_path / "calibration.json", cameras)
    done = finish_recording(folder, rig_cameras(folder, path), rig_calibrated=True)
    assert (folder / "capture" / "calibration.json").read_text() == path.read_text()
    assert len(done.sentences) == 1
    with pytest.raises(ValueError, match=r"calibration\.json \(cam0001\) resolution_w_h must be 64 x 96"):
        rig_cameras(folder, write_calibration(path, [replace(cameras[0], size=(640, 480))]))


def any_cameras():
    """Cameras of the small rig's first device, standing anywhere."""
    names = {"cam0001": ("colour", COLOUR), "cam0001.left": ("left", GREY)}
    K = np.array([[80.0, 0, 30], [0, 80, 40], [0, 0, 1]])
    return [Camera(name=n, K=K, T_camera_world=np.eye(4), size=size[::-1], stream=s) for n, (s, size) in names.items()]


def test_what_cannot_be_finished_is_one_sentence(tmp_path):
    times = steady(COUNT)
    far = [t + 8_000 for t in times]
    farther = [t + 16_000 for t in times]
    streams = ((COLOUR, times), (GREY, far), (COLOUR, farther), (GREY, times))
    folder = recorded(tmp_path / "free", *(replay(size, when) for size, when in streams))
    with pytest.raises(ValueError, match=r"all cameras within 12\.5 ms: with sync_frames 0\.64 about 20 would be"):
        finished(folder)
    with pytest.raises(ValueError, match="without must name cameras of the recording; got cam0009"):
        finished(folder, without=["cam0009"])
    with pytest.raises(ValueError, match="without must leave a camera"):
        finished(folder, without=["cam0001", "cam0002"])
    with pytest.raises(
        ValueError, match=r"calibration must hold a camera for every stream; got none for cam0001\.left"
    ):
        finish_recording(folder, [c for c in recorded_cameras(folder) if c.name != "cam0001.left"], rig_calibrated=True)
    (folder / "recording" / "cam0002.eeprom.json").unlink()
    with pytest.raises(ValueError, match="cam0002 must have a calibration in its EEPROM, or the rig's"):
        finished(folder)
    (folder / "recording" / "cam0001.times.csv").unlink()
    with pytest.raises(ValueError, match="cam0001 must have been recorded"):
        finish_recording(folder, any_cameras(), rig_calibrated=True, without=["cam0002"])


def test_times_that_go_backwards_are_named(tmp_path):
    times = steady(8)
    times[5] = times[4] - 1000
    folder = recorded(tmp_path, replay(COLOUR, times), replay(GREY, steady(8)))
    words = r"cam0001 times must increase from picture to picture; got 10\.099000 s after 10\.100000 s at picture 5"
    with pytest.raises(ValueError, match=words):
        finished(folder)


def test_layout_that_cannot_be_written_keeps_the_recording(tmp_path):
    times = steady(8)
    folder = recorded(tmp_path, replay(COLOUR, times), replay(GREY, times))
    (folder / "capture").write_text("in the way")
    with pytest.raises(OSError, match=r"cannot be finished \(File exists\); what was recorded is kept: finish it"):
        finished(folder)
    (folder / "capture").unlink()
    assert len(finished(folder).groups.index) == 8
