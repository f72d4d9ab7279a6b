"""A rig of devices: which are taken, which are refused, and what is recorded when one fails."""

from dataclasses import replace

import depthai as dai
import pytest
from oak_fakes import COLOUR, GREY, Device, Pipeline, Queue, bench, found, replay, sensor, small_rig, steady, still

from recon.oak.recording import read_stream
from recon.oak.rig import assigned, check_sensors, record_rig
from recon.oak.spec import default_rig


def test_devices_are_taken_by_id_or_place_and_the_rest_in_order():
    rig = default_rig(3)
    rig = replace(rig, devices=(rig.devices[0], replace(rig.devices[1], device="1.0"), rig.devices[2]))
    assert [d.device for d in assigned(rig, found(4)).devices] == ["18440001", "18440000", "18440002"]


def test_too_few_devices_are_one_sentence():
    with pytest.raises(ValueError, match=r"^no OAK device is free"):
        assigned(default_rig(1), ())
    with pytest.raises(ValueError, match=r"rig must find its 3 devices free; got 2$"):
        assigned(default_rig(3), found(2))
    with pytest.raises(ValueError, match="rig must find its 1 devices free; got 2, and 1844XX is not among them"):
        assigned(default_rig(["1844XX"]), found(2))


def test_sensor_that_cannot_deliver_is_one_sentence():
    device = replace(default_rig(1).devices[0], device="18440000")
    grey = [sensor("CAM_B", (1280, 800), 120), sensor("CAM_C", (1280, 800), 120)]
    check_sensors(device, [sensor("CAM_A", (4056, 3040)), *grey], 40)
    with pytest.raises(ValueError, match="cam0001 socket must be among 18440000's CAM_B, CAM_C; got CAM_A"):
        check_sensors(device, grey, 40)
    with pytest.raises(ValueError, match="cam0001 size must fit the IMX378's 1280 x 800 pixels; got 1920 x 1080"):
        check_sensors(device, [sensor("CAM_A", (1280, 800)), *grey], 40)
    with pytest.raises(ValueError, match="cam0001 fps must be at most 30 for 1920 x 1080 pixels; got 40"):
        check_sensors(device, [sensor("CAM_A", (4056, 3040), 30), *grey], 40)


def test_device_that_is_unplugged_while_recording_keeps_what_it_sent(tmp_path):
    times = steady(12)
    error = RuntimeError("Communication exception - possible device error. Original message 'X_LINK_ERROR'\nstack")
    lost = replay(COLOUR, times[:6], end=error), replay(GREY, times[:6], end=dai.MessageQueue.QueueException("closed"))
    start = bench(*lost, replay(COLOUR, times), replay(GREY, times))
    done = record_rig(small_rig(2), tmp_path, find=lambda: found(2), start=start, record=still)
    assert len(done.faults) == 1 and done.faults[0].startswith("cam0001 was lost (Communication exception")
    assert "stack" not in done.faults[0] and done.faults[0].endswith("what it sent until then is kept.")
    held = {s.name: len(read_stream(tmp_path / "recording", s.name).time) for s in done.streams}
    assert held == {"cam0001": 6, "cam0001.left": 6, "cam0002": 12, "cam0002.left": 12}


def test_pipeline_that_stops_by_itself_is_a_lost_device(tmp_path):
    device, pipeline = Device(), Pipeline([replay(COLOUR, steady(6)), replay(GREY, steady(6))])
    pipeline.start = lambda: None  # never running
    done = record_rig(small_rig(1), tmp_path, find=lambda: found(1), start=lambda _: (device, pipeline), record=still)
    assert done.faults == ("cam0001 was lost (its pipeline has stopped); what it sent until then is kept.",)
    assert [s.frames for s in done.streams] == [6, 6] and device.closed


def refused(folder, rig, devices, pipelines):
    """The sentence with which a rig of these devices is refused; nothing was written and all of them are closed."""
    pairs = iter(zip(devices, pipelines, strict=True))
    with pytest.raises(ValueError, match="must") as caught:
        record_rig(rig, folder, find=lambda: found(2), start=lambda _: next(pairs), record=still)
    assert not (folder / "recording" / "rig.json").exists()
    assert all(d.closed for d in devices) and not any(p.running for p in pipelines)
    return str(caught.value)


def test_rig_that_cannot_start_leaves_nothing_behind(tmp_path):
    silent = [Pipeline([Queue([], None)] * 2) for _ in range(2)]
    devices = [Device(), Device()]
    devices[1].sensors = devices[1].sensors[:1]
    sentence = "cam0002.left socket must be among 18440001's CAM_A; got CAM_B"
    assert refused(tmp_path, small_rig(2), devices, silent) == sentence

    def broken():
        raise RuntimeError("Camera: resolution is not supported\nstack trace")

    silent = [Pipeline([Queue([], None)] * 2) for _ in range(2)]
    silent[1].start = broken
    sentence = "cam0002 must start; got Camera: resolution is not supported"
    assert refused(tmp_path, small_rig(2), [Device(), Device()], silent) == sentence
    (tmp_path / "recording").mkdir()
    assert refused(tmp_path, small_rig(2), [], []).startswith("out must be a folder that holds no recording yet; got ")


def test_device_without_calibration_is_recorded_all_the_same(tmp_path):
    times = steady(6)
    device = Device(dai.CalibrationHandler())
    pipeline = Pipeline([replay(COLOUR, times), replay(GREY, times, end=KeyboardInterrupt())])
    done = record_rig(small_rig(1), tmp_path, find=lambda: found(1), start=lambda _: (device, pipeline), record=still)
    assert [s.frames for s in done.streams] == [6, 6]
    assert not (tmp_path / "recording" / "cam0001.eeprom.json").exists()


def test_calibrated_lens_position_comes_from_the_eeprom(tmp_path):
    pipeline = Pipeline([Queue([], KeyboardInterrupt()), Queue([], None)])
    record_rig(small_rig(1), tmp_path, find=lambda: found(1), start=lambda _: (Device(), pipeline), record=still)
    assert pipeline.nodes[0].initialControl.calls == [("setManualFocus", (120,), {})]  # this sensor can focus
    assert pipeline.nodes[2].initialControl.calls == []  # this one cannot
