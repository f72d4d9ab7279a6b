"""What a rig of OAK-D cameras should record: a validated description that a person keeps as a JSON file."""

import re
from collections.abc import Sequence
from dataclasses import MISSING, asdict, dataclass, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import get_args

from recon.cameras import ROLES, STREAMS
from recon.files import read_json, write_json
from sim.checks import require

SOCKETS = tuple(f"CAM_{letter}" for letter in "ABCDEFGHIJ")
SYNCS = ("off", "input", "output")
FOCUS = ("auto", "calibrated")
CAMERA_NAME = r"cam\d{4}"  # the PLUSH layout's names
MOST_DEVICES = 19  # of the PLUSH rig
_SMALLEST, _LARGEST = 64, 4096  # [px], of the encoders
_PIXEL_RATE = 248e6  # [px/s], what one RVC2 device encodes in H.265, over all its streams
_STREAMS = 3  # as many does it encode at once
WORDS = {str: "a text", int: "a whole number", float: "a number", NoneType: "null"}


@dataclass(frozen=True, kw_only=True)
class StreamSpec:
    """One sensor of a device: its socket, the size to record [px], and what is set by hand; None leaves it automatic.

    focus: "calibrated" is the lens position at which the device was calibrated, "auto" changes the intrinsics while
    recording, a number is a lens position 0..255. Sizes are those that the H.265 encoder takes.
    """

    stream: str
    socket: str
    size: tuple[int, int]  # width, height [px] as the sensor delivers them
    exposure_us: int | None = None
    iso: int | None = None
    focus: str | int = "calibrated"
    white_balance_k: int | None = None

    def __post_init__(self) -> None:
        require(self.stream in STREAMS, "stream", f"be one of {STREAMS}", repr(self.stream))
        name = f"{self.stream} "
        require(self.socket in SOCKETS, f"{name}socket", f"be one of {', '.join(SOCKETS)}", repr(self.socket))
        size = self.size if isinstance(self.size, Sequence) and len(self.size) == 2 else (0, 0)
        steps = zip(size, (32, 8), strict=True)
        whole = all(isinstance(n, int) and _SMALLEST <= n <= _LARGEST and n % step == 0 for n, step in steps)
        rule = f"be a width in steps of 32 and a height in steps of 8, {_SMALLEST} to {_LARGEST} pixels"
        require(whole, f"{name}size", rule, self.size)
        object.__setattr__(self, "size", tuple(size))
        both = (self.exposure_us is None) == (self.iso is None)
        require(both, f"{name}exposure_us and iso", "be given together", f"{self.exposure_us} and {self.iso}")
        for key, low, high in (("exposure_us", 1, 1_000_000), ("iso", 100, 1600), ("white_balance_k", 1000, 12000)):
            value = getattr(self, key)
            require(value is None or low <= value <= high, f"{name}{key}", f"lie between {low} and {high}", value)
        known = self.focus in FOCUS or (isinstance(self.focus, int) and 0 <= self.focus <= 255)
        require(known, f"{name}focus", f"be one of {FOCUS} or a lens position 0 to 255", repr(self.focus))


@dataclass(frozen=True, kw_only=True)
class DeviceSpec:
    """One OAK-D: its name in the recording and its streams.

    device: its id, address or USB port name; None takes the next one that is free, by order of id. turned_deg: by how
    much its pictures must be turned counter-clockwise to stand upright (90 in the PLUSH rig). frame_sync: whether its
    sensors follow ("input") or give ("output") the trigger on the FSYNC line, where the device has one.
    """

    name: str
    streams: tuple[StreamSpec, ...]
    device: str | None = None
    turned_deg: int = 90
    role: str = "train"
    frame_sync: str = "off"

    def __post_init__(self) -> None:
        require(bool(re.fullmatch(CAMERA_NAME, self.name)), "device name", "look like cam0001", repr(self.name))
        require(self.device is None or bool(self.device), f"{self.name} device", "name a device or be null", "''")
        require(self.role in ROLES, f"{self.name} role", f"be one of {ROLES}", repr(self.role))
        turns = (0, 90, 180, 270)
        require(self.turned_deg in turns, f"{self.name} turned_deg", f"be one of {turns}", self.turned_deg)
        require(self.frame_sync in SYNCS, f"{self.name} frame_sync", f"be one of {SYNCS}", repr(self.frame_sync))
        object.__setattr__(self, "streams", tuple(self.streams))
        count = len(self.streams)
        require(1 <= count <= _STREAMS, f"{self.name} streams", f"be 1 to {_STREAMS}", count)
        for key in ("stream", "socket"):
            values = [getattr(s, key) for s in self.streams]
            require(len(set(values)) == count, f"{self.name} {key}s", "differ from one another", ", ".join(values))

    def named(self) -> tuple[tuple[str, StreamSpec], ...]:
        """Each stream with its name in the recording: cam0001, cam0001.left, cam0001.right."""
        return tuple((self.name if s.stream == "colour" else f"{self.name}.{s.stream}", s) for s in self.streams)


