"""A recording in the PLUSH layout for tests: three colour cameras, one grey pair, a marker that is not always seen."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from ellipsoid_scene import Scene, ring, swaying

from recon.cameras import Camera, look_at
from recon.plush.capture_writer import write_capture

FRAMES = 5
SIZE = (72, 96)


def marker_poses() -> list[np.ndarray | None]:
    """A marker that goes round, not seen in two of the frames."""
    poses = []
    for angle in np.linspace(0, 2, FRAMES):
        eye = np.array([0.3 * np.cos(angle), 0.05, 0.3 * np.sin(angle)])
        poses.append(np.linalg.inv(look_at(eye, np.array([0.02, 0, 0.01]), np.array([0, 1.0, 0.1]))))
    poses[0] = poses[3] = None
    return poses


def rig() -> list[Camera]:
    """Three colour cameras and one grey pair."""
    cameras = ring(3, size=SIZE)
    sides = [replace(cameras[1], name=f"cam0002.{side}", stream=side) for side in ("left", "right")]
    return [*cameras, *sides]


def written_to(folder: Path) -> tuple[Path, Scene, list[Camera]]:
    """The folder, what it shows, and the cameras that were written."""
    scene, cameras = Scene(swaying(FRAMES)), rig()
    by_name = {camera.name: camera for camera in cameras}
    write_capture(folder, cameras, 40.0, lambda name: scene.frames(by_name[name]), marker_poses())
    return folder, scene, cameras
