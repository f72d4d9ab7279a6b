"""What an OAK device knows of its own sensors: the calibration in its EEPROM, as cameras."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from recon.cameras import Camera
from recon.files import read_json
from recon.oak.recording import PLACE
from recon.oak.spec import SOCKETS, DeviceSpec, StreamSpec, load_rig
from recon.turned import turned
from sim.checks import require

UNITS = (1.0, 1e-2, 1e-3)  # [m], by DepthAI's number of a unit of length
CM = 1  # what files that name no unit are in
PERSPECTIVE = 0  # DepthAI's number of the lens model that OpenCV's coefficients belong to


@dataclass(frozen=True, kw_only=True, eq=False)
class _Sensor:
    """One sensor's entry: intrinsics at a size, and the motion from its frame to another socket's, if it has one."""

    K: np.ndarray
    size: tuple[int, int]
    distortion: np.ndarray
    towards: str | None
    T_towards_own: np.ndarray  # [m]


def recorded_cameras(folder: str | Path) -> tuple[Camera, ...]:
    """The cameras of a recording by the calibrations that were read from its devices, each in its own frame.

    Raises ValueError naming the device that had none.
    """
    place = Path(folder) / PLACE
    devices = load_rig(place / "rig.json").devices
    return tuple(camera for d in devices for camera in _of_device(d, place / f"{d.name}.eeprom.json"))


def _of_device(device: DeviceSpec, path: Path) -> tuple[Camera, ...]:
    rule = "have a calibration in its EEPROM, or the rig's calibration.json must be given"
    require(path.exists(), device.name, rule, f"no {path.name}")
    return eeprom_cameras(device, read_json(path))


def eeprom_cameras(device: DeviceSpec, held: object) -> tuple[Camera, ...]:
    """A device's cameras, of upright pictures of the sizes that the spec records, by its EEPROM's contents.

    held: parsed JSON as `dai.CalibrationHandler` writes it (`eepromToJson`, `eepromToJsonFile`), lengths in its own
    units. The world is the upright colour camera's frame (the first stream's where there is no colour) with the axes
    of a PLUSH reconstruction, y and z the other way round, as if the device were the rig's first.
    Raises ValueError naming device and sensor when its calibration is missing, damaged, or not of a perspective lens.
    """
    sensors = _sensors(device.name, held)
    named = device.named()
    origin = next((s.socket for _, s in named if s.stream == "colour"), named[0][1].socket)
    cameras = []
    for name, stream in named:
        require(stream.socket in sensors, f"{name} EEPROM", f"hold a calibration of {stream.socket}", sorted(sensors))
        lying = _camera(name, stream, sensors[stream.socket], device.role)
        T = _way(name, sensors, origin, stream.socket)
        cameras.append(turned(replace(lying, T_camera_world=T), device.turned_deg))
    upright = cameras[[s.socket for _, s in named].index(origin)].T_camera_world
    T_origin_world = np.linalg.inv(upright) @ np.diag([1.0, -1.0, -1.0, 1.0])
    return tuple(replace(c, T_camera_world=c.T_camera_world @ T_origin_world) for c in cameras)


def _sensors(name: str, held: object) -> dict[str, _Sensor]:
    """The sensors by socket."""
    try:
        return {SOCKETS[number]: _sensor(entry) for number, entry in held["cameraData"] if 0 <= number < len(SOCKETS)}
    except (LookupError, TypeError, ValueError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise ValueError(f"{name} EEPROM must be as dai.CalibrationHandler writes it; got {reason}") from None


def _sensor(entry: dict) -> _Sensor:
    require(entry["cameraType"] == PERSPECTIVE, "cameraType", "be 0, a perspective lens", entry["cameraType"])
    link, T = entry["extrinsics"], np.eye(4)
    there = link["toCameraSocket"]
    if 0 <= there < len(SOCKETS):
        T[:3, :3] = link["rotationMatrix"]
        T[:3, 3] = UNITS[link.get("lengthUnit", CM)] * np.array([link["translation"][axis] for axis in "xyz"], float)
    lens = np.array(entry["distortionCoeff"], float)
    return _Sensor(
        K=np.array(entry["intrinsicMatrix"], float),
        size=(int(entry["width"]), int(entry["height"])),
        distortion=lens[:12] if len(lens) == 14 and not lens[12:].any() else lens,
        towards=SOCKETS[there] if 0 <= there < len(SOCKETS) else None,
        T_towards_own=T,
    )


def _camera(name: str, stream: StreamSpec, sensor: _Sensor, role: str) -> Camera:
    """The lying camera at the size that is recorded: the sensor's picture scaled to fill it, its middle cut out.

    `u' = s (u + 1/2) - 1/2 - (s width - width') / 2`: corners scale, pixel centres lie half a pixel inside.
    """
    width, height = stream.size
    require(min(sensor.size) > 0, f"{name} EEPROM", "say for which size it holds", sensor.size)
    scale = max(width / sensor.size[0], height / sensor.size[1])
    shift = [(n - scale * m) / 2 + (scale - 1) / 2 for n, m in zip(stream.size, sensor.size, strict=True)]
    fit = np.array([[scale, 0, shift[0]], [0, scale, shift[1]], [0, 0, 1]])
    return Camera(
        name=name,
        K=fit @ sensor.K,
        T_camera_world=np.eye(4),
        size=stream.size,
        distortion=sensor.distortion,
        stream=stream.stream,
        role=role,
    )


def _way(name: str, sensors: dict[str, _Sensor], origin: str, goal: str) -> np.ndarray:
    """T_goal_origin along the links that the sensors have to one another."""
    reached, fresh = {origin: np.eye(4)}, True
    while fresh and goal not in reached:
        fresh = False
        for socket, sensor in sensors.items():
            there, T = sensor.towards, sensor.T_towards_own
            if there is not None and (socket in reached) != (there in reached):
                fresh = True
                if socket in reached:
                    reached[there] = T @ reached[socket]
                else:
                    reached[socket] = np.linalg.inv(T) @ reached[there]
    require(goal in reached, f"{name} EEPROM", f"link {goal} to {origin}", "no way between them")
    return reached[goal]
