"""OAK-D devices that replay encoded video: what DepthAI would give, with the times and the faults that a test wants."""

from collections.abc import Callable, Sequence
from datetime import timedelta
from functools import cache, partial
from types import SimpleNamespace

import av
import depthai as dai
import numpy as np

from recon.oak.devices import FoundDevice
from recon.oak.recorder import record_streams
from recon.oak.spec import DeviceSpec, RigSpec, StreamSpec
from recon.video import ONE_THREAD

BITS, BLOCK = 6, 16  # a picture's number, written in black and white blocks
COLOUR, GREY = (96, 64), (96, 72)
PERIOD_US = 25_000


def small_rig(devices: int, turned_deg: int = 90, **options: object) -> RigSpec:
    """Devices with a colour stream and a left grey one, in sizes that encode in no time."""
    streams = (
        StreamSpec(stream="colour", socket="CAM_A", size=COLOUR),
        StreamSpec(stream="left", socket="CAM_B", size=GREY),
    )
    names = [f"cam{i + 1:04d}" for i in range(devices)]
    return RigSpec(devices=tuple(DeviceSpec(name=n, streams=streams, turned_deg=turned_deg) for n in names), **options)


def numbered(number: int, size: tuple[int, int]) -> np.ndarray:
    """A picture (height, width) uint8, as the sensor sees it, that shows its number from the top left corner on."""
    image = np.full(size[::-1], 128, np.uint8)
    for bit in range(BITS):
        image[:BLOCK, bit * BLOCK : (bit + 1) * BLOCK] = 230 if number >> bit & 1 else 20
    return image


