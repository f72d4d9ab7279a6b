"""What is built into a device's pipeline, against DepthAI's own signatures."""

import re
from dataclasses import replace
from pathlib import Path

import depthai as dai
import pytest
from oak_fakes import Pipeline, Queue

from recon.oak import devices
from recon.oak.devices import build_streams, list_devices, no_device_sentence
from recon.oak.spec import default_rig

PLUSH = default_rig(1)


def built(rig=PLUSH, lens=0, **changes):
    """The nodes of a device's pipeline, after the device's first stream was changed."""
    device = rig.devices[0]
    streams = (replace(device.streams[0], **changes), *device.streams[1:])
    device = replace(device, streams=streams)
    pipeline = Pipeline([Queue([], None) for _ in streams])
    queues = build_streams(pipeline, device, rig, lambda _: lens)
    return pipeline.nodes, queues


def test_each_stream_is_a_camera_an_encoder_and_a_queue_that_loses_nothing():
    nodes, queues = built()
    cameras, encoders = nodes[::2], nodes[1::2]
    assert [name for name, _ in queues] == ["cam0001", "cam0001.left", "cam0001.right"]
    assert {n.kind for n in cameras} == {dai.node.Camera} and {n.kind for n in encoders} == {dai.node.VideoEncoder}
    sockets = [n.last("build")[0][0] for n in cameras]
    assert sockets == [dai.CameraBoardSocket.CAM_A, dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C]
    kinds = [dai.ImgFrame.Type.NV12, dai.ImgFrame.Type.GRAY8, dai.ImgFrame.Type.GRAY8]
    requests = [n.last("requestOutput") for n in cameras]
    assert requests == [((size,), {"type": kind, "fps": 40.0}) for size, kind in
                        zip([(1920, 1080), (1280, 800), (1280, 800)], kinds, strict=True)]  # fmt: skip
    for camera, encoder in zip(cameras, encoders, strict=True):
        profile = dai.VideoEncoderProperties.Profile.H265_MAIN
        assert encoder.last("build") == ((camera,), {"frameRate": 40.0, "profile": profile})
        assert encoder.last("setNumBFrames") == ((0,), {}) and encoder.last("setKeyframeFrequency") == ((40,), {})
        assert encoder.last("createOutputQueue") == ((), {"maxSize": 160, "blocking": True})
        assert encoder.last("setBitrateKbps") == ((15_000,), {}) and camera.initialControl.calls == []


def test_quality_and_what_is_set_by_hand_reach_the_device():
    by_hand = {"exposure_us": 4000, "iso": 400, "focus": 0, "white_balance_k": 5600}
    rig = replace(PLUSH, bitrate_mbit=None, quality=77, devices=(replace(PLUSH.devices[0], frame_sync="input"),))
    nodes, _ = built(rig, lens=120, **by_hand)
    assert nodes[1].last("setQuality") == ((77,), {})
    assert nodes[1].last("setRateControlMode") == ((dai.VideoEncoderProperties.RateControlMode.VBR,), {})
    assert nodes[0].initialControl.calls == [
        ("setManualExposure", (4000, 400), {}),
        ("setManualWhiteBalance", (5600,), {}),
        ("setManualFocus", (0,), {}),
        ("setFrameSyncMode", (dai.CameraControl.FrameSyncMode.INPUT,), {}),
    ]


@pytest.mark.parametrize(("focus", "lens", "calls"), [
    ("calibrated", 120, [("setManualFocus", (120,), {})]), ("calibrated", 0, []), ("auto", 120, []),
])  # fmt: skip
def test_lens_stays_where_it_was_calibrated_unless_asked_otherwise(focus, lens, calls):
    nodes, _ = built(lens=lens, focus=focus)
    assert nodes[0].initialControl.calls == calls


def test_every_call_is_one_that_depthai_knows():
    """Names of methods and of their arguments, read from the library's own signatures."""
    rig = replace(PLUSH, devices=(replace(PLUSH.devices[0], frame_sync="output"),))
    by_hand = {"exposure_us": 4000, "iso": 400, "focus": 1, "white_balance_k": 5600}
    nodes = built(rig, **by_hand)[0] + built(replace(PLUSH, bitrate_mbit=None))[0]
    for kind, calls in [(n.kind, n.calls) for n in nodes] + [
        (dai.CameraControl, n.initialControl.calls) for n in nodes
    ]:
        for name, _, named in calls:
            owner = dai.Node.Output if name == "createOutputQueue" else kind
            signature = getattr(owner, name).__doc__
            assert all(re.search(rf"\b{key}: ", signature) for key in named), f"{owner.__name__}.{name}"
    for owner, names in {
        dai.Pipeline: ("create", "start", "stop", "isRunning"),
        dai.MessageQueue: ("tryGetAll", "QueueException"),
        dai.Device: ("close", "getConnectedCameraFeatures", "readCalibration", "setMaxReconnectionAttempts"),
        dai.CameraFeatures: ("socket", "width", "height", "sensorName", "hasAutofocus", "configs"),
        dai.EncodedFrame: ("getData", "getTimestamp", "getTimestampDevice", "getSequenceNum", "getExposureTime"),
    }.items():
        assert all(hasattr(owner, name) for name in names)


def test_listing_needs_no_device_and_says_what_may_be_wrong():
    assert isinstance(list_devices(), tuple)
    assert no_device_sentence().startswith("no OAK device is free, neither on USB nor on the network: ")


def test_only_one_file_knows_depthai():
    root = Path(devices.__file__).parent.parent.parent
    files = [p for package in ("sim", "recon", "veo_ti") for p in (root / package).rglob("*.py")]
    knowing = {p.name for p in files if re.search(r"^\s*(import|from) depthai", p.read_text(encoding="utf-8"), re.M)}
    assert knowing - {"doctor.py"} == {"devices.py"}  # the doctor asks a process of its own