@dataclass(frozen=True, kw_only=True)
class RigSpec:
    """All devices of a rig and what they share.

    bitrate_mbit: of each stream [Mbit/s]; None lets it vary to keep `quality` (1 to 100). keyframe_every: frames from
    one keyframe to the next. sync_frames: how far apart the pictures of one group may be, in frames: half a frame is
    what a triggered rig keeps; three or more devices that run freely need up to 1.
    Raises ValueError naming the camera for anything that cannot be recorded.
    """

    devices: tuple[DeviceSpec, ...]
    fps: float = 40.0
    bitrate_mbit: float | None = 15.0
    quality: int = 90
    keyframe_every: int = 40
    sync_frames: float = 0.5

    def __post_init__(self) -> None:
        object.__setattr__(self, "devices", tuple(self.devices))
        count = len(self.devices)
        require(1 <= count <= MOST_DEVICES, "devices", f"be 1 to {MOST_DEVICES}", count)
        for key in ("name", "device"):
            values = [v for d in self.devices if (v := getattr(d, key)) is not None]
            twice = sorted({v for v in values if values.count(v) > 1})
            require(not twice, f"device {key}s", "differ from one another", f"{', '.join(twice)} twice")
        require(1 <= self.fps <= 120, "fps", "lie between 1 and 120", self.fps)
        given = self.bitrate_mbit
        require(given is None or 0 < given <= 200, "bitrate_mbit", "lie above 0 and up to 200, or be null", given)
        require(1 <= self.quality <= 100, "quality", "lie between 1 and 100", self.quality)
        require(self.keyframe_every >= 1, "keyframe_every", "be at least 1", self.keyframe_every)
        require(0 < self.sync_frames <= 1, "sync_frames", "lie above 0 and up to 1", self.sync_frames)
        for device in self.devices:
            self._check_load(device)

    @property
    def period(self) -> float:
        """Time from one frame to the next [s]."""
        return 1 / self.fps

    def _check_load(self, device: DeviceSpec) -> None:
        rate = self.fps * sum(s.size[0] * s.size[1] for s in device.streams)
        rule = f"stay below {_PIXEL_RATE / 1e6:.0f} million pixels a second, sizes and fps taken together"
        require(rate <= _PIXEL_RATE, f"{device.name} streams", rule, f"{rate / 1e6:.0f} million")
        for name, stream in device.named():
            longest = int(1e6 * self.period)
            fits = stream.exposure_us is None or stream.exposure_us <= longest
            require(fits, f"{name} exposure_us", f"fit into one frame of {longest}", stream.exposure_us)


def default_rig(devices: int | Sequence[str]) -> RigSpec:
    """The PLUSH rig: 1920 x 1080 colour and two 1280 x 800 grey streams at 40 fps from each of 1 to 19 devices.

    devices: how many, or their ids.
    """
    ids = [None] * devices if isinstance(devices, int) else list(devices)
    grey = (("left", "CAM_B"), ("right", "CAM_C"))
    streams = (
        StreamSpec(stream="colour", socket="CAM_A", size=(1920, 1080)),
        *(StreamSpec(stream=stream, socket=socket, size=(1280, 800)) for stream, socket in grey),
    )
    return RigSpec(devices=tuple(
        DeviceSpec(name=f"cam{i + 1:04d}", streams=streams, device=device) for i, device in enumerate(ids)
    ))  # fmt: skip


def save_rig(spec: RigSpec, path: str | Path) -> Path:
    """Write the description as JSON; it appears whole or not at all."""
    return write_json(path, asdict(spec))


def load_rig(path: str | Path) -> RigSpec:
    """Read what `save_rig` or a person wrote; keys that have a default may be left out.

    Raises ValueError with one sentence that names the file, the camera and the key that is wrong.
    """
    held = read_json(path)
    try:
        return rig_of(held)
    except ValueError as error:
        raise ValueError(f"{Path(path).name}: {error}") from None


def rig_of(held: object) -> RigSpec:
    """The description that parsed JSON holds; raises ValueError like `load_rig`."""
    rig = _entry(RigSpec, "rig", held)
    devices = []
    for i, given in enumerate(_entries("rig devices", rig["devices"])):
        device = _entry(DeviceSpec, f"device {i + 1}", given)
        streams = [_stream(str(device["name"]), s) for s in _entries(f"{device['name']} streams", device["streams"])]
        devices.append(DeviceSpec(**{**device, "streams": tuple(streams)}))
    return RigSpec(**{**rig, "devices": tuple(devices)})


def _stream(device: str, given: object) -> StreamSpec:
    held = _entry(StreamSpec, f"{device} stream", given)
    try:
        return StreamSpec(**held)
    except ValueError as error:
        raise ValueError(f"{device} {error}") from None


def _entries(name: str, value: object) -> list[object]:
    require(isinstance(value, list), name, "be a list", type(value).__name__)
    return value


def _entry(cls: type, name: str, value: object) -> dict[str, object]:
    """The keys and values of one JSON object: all known to the class, none missing, each of its kind."""
    require(isinstance(value, dict), name, "be an object with keys and values", type(value).__name__)
    known = {f.name: f for f in fields(cls)}
    strange = sorted(set(value) - set(known))
    require(not strange, f"{name} keys", f"be among {', '.join(known)}", ", ".join(strange))
    lacking = [key for key, f in known.items() if f.default is MISSING and key not in value]
    require(not lacking, name, f"have the keys {', '.join(lacking)}", f"only {', '.join(value) or 'none'}")
    for key, given in value.items():
        kind = known[key].type
        kinds = get_args(kind) if isinstance(kind, UnionType) else (kind,)
        words = " or ".join(WORDS.get(k, "a list") for k in kinds)
        require(any(_is(given, k) for k in kinds), f"{name} {key}", f"be {words}", repr(given))
    return value


def _is(value: object, kind: type) -> bool:
    if isinstance(value, bool):
        return False
    if kind not in WORDS:
        return isinstance(value, list)
    return isinstance(value, (int, float) if kind is float else kind)