def number_in(image: np.ndarray) -> int:
    """The number that a picture as the sensor saw it shows."""
    grey = image if image.ndim == 2 else image.mean(axis=2)
    middle = [grey[BLOCK // 2, bit * BLOCK + BLOCK // 2] for bit in range(BITS)]
    return sum((value > 128) << bit for bit, value in enumerate(middle))


@cache
def clip(size: tuple[int, int], count: int, keyframe_every: int = 8) -> tuple[bytes, ...]:
    """H.265 packets of numbered pictures, one each, as the device's encoder makes them: headers with every keyframe."""
    coder = av.CodecContext.create("libx265", "w")
    coder.width, coder.height, coder.pix_fmt, coder.framerate = *size, "yuv420p", 40
    coder.time_base = 1 / coder.framerate
    fixed = f"bframes=0:repeat-headers=1:scenecut=0:open-gop=0:log-level=none:keyint={keyframe_every}"
    coder.options = {"preset": "ultrafast", "x265-params": f"{fixed}:min-keyint={keyframe_every}:{ONE_THREAD}"}
    packets = []
    for number in range(count):
        frame = av.VideoFrame.from_ndarray(numbered(number, size), format="gray").reformat(format="yuv420p")
        frame.pts = number
        packets += coder.encode(frame)
    return tuple(bytes(p) for p in [*packets, *coder.encode()])


def message(data: bytes, time_us: int, sequence: int) -> dai.EncodedFrame:
    """DepthAI's own message, filled."""
    frame = dai.EncodedFrame()
    frame.setData(data)
    frame.setTimestamp(timedelta(microseconds=time_us))
    frame.setTimestampDevice(timedelta(microseconds=time_us // 2))
    frame.setSequenceNum(sequence)
    return frame


class Recorder:
    """Keeps every call; each returns the recorder itself."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, tuple, dict]] = []

    def __getattr__(self, name: str) -> Callable[..., "Recorder"]:
        def call(*args: object, **named: object) -> "Recorder":
            self.calls.append((name, args, named))
            return self

        return call

    def last(self, name: str) -> tuple[tuple, dict]:
        """Arguments of the last call of that name."""
        return next((args, named) for n, args, named in reversed(self.calls) if n == name)


class Node(Recorder):
    """A node of the pipeline; `link` is what was requested of it."""

    def __init__(self, kind: type, pipeline: "Pipeline") -> None:
        super().__init__()
        self.kind, self.pipeline = kind, pipeline
        self.initialControl = Recorder()
        self.out = self

    def createOutputQueue(self, maxSize: int, blocking: bool) -> "Queue":
        self.calls.append(("createOutputQueue", (), {"maxSize": maxSize, "blocking": blocking}))
        return self.pipeline.replays.pop(0)


class Queue:
    """Gives one batch of messages a call, then nothing, or the exception that ends it."""

    def __init__(self, batches: Sequence[Sequence[dai.EncodedFrame]], end: BaseException | None) -> None:
        self.batches, self.end = list(batches), end

    def tryGetAll(self) -> Sequence[dai.EncodedFrame]:
        if not self.batches and self.end is not None:
            raise self.end
        return self.batches.pop(0) if self.batches else []


class Pipeline:
    """A pipeline that records what is built and replays the given queues, in the order in which they are asked for."""

    def __init__(self, replays: Sequence[Queue] = ()) -> None:
        self.replays, self.nodes, self.running = list(replays), [], False

    def create(self, kind: type) -> Node:
        self.nodes.append(Node(kind, self))
        return self.nodes[-1]

    def start(self) -> None:
        self.running = True

    def stop(self) -> None:
        self.running = False

    def isRunning(self) -> bool:
        return self.running


def sensor(socket: str, size: tuple[int, int], fastest: float = 60.0, focuses: bool = False) -> SimpleNamespace:
    """What a device says of one of its sensors."""
    mode = SimpleNamespace(width=size[0], height=size[1], maxFps=fastest)
    place = getattr(dai.CameraBoardSocket, socket)
    return SimpleNamespace(
        socket=place, width=size[0], height=size[1], sensorName="IMX378", hasAutofocus=focuses, configs=[mode]
    )


def calibration(sizes: dict[str, tuple[int, int]]) -> dai.CalibrationHandler:
    """An EEPROM with plain lenses, 7.5 cm from one socket to the next, and lens position 120."""
    handler, last = dai.CalibrationHandler(), None
    for name, (width, height) in sizes.items():
        socket = getattr(dai.CameraBoardSocket, name)
        handler.setCameraIntrinsics(socket, [[90, 0, width / 2], [0, 90, height / 2], [0, 0, 1]], width, height)
        handler.setDistortionCoefficients(socket, [0.0] * 14)
        handler.setLensPosition(socket, 120)
        if last is not None:
            handler.setCameraExtrinsics(last, socket, np.eye(3).tolist(), [-7.5, 0, 0])
        last = socket
    return handler


class Device:
    """A device with the small rig's two sensors."""

    def __init__(self, handler: dai.CalibrationHandler | None = None) -> None:
        self.closed = False
        self.handler = handler or calibration({"CAM_A": COLOUR, "CAM_B": GREY})
        self.sensors = [sensor("CAM_A", COLOUR, focuses=True), sensor("CAM_B", GREY)]

    def getConnectedCameraFeatures(self) -> list[SimpleNamespace]:
        return self.sensors

    def readCalibration(self) -> dai.CalibrationHandler:
        return self.handler

    def close(self) -> None:
        self.closed = True


def found(count: int) -> tuple[FoundDevice, ...]:
    return tuple(FoundDevice(id=f"1844{i:04d}", name=f"1.{i}", protocol="USB_VSC") for i in range(count))


def replay(size: tuple[int, int], times_us: Sequence[int], *, lost: Sequence[int] = (), sequence: Sequence[int] = (),
           end: BaseException | None = None, each: int = 3) -> Queue:  # fmt: skip
    """A queue that gives the packets of a clip at these times, some never; then nothing, or the given exception.

    sequence: the sensor's count for each packet where it is not 0, 1, 2, ...; each: messages a call.
    """
    packets, numbers = clip(size, len(times_us)), sequence or range(len(times_us))
    messages = [message(*m) for i, m in enumerate(zip(packets, times_us, numbers, strict=True)) if i not in lost]
    batches = [messages[i : i + each] for i in range(0, len(messages), each)]
    return Queue(batches, end)


def steady(count: int, start_us: int = 10_000_000, jitter_us: Sequence[int] = (0,)) -> list[int]:
    """Times of a camera at 40 fps [us]."""
    return [start_us + i * PERIOD_US + jitter_us[i % len(jitter_us)] for i in range(count)]


still = partial(record_streams, clock=lambda: 0.0, sleep=lambda _: None)  # no camera is ever called silent


def bench(*queues: Queue) -> Callable[[str], tuple[Device, Pipeline]]:
    """Starts devices, in order, whose colour and left streams are the next two queues; Ctrl-C follows the last one."""
    left = list(queues)
    left[-1].end = left[-1].end or KeyboardInterrupt()
    return lambda _: (Device(), Pipeline([left.pop(0), left.pop(0)]))
