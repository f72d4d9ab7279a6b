"""OAK-D cameras through DepthAI 3: what is connected, one pipeline a device, its packets. Only this file knows it."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from types import ModuleType
from typing import Any

from recon.oak.recorder import DeviceLost
from recon.oak.recording import Packet, packet_of
from recon.oak.spec import DeviceSpec, RigSpec, StreamSpec

SEARCH_MS = "500"  # DepthAI's own eleven seconds are for cameras that are still starting
QUEUE_SECONDS = 4  # of packets that wait where the disk is slow


def _depthai() -> ModuleType:
    """DepthAI, with a short search; its notices go the user's way only when they are errors."""
    os.environ.setdefault("DEPTHAI_SEARCH_TIMEOUT", SEARCH_MS)
    os.environ.setdefault("DEPTHAI_LEVEL", "error")
    try:
        import depthai
    except ImportError as error:
        raise ValueError(f"OAK-D cameras must have DepthAI 3 (pip install depthai); got {error}") from None
    return depthai


@dataclass(frozen=True, kw_only=True)
class FoundDevice:
    """A device that is connected and free: its id, where it is connected, and over what."""

    id: str
    name: str
    protocol: str


def list_devices() -> tuple[FoundDevice, ...]:
    """All free OAK devices on USB and on the network, by id; half a second where there are none."""
    dai = _depthai()
    found = [
        FoundDevice(id=d.getDeviceId(), name=d.name, protocol=d.protocol.name.removeprefix("X_LINK_"))
        for d in dai.Device.getAllAvailableDevices()
    ]
    return tuple(sorted(found, key=lambda device: device.id))


def no_device_sentence() -> str:
    """What to say where none is found, and what may be the reason on this machine."""
    hidden = sys.platform == "linux" and not Path("/dev/bus/usb").exists()
    why = "this machine shows no USB at all (a container needs -v /dev/bus/usb:/dev/bus/usb)"
    return "no OAK device is free, neither on USB nor on the network: " + (why if hidden else "plug one into USB 3")


def connect(device_id: str) -> tuple[Any, Any]:
    """Start a device: the device and an empty pipeline on it; once unplugged it is lost, not waited for.

    Raises ValueError when it does not start.
    """
    dai = _depthai()
    with refusals(f"device {device_id}"):
        device = dai.Device(dai.DeviceInfo(device_id))
        device.setMaxReconnectionAttempts(0)
        return device, dai.Pipeline(device)


@contextmanager
def refusals(name: str) -> Iterator[None]:
    """What DepthAI says against a device, a size or a setting, as one ValueError that names the device."""
    try:
        yield
    except RuntimeError as error:
        raise ValueError(f"{name} must start; got {_first_line(error)}") from None


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]


def build_streams(
    pipeline: Any, device: DeviceSpec, rig: RigSpec, lens: Callable[[str], int]
) -> tuple[tuple[str, Any], ...]:
    """Build one device's part of a rig into its empty pipeline: camera -> H.265 encoder -> queue for each stream.

    lens: the lens position at which a socket was calibrated, 0 where its lens is fixed. The queues hold the device
    back instead of losing packets, since a packet that is missing spoils all up to the next keyframe: what is dropped
    is dropped before it is encoded. Returns the queue of each stream by its name.
    """
    dai = _depthai()
    modes, queues = dai.VideoEncoderProperties.RateControlMode, []
    for name, stream in device.named():
        socket = getattr(dai.CameraBoardSocket, stream.socket)
        camera = pipeline.create(dai.node.Camera).build(socket, sensorFps=rig.fps)
        _control(camera.initialControl, device, stream, lens(stream.socket))
        kind = dai.ImgFrame.Type.NV12 if stream.stream == "colour" else dai.ImgFrame.Type.GRAY8
        pictures = camera.requestOutput(stream.size, type=kind, fps=rig.fps)
        encoder = pipeline.create(dai.node.VideoEncoder)
        encoder.build(pictures, frameRate=rig.fps, profile=dai.VideoEncoderProperties.Profile.H265_MAIN)
        encoder.setKeyframeFrequency(rig.keyframe_every)
        encoder.setNumBFrames(0)  # packets come in the order of their pictures
        if rig.bitrate_mbit is None:
            encoder.setRateControlMode(modes.VBR)
            encoder.setQuality(rig.quality)
        else:
            encoder.setRateControlMode(modes.CBR)
            encoder.setBitrateKbps(round(1e3 * rig.bitrate_mbit))
        queues.append((name, encoder.out.createOutputQueue(maxSize=round(QUEUE_SECONDS * rig.fps), blocking=True)))
    return tuple(queues)


def _control(control: Any, device: DeviceSpec, stream: StreamSpec, lens: int) -> None:
    """What the person who wrote the spec has set by hand."""
    modes = _depthai().CameraControl.FrameSyncMode
    if stream.exposure_us is not None:
        control.setManualExposure(stream.exposure_us, stream.iso)
    if stream.white_balance_k is not None:
        control.setManualWhiteBalance(stream.white_balance_k)
    position = (lens or "auto") if stream.focus == "calibrated" else stream.focus
    if position != "auto":
        control.setManualFocus(position)
    if device.frame_sync != "off":
        control.setFrameSyncMode(modes.INPUT if device.frame_sync == "input" else modes.OUTPUT)


@dataclass(frozen=True, kw_only=True)
class OakStream:
    """A running stream's packets as they come out of DepthAI."""

    name: str
    device: str
    pipeline: Any
    queue: Any

    def take(self) -> list[Packet]:
        """All packets that have come since; raises DeviceLost when the device is gone."""
        dai = _depthai()
        try:
            running = self.pipeline.isRunning()
            messages = self.queue.tryGetAll()
        except (RuntimeError, dai.MessageQueue.QueueException) as error:
            raise DeviceLost(_first_line(error)) from None
        if not running and not messages:
            raise DeviceLost("its pipeline has stopped")
        return [_packet(message) for message in messages]


def _packet(message: Any) -> Packet:
    micro = timedelta(microseconds=1)
    return packet_of(
        message.getData().tobytes(),
        time_us=message.getTimestamp() // micro,
        device_time_us=message.getTimestampDevice() // micro,
        sequence=message.getSequenceNum(),
        exposure_us=message.getExposureTime() // micro,
        iso=message.getSensitivity(),
    )
