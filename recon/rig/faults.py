"""Planted faults: what they change in the written files; the truth stays as it is."""

from dataclasses import replace

import numpy as np

from recon.cameras import Camera
from recon.rig.options import RigFaults


def written_cameras(cameras: tuple[Camera, ...], faults: RigFaults) -> tuple[Camera, ...]:
    """The cameras as calibration.json says: with a wrong scale they stand so many times too far from cam0001."""
    return tuple(_scaled_camera(camera, faults.scale) for camera in cameras)


def written_marker(T_world_marker: np.ndarray, faults: RigFaults) -> np.ndarray:
    """A marker pose (4, 4) as aruco_path.json says: turned about and moved along its own x, then scaled."""
    c, s = np.cos(np.deg2rad(faults.nozzle_deg)), np.sin(np.deg2rad(faults.nozzle_deg))
    error = np.array([[1, 0, 0, 1e-3 * faults.nozzle_mm], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])
    T = T_world_marker @ error
    T[:3, 3] *= faults.scale
    return T


def shown_frames(device: str, frames: int, faults: RigFaults, seed: int) -> list[int]:
    """The true frame behind each frame of a device's videos; empty where there are none."""
    if device in faults.missing:
        return []
    late, lost = dict(faults.late).get(device, 0), dict(faults.dropped).get(device, 0)
    shown = [max(0, frame - late) for frame in range(frames)]
    if lost:
        rng = np.random.default_rng([6, seed, int(device[3:])])
        gone = set((1 + rng.permutation(frames - 1)[:lost]).tolist())
        shown = [frame for place, frame in enumerate(shown) if place not in gone]
    return shown


def _scaled_camera(camera: Camera, scale: float) -> Camera:
    T = camera.T_camera_world.copy()
    T[:3, 3] *= scale
    return replace(camera, T_camera_world=T)
