"""Where everything stands: the cage of cameras, the lights, the table, and the way from the stage to the world.

The stage: origin under the object on the table, z up, the front towards -y, metres. The world of a PLUSH recording is
cam0001's frame with y and z the other way round, so that `T_camera_world` of cam0001 is diag(1, -1, -1, 1).
"""

from dataclasses import dataclass, replace

import numpy as np

from recon.cameras import Camera, look_at
from recon.plush.reconstruction import TO_RECONSTRUCTION
from recon.rig.options import RigOptions

TARGET = np.array([0.0, 0.0, 0.15])  # the object's middle
AWAY = 0.80  # [m] from it to a camera
WATCHING = 3  # cameras that watch the nozzle
WATCHED = np.array([0.0, -0.20, 0.38])  # where they look
WATCH_AWAY = 1.15  # [m] from the object's middle
UP = np.array([0.0, 0.0, 1.0])
FRONT_FREE = 12.0  # [deg], cameras in front stay below this, where the nozzle does not hide the object
ELEVATIONS = (9.0, 40.0, 22.0, 60.0)  # [deg], in turn round the cage
WATCH = ((-22.0, 42.0), (0.0, 52.0), (22.0, 42.0))  # azimuth and elevation [deg] of the watching cameras
FPS = 40.0
BASELINE = 0.075  # [m] between the grey sensors, the colour one in the middle
FULL = 1080  # width of the full rig's upright colour pictures [px]
SENSORS = {"colour": (1080, 1920, 1397.0), "left": (800, 1280, 882.0), "right": (800, 1280, 882.0)}  # focal length [px]
# The device lies on its side: what is right of it in the stored video is up in the upright picture.
OFFSET = {"colour": 0.0, "left": BASELINE / 2, "right": -BASELINE / 2}  # [m] down the upright picture
LENS = np.array([0.12, -0.30, 0.0, 0.0, 0.12, 0.02, -0.02, 0.01, 0.0, 0.0, 0.0, 0.0])
SPREAD = np.array([0.02, 0.04, 8e-4, 8e-4, 0.03, 0.004, 0.004, 0.003, 5e-4, 2e-4, 5e-4, 2e-4])


@dataclass(frozen=True, kw_only=True, eq=False)
class Stage:
    """All cameras, colour and grey, in the world's axes, and where the stage is in it."""

    cameras: tuple[Camera, ...]
    T_world_stage: np.ndarray  # (4, 4) [m]

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) [m] of the stage in the world."""
        return points @ self.T_world_stage[:3, :3].T + self.T_world_stage[:3, 3]

    def turned(self, vectors: np.ndarray) -> np.ndarray:
        """Vectors (..., 3) of the stage in the world."""
        return vectors @ self.T_world_stage[:3, :3].T

    def on_stage(self, camera: Camera) -> Camera:
        """The same camera as seen from the stage."""
        return replace(camera, T_camera_world=camera.T_camera_world @ self.T_world_stage)


def build_stage(options: RigOptions) -> Stage:
    """The cage for so many cameras of that size; lenses differ a little, by the seed."""
    placed = _placed(options.cameras)
    T_world_stage = np.diag([*TO_RECONSTRUCTION, 1.0]) @ placed[0][0]
    T_stage_world = np.linalg.inv(T_world_stage)
    streams = ("colour", "left", "right") if options.greys else ("colour",)
    cameras = [
        _sensor(f"cam{i + 1:04d}", stream, T @ T_stage_world, role, options)
        for i, (T, role) in enumerate(placed)
        for stream in streams
    ]
    return Stage(cameras=tuple(cameras), T_world_stage=T_world_stage)


def around(azimuth: float, elevation: float) -> np.ndarray:
    """A unit vector (3,) on the stage; azimuth [deg] from the front to the right, elevation [deg] above the table."""
    a, e = np.deg2rad([azimuth, elevation])
    return np.array([np.sin(a) * np.cos(e), -np.cos(a) * np.cos(e), np.sin(e)])


def _placed(count: int) -> list[tuple[np.ndarray, str]]:
    """T_camera_stage and role of every device; the first one stands in front."""
    ring, out = count - WATCHING, []
    for i in range(ring):
        azimuth = 360 * i / ring
        off = abs((azimuth + 180) % 360 - 180)
        share = np.clip((off - 45) / 45, 0, 1)
        low = min(ELEVATIONS[i % 4], FRONT_FREE)
        eye = TARGET + AWAY * around(azimuth, low + share * (ELEVATIONS[i % 4] - low))
        out.append((look_at(eye, TARGET, UP), "train"))
    for azimuth, elevation in WATCH:
        out.append((look_at(TARGET + WATCH_AWAY * around(azimuth, elevation), WATCHED, UP), "nozzle"))
    return out


def _sensor(device: str, stream: str, T_device_world: np.ndarray, role: str, options: RigOptions) -> Camera:
    """One sensor of a device with its own lens."""
    width, height, focal = SENSORS[stream]
    scale = options.size / FULL
    size = (_even(width * scale), _even(height * scale))
    number = [options.seed, int(device[3:]), list(SENSORS).index(stream)]
    rng = np.random.default_rng([1, *number])
    T = T_device_world.copy()
    T[1, 3] -= OFFSET[stream]
    f, off = focal * scale * (1 + 0.004 * rng.uniform(-1, 1)), 0.01 * size[0] * rng.uniform(-1, 1, 2)
    centre = (np.array(size) - 1) / 2 + off
    name = device if stream == "colour" else f"{device}.{stream}"
    return Camera(
        name=name, K=np.array([[f, 0, centre[0]], [0, f * (1 + 1e-3 * rng.uniform(-1, 1)), centre[1]], [0, 0, 1]]),
        T_camera_world=T, size=size, distortion=LENS + SPREAD * rng.uniform(-1, 1, 12), stream=stream, role=role,
    )  # fmt: skip


def _even(length: float) -> int:
    return 2 * round(length / 2)
