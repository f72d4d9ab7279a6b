"""A rig of OAK-D cameras: its devices found, checked, started and recorded together."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from recon.files import write_json
from recon.oak.devices import FoundDevice, OakStream, build_streams, connect, list_devices, no_device_sentence, refusals
from recon.oak.recorder import Recorded, StreamStatus, record_streams
from recon.oak.recording import PLACE
from recon.oak.spec import DeviceSpec, RigSpec, save_rig
from sim.checks import require


def record_rig(
    spec: RigSpec,
    folder: str | Path,
    *,
    seconds: float | None = None,
    on_status: Callable[[tuple[StreamStatus, ...]], None] = lambda _: None,
    find: Callable[[], Sequence[FoundDevice]] = list_devices,
    start: Callable[[str], tuple[Any, Any]] = connect,
    record: Callable[..., Recorded] = record_streams,
) -> Recorded:
    """Record all devices of a rig into `folder/recording` for `seconds` [s], or until Ctrl-C; see `record_streams`.

    Beside the packets and their times: rig.json with the ids of the devices, and each device's EEPROM calibration.
    find, start (id -> device, pipeline) and record are for tests.
    Raises ValueError, before anything is recorded, when no device or too few are free, one has no such socket or
    cannot deliver a size, or `folder` holds a recording already.
    """
    place = Path(folder) / PLACE
    require(not place.exists(), "out", "be a folder that holds no recording yet", repr(str(folder)))
    spec = assigned(spec, find())
    with ExitStack() as stack:
        devices = [_opened(stack, device, spec, start) for device in spec.devices]
        for device in devices:
            with refusals(device.spec.name):
                device.pipeline.start()
        place.mkdir(parents=True)
        save_rig(spec, place / "rig.json")
        for device in devices:
            if device.calibration is not None:
                write_json(place / f"{device.spec.name}.eeprom.json", device.calibration.eepromToJson())
        streams = [stream for device in devices for stream in device.streams()]
        return record(streams, place, fps=spec.fps, seconds=seconds, on_status=on_status)


def assigned(spec: RigSpec, found: Sequence[FoundDevice]) -> RigSpec:
    """The rig with the id of a free device for each of its cameras; raises ValueError when there are too few."""
    if not found:
        raise ValueError(no_device_sentence())
    by_name = {key: device.id for device in found for key in (device.name, device.id)}
    named = [d.device for d in spec.devices if d.device is not None]
    absent = [name for name in named if name not in by_name]
    count, free = len(spec.devices), [d.id for d in found if d.id not in {by_name.get(name) for name in named}]
    got = f"{len(found)}, and {', '.join(absent)} is not among them" if absent else f"{len(found)}"
    require(not absent and len(free) >= count - len(named), "rig", f"find its {count} devices free", got)
    order = iter(free)
    ids = [next(order) if d.device is None else by_name[d.device] for d in spec.devices]
    return replace(spec, devices=tuple(replace(d, device=i) for d, i in zip(spec.devices, ids, strict=True)))


@dataclass(frozen=True, kw_only=True)
class _Device:
    """A device whose pipeline is built: the queue of each stream, and its calibration where it has one."""

    spec: DeviceSpec
    pipeline: Any
    queues: tuple[tuple[str, Any], ...]
    calibration: Any | None

    def streams(self) -> list[OakStream]:
        device, pipeline = self.spec.name, self.pipeline
        return [OakStream(name=n, device=device, pipeline=pipeline, queue=q) for n, q in self.queues]


def _opened(stack: ExitStack, spec: DeviceSpec, rig: RigSpec, start: Callable[[str], tuple[Any, Any]]) -> _Device:
    device, pipeline = start(spec.device)
    stack.callback(_quietly, device.close)
    stack.callback(_quietly, pipeline.stop)
    with refusals(spec.name):
        features, calibration = device.getConnectedCameraFeatures(), device.readCalibration()
        check_sensors(spec, features, rig.fps)
        calibration = calibration if calibration.hasCalibrationData() else None
        lens = {
            f.socket.name: calibration.getLensPosition(f.socket) for f in features if calibration and f.hasAutofocus
        }
        queues = build_streams(pipeline, spec, rig, lambda socket: lens.get(socket, 0))
    return _Device(spec=spec, pipeline=pipeline, queues=queues, calibration=calibration)


def _quietly(close: Callable[[], None]) -> None:
    with suppress(RuntimeError):  # a device that was unplugged cannot be closed
        close()


def check_sensors(device: DeviceSpec, features: Sequence[Any], fps: float) -> None:
    """Raise ValueError for a socket that the device lacks, or a size or rate that its sensor cannot deliver."""
    known = {f.socket.name: f for f in features}
    words = ", ".join(sorted(known))
    for name, stream in device.named():
        sensor = known.get(stream.socket)
        require(sensor is not None, f"{name} socket", f"be among {device.device}'s {words}", stream.socket)
        width, height = stream.size
        fits = width <= sensor.width and height <= sensor.height
        largest = f"fit the {sensor.sensorName}'s {sensor.width} x {sensor.height} pixels"
        require(fits, f"{name} size", largest, f"{width} x {height}")
        rates = [c.maxFps for c in sensor.configs if c.width >= width and c.height >= height]
        fastest = max(rates, default=fps)
        require(fps <= fastest, f"{name} fps", f"be at most {fastest:g} for {width} x {height} pixels", fps)
