"""COLMAP's text model out: cameras.txt, images.txt, points3D.txt."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from recon.cameras import Camera
from recon.files import replacing
from sim.checks import as_array, require

HALF = 0.5  # COLMAP's first pixel reaches from 0 to 1, OpenCV's has its centre at 0
RATIONAL = 8  # distortion numbers k1 k2 p1 p2 k3 k4 k5 k6, which FULL_OPENCV takes in OpenCV's order


def write_colmap(
    folder: str | Path,
    cameras: Sequence[Camera],
    *,
    pictures: Sequence[str] | None = None,
    points: np.ndarray | None = None,
    colors: np.ndarray | None = None,
) -> Path:
    """Write the model of one frame: a camera and an image for each of ours; lengths stay metres.

    PINHOLE without distortion, else FULL_OPENCV. pictures: file name of each camera's picture, NAME.png when not
    given; points (N, 3) [m] with colors (N, 3) uint8 start a reconstruction, e.g. those of the visual hull.
    Returns the folder. Raises ValueError for a skewed sensor, thin-prism or tilt terms, which COLMAP cannot hold.
    """
    folder, pictures = Path(folder), pictures or [f"{camera.name}.png" for camera in cameras]
    require(len(pictures) == len(cameras), "pictures", f"name {len(cameras)} files", len(pictures))
    blank = [name for name in pictures if not name or any(c.isspace() for c in name)]
    require(not blank, "pictures", "have names without spaces", blank)
    lines = {
        "cameras.txt": ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"],
        "images.txt": ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# POINTS2D[] as (X, Y, POINT3D_ID)"],
        "points3D.txt": ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"],
    }
    for number, (camera, picture) in enumerate(zip(cameras, pictures, strict=True), start=1):
        lines["cameras.txt"].append(f"{number} {_intrinsics(camera)}")
        lines["images.txt"] += [f"{number} {_place(camera)} {number} {picture}", ""]
    lines["points3D.txt"] += _points(points, colors)
    for name, text in lines.items():
        with replacing(folder / name) as partial:
            partial.write_text("\n".join(text) + "\n", encoding="utf-8")
    return folder


def _intrinsics(camera: Camera) -> str:
    K, distortion = camera.K, camera.distortion
    require(K[0, 1] == 0, f"{camera.name} intrinsic", "have no skew in COLMAP", K[0, 1])
    rest = distortion[RATIONAL:]
    rule = "have no thin-prism or tilt terms in COLMAP (write undistorted views instead)"
    require(not rest.any(), f"{camera.name} distortion", rule, rest.tolist())
    numbers = [K[0, 0], K[1, 1], K[0, 2] + HALF, K[1, 2] + HALF]
    model = "FULL_OPENCV" if distortion.any() else "PINHOLE"
    if model == "FULL_OPENCV":
        numbers += [*distortion[:RATIONAL], *np.zeros(RATIONAL - len(distortion[:RATIONAL]))]
    return f"{model} {camera.size[0]} {camera.size[1]} {_words(numbers)}"


def _place(camera: Camera) -> str:
    """World to camera as a quaternion, real part first, and a shift."""
    x, y, z, w = Rotation.from_matrix(camera.T_camera_world[:3, :3]).as_quat(canonical=True)
    return _words([w, x, y, z, *camera.T_camera_world[:3, 3]])


def _points(points: np.ndarray | None, colors: np.ndarray | None) -> list[str]:
    points = as_array("points", np.zeros((0, 3)) if points is None else points, (None, 3))
    colors = np.full(points.shape, 128, np.uint8) if colors is None else as_array("colors", colors, points.shape, int)
    return [
        f"{i} {_words(point)} {r} {g} {b} 0"
        for i, (point, (r, g, b)) in enumerate(zip(points, colors, strict=True), start=1)
    ]


def _words(numbers: Sequence[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
