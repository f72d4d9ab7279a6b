"""Cameras: points to pixels and back, other sizes of the same picture, and what is no camera."""

from dataclasses import replace

import numpy as np
import pytest

from recon.cameras import Camera, Resampling, look_at

LENS = np.array([0.3, -0.2, 1e-3, -2e-3, 0.05, 0.32, -0.15, 0.02, 1e-3, -5e-4, 7e-4, 2e-4])


def camera(**changes) -> Camera:
    """A camera 0.8 m from the origin, with a lens as on the OAK-D."""
    T = look_at(np.array([0.6, -0.4, 0.35]), np.zeros(3), np.array([0, 0, 1.0]))
    K = np.array([[800.0, 0, 322], [0, 805, 238], [0, 0, 1]])
    return Camera(**{"name": "cam0001", "K": K, "T_camera_world": T, "size": (640, 480), "distortion": LENS, **changes})


def thin_prism(x: np.ndarray, y: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """OpenCV's rational and thin-prism model, written out."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = d
    r2 = x**2 + y**2
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2) + s1 * r2 + s2 * r2**2,
        y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y + s3 * r2 + s4 * r2**2,
    )


def test_projection_is_the_documented_formula():
    c, p = camera(), 0.1 * np.random.default_rng(0).normal(size=(7, 5, 3))
    local = p @ c.T_camera_world[:3, :3].T + c.T_camera_world[:3, 3]
    x, y = thin_prism(local[..., 0] / local[..., 2], local[..., 1] / local[..., 2], LENS)
    pixels, depth = c.project(p)
    assert np.stack([800 * x + 322, 805 * y + 238], axis=-1) == pytest.approx(pixels, abs=1e-9)
    assert depth == pytest.approx(local[..., 2])


def test_rays_go_through_what_was_projected():
    c, p = camera(), 0.1 * np.random.default_rng(1).normal(size=(40, 3))
    along = p - c.centre
    assert c.rays(c.project(p)[0]) == pytest.approx(along / np.linalg.norm(along, axis=1)[:, None], abs=1e-9)
    assert c.rays(np.zeros((0, 2))).shape == (0, 3)


def test_what_is_behind_has_no_pixel():
    c = camera()
    pixels, depth = c.project(np.stack([np.zeros(3), 2 * c.centre]))
    assert np.isfinite(pixels[0]).all() and np.isnan(pixels[1]).all()
    assert depth[0] == pytest.approx(np.linalg.norm(c.centre)) and depth[1] < 0


def test_look_at_puts_the_target_in_the_middle_and_up_upwards():
    c = camera(distortion=np.zeros(0))
    assert c.project(np.zeros(3))[0] == pytest.approx([322, 238])
    assert c.project(np.array([0, 0, 0.1]))[0][1] < 238  # rows grow downwards
    assert np.linalg.det(c.T_camera_world[:3, :3]) == pytest.approx(1)
    assert c.axis == pytest.approx(-c.centre / np.linalg.norm(c.centre))


def test_other_sizes_show_the_same_picture_corner_to_corner():
    c, p = camera(distortion=np.zeros(0)), 0.1 * np.random.default_rng(2).normal(size=(20, 3))
    half, part = c.resized((320, 120)), c.cropped(10, 20, (100, 90))
    # A corner lies half a pixel outside the first pixel's centre, whatever the size.
    assert half.project(p)[0] + 0.5 == pytest.approx((c.project(p)[0] + 0.5) * [0.5, 0.25])
    assert part.project(p)[0] == pytest.approx(c.project(p)[0] - [10, 20])


def test_resampling_undoes_the_lens():
    """A picture whose colour is a smooth function of direction, seen through the lens, and resampled without it."""
    source = camera()
    goal = source.undistorted().resized((160, 120))
    picture = lambda c: 100 + 80 * np.sin(8 * (c.rays(c.grid()) @ np.array([0.3, 0.9, -0.2])))  # noqa: E731
    found = Resampling.of(source, goal)(picture(source).astype(np.float32))
    inside = (slice(8, -8), slice(8, -8))
    assert found[inside] == pytest.approx(picture(goal)[inside], abs=0.1)


def test_resampling_keeps_the_mean_of_fine_stripes():
    c = camera(distortion=np.zeros(0))
    stripes = np.where(np.arange(640)[None, :] % 2 == 0, 0, 200).astype(np.uint8) * np.ones((480, 1), np.uint8)
    small = Resampling.of(c, c.resized((80, 60)))(stripes)
    assert small[5:-5, 5:-5].astype(float) == pytest.approx(100 * np.ones((50, 70)), abs=2)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"K": np.eye(3) * 2}, r"cam0001 intrinsic must be \[\[fx, s, cx\]"),
        ({"T_camera_world": np.diag([1.0, 1, -1, 1])}, "cam0001 extrinsic must hold a rotation and a shift"),
        ({"T_camera_world": 2 * np.eye(4)}, "cam0001 extrinsic must hold a rotation"),
        ({"distortion": np.zeros(7)}, "cam0001 distortion must have one of"),
        ({"distortion": np.full(5, np.nan)}, "cam0001 distortion must be finite"),
        ({"size": (0, 480)}, "cam0001 size must be a width and a height"),
        ({"stream": "infrared"}, "cam0001 stream must be one of"),
        ({"role": "judge"}, "cam0001 role must be one of"),
    ],
)
def test_what_is_no_camera_is_refused_in_one_sentence(changes, says):
    with pytest.raises(ValueError, match=says):
        camera(**changes)


def test_resampling_needs_the_right_pictures():
    c = camera()
    with pytest.raises(ValueError, match="have no distortion"):
        Resampling.of(c, c)
    moved = replace(c.undistorted(), T_camera_world=np.eye(4))
    with pytest.raises(ValueError, match="stand where the source stands"):
        Resampling.of(c, moved)
    with pytest.raises(ValueError, match="cam0001 image must be 640 x 480 pixels"):
        Resampling.of(c, c.undistorted())(np.zeros((640, 480), np.uint8))
