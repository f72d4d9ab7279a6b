"""The camera of a picture that was turned: a device that hangs on its side has its calibration lying down."""

from dataclasses import replace

import numpy as np

from recon.cameras import Camera
from sim.checks import require

_QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # x_turned = Q x: right becomes up
_RADIAL = (0, 1, 4, 5, 6, 7)  # k1 k2 k3 k4 k5 k6 keep their values


def turned(camera: Camera, degrees: int) -> Camera:
    """The camera whose pictures are this one's turned counter-clockwise by 0, 90, 180 or 270 degrees.

    By a quarter turn `(u, v) -> (v, width - 1 - u)` and `(x, y) -> (y, -x)`, which maps OpenCV's distortion onto
    `p1' = -p2, p2' = p1, s1' = s3, s2' = s4, s3' = -s1, s4' = -s2`, and a sensor tilted about one axis onto
    `tx' = ty, ty' = -tx`. Raises ValueError for other angles, skewed pixels or a sensor tilted about both axes.
    """
    require(degrees in (0, 90, 180, 270), f"{camera.name} turn", "be 0, 90, 180 or 270 degrees", degrees)
    for _ in range(degrees // 90):
        camera = _quarter(camera)
    return camera


def _quarter(camera: Camera) -> Camera:
    (fx, skew, cx), (_, fy, cy) = camera.K[:2]
    require(skew == 0, f"{camera.name} intrinsic", "have no skew where its picture is turned", skew)
    width, height = camera.size
    T = np.eye(4)
    T[:3, :3] = _QUARTER
    return replace(
        camera,
        K=np.array([[fy, 0, cy], [0, fx, width - 1 - cx], [0, 0, 1]]),
        T_camera_world=T @ camera.T_camera_world,
        size=(height, width),
        distortion=_lens(camera),
    )


def _lens(camera: Camera) -> np.ndarray:
    old, given = np.zeros(14), camera.distortion
    old[: len(given)] = given
    both = bool(old[12] and old[13])
    require(not both, f"{camera.name} distortion", "tilt about one axis where its picture is turned", given.tolist())
    new = np.zeros(14)
    new[list(_RADIAL)] = old[list(_RADIAL)]
    new[2], new[3] = -old[3], old[2]
    new[8:12] = old[10], old[11], -old[8], -old[9]
    new[12:] = old[13], -old[12]
    return new[: len(given)]
