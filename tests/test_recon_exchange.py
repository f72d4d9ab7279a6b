"""nerfstudio and COLMAP: files made by hand with values worked out here, their own projection formulas, round trips."""

import json
from dataclasses import replace

import numpy as np
import pytest
from ellipsoid_scene import Scene, ring, silhouette, swaying

from recon.cameras import Camera, look_at
from recon.exchange.colmap import write_colmap
from recon.exchange.nerfstudio import read_transforms
from recon.exchange.nerfstudio_writer import write_transforms
from recon.images import write_image

FIVE = np.array([0.1, -0.05, 0.001, 0.002, 0.01])


def in_front(camera: Camera, count: int = 50, seed: int = 0) -> np.ndarray:
    """Points (count, 3) [m] whose pixels are in the picture."""
    rng = np.random.default_rng(seed)
    pixels = rng.random((count, 2)) * (np.array(camera.size) - 1)
    return camera.centre + rng.uniform(0.5, 1.0, (count, 1)) * camera.rays(pixels)


def nerfstudio_rays(frame: dict, column: float, row: float) -> np.ndarray:
    """As nerfstudio makes the ray through a pixel: its centre at + 0.5, y up, looking along -z; no distortion."""
    x, y = (column + 0.5 - frame["cx"]) / frame["fl_x"], -(row + 0.5 - frame["cy"]) / frame["fl_y"]
    ray = np.array(frame["transform_matrix"])[:3, :3] @ [x, y, -1]
    return ray / np.linalg.norm(ray)


def written(folder, cameras, frames=3, mattes=True):
    scene, by_name = Scene(swaying(frames)), {camera.name: camera for camera in cameras}
    times = 0.5 + np.arange(frames) / 40
    masks = {c.name: [255 * silhouette(c, m).astype(np.uint8) for m in scene.middle] for c in cameras}
    path = write_transforms(folder, cameras, times, lambda name: scene.frames(by_name[name]), masks.get)
    return path, scene, times, masks


def test_transforms_round_trip_is_exact(tmp_path):
    cameras = [replace(camera, distortion=FIVE) for camera in ring(3)]
    cameras[1] = replace(cameras[1], role="test", distortion=np.zeros(0))
    T = cameras[0].T_camera_world.copy()
    T[0, 3] += 0.0375
    cameras.append(replace(cameras[0], name="cam0001.left", stream="left", T_camera_world=T))
    path, scene, times, masks = written(tmp_path, cameras)
    capture = read_transforms(tmp_path)
    np.testing.assert_allclose(capture.times, times, rtol=1e-14)
    for camera in cameras:
        got = capture.camera(camera.name)
        np.testing.assert_allclose(got.T_camera_world, camera.T_camera_world, atol=1e-14)
        np.testing.assert_allclose(got.K, camera.K, atol=1e-12)
        np.testing.assert_array_equal(got.distortion, camera.distortion)
        assert (got.size, got.role, got.stream) == (camera.size, camera.role, camera.stream)
        for frame, sent in enumerate(scene.frames(camera)):
            np.testing.assert_array_equal(capture.image(camera.name, frame), sent)
            np.testing.assert_array_equal(capture.matte(camera.name, frame), masks[camera.name][frame])
    meta = json.loads(path.read_text())
    assert meta["camera_model"] == "OPENCV" and {f["time"] for f in meta["frames"]} == {0.0, 0.5, 1.0}
    assert meta["test_filenames"] == meta["val_filenames"] == [f"images/cam0002/{i:08d}.png" for i in range(3)]


def test_written_file_means_the_same_rays_to_nerfstudio(tmp_path):
    cameras = [camera.undistorted() for camera in ring(2)]
    meta = json.loads(written(tmp_path, cameras)[0].read_text())
    for camera in cameras:
        frame = next(f for f in meta["frames"] if camera.name in f["file_path"])
        np.testing.assert_allclose(np.array(frame["transform_matrix"])[:3, 3], camera.centre, atol=1e-15)
        for pixel in ([0, 0], [40, 7], [71, 95]):
            expected = nerfstudio_rays(frame, *pixel)
            np.testing.assert_allclose(camera.rays(np.array(pixel, float)), expected, atol=1e-12)


def test_written_distortion_is_nerfstudios_polynomial(tmp_path):
    camera = replace(ring(1)[0], distortion=FIVE)
    f = json.loads(written(tmp_path, [camera])[0].read_text())["frames"][0]
    points = in_front(camera)
    x, y, z = (points @ camera.T_camera_world[:3, :3].T + camera.T_camera_world[:3, 3]).T
    x, y = x / z, y / z
    r = x * x + y * y
    d = 1 + r * (f["k1"] + r * (f["k2"] + r * (f["k3"] + r * f["k4"])))
    u = d * x + 2 * f["p1"] * x * y + f["p2"] * (r + 2 * x * x)
    v = d * y + 2 * f["p2"] * x * y + f["p1"] * (r + 2 * y * y)
    expected = np.stack([f["fl_x"] * u + f["cx"] - 0.5, f["fl_y"] * v + f["cy"] - 0.5], axis=1)
    np.testing.assert_allclose(camera.project(points)[0], expected, atol=1e-9)


def by_hand(folder, **changes) -> None:
    """Two cameras 2 units along z and x from the origin, looking at it, at two times."""
    front = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]
    side = [[0, 0, 1, 2], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]
    frames = []
    for name, matrix in (("a", front), ("b", side)):
        for i in (1, 0):
            write_image(folder / f"images/{name}/{i}.png", np.full((20, 30, 3), 50 * (1 + i), np.uint8))
            frames.append({"file_path": f"images/{name}/{i}.png", "time": 0.25 * i, "transform_matrix": matrix})
    meta = {"fl_x": 40.0, "fl_y": 42.0, "cx": 15.5, "cy": 10.5, "w": 30, "h": 20, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(meta | changes))


def test_a_file_made_by_hand_is_read_as_its_description_says(tmp_path):
    by_hand(tmp_path)
    capture = read_transforms(tmp_path / "transforms.json", unit_m=0.1)
    assert capture.names == ("a", "b") and capture.mattes == {}
    np.testing.assert_array_equal(capture.times, [0, 0.25])
    assert capture.image("b", 1).max() == 100
    # 0.01 right and 0.02 up of the origin, 0.2 m away: 40 / 20 right, 42 / 10 up of pixel (15, 10), counted downwards
    pixel, depth = capture.camera("a").project(np.array([0.01, 0.02, 0]))
    np.testing.assert_allclose([*pixel, depth], [17, 10 - 4.2, 0.2], atol=1e-12)
    # from +x the world's -z is to the right
    pixel, depth = capture.camera("b").project(np.array([0, 0, -0.01]))
    np.testing.assert_allclose([*pixel, depth], [17, 10, 0.2], atol=1e-12)


def test_still_cameras_need_no_time_and_are_named_after_their_pictures(tmp_path):
    by_hand(tmp_path)
    meta = json.loads((tmp_path / "transforms.json").read_text())
    chosen = [meta["frames"][0], meta["frames"][2]]
    for number, frame in enumerate(chosen):
        (tmp_path / frame["file_path"]).rename(tmp_path / f"images/shot_{number}.png")
        frame["file_path"] = f"images/shot_{number}.png"
        del frame["time"]
    (tmp_path / "transforms.json").write_text(json.dumps(meta | {"frames": chosen}))
    capture = read_transforms(tmp_path)
    assert capture.names == ("shot_0", "shot_1") and len(capture.times) == 1


def moved(meta):
    meta["frames"][0]["transform_matrix"][0][3] = 0.5


def no_rotation(meta):
    for frame in meta["frames"][:2]:
        frame["transform_matrix"][0][0] = 2.0


FAULTS = {
    "model": (
        lambda m: m.update(camera_model="OPENCV_FISHEYE"),
        "camera_model must be one of OPENCV, .*; got OPENCV_F",
    ),
    "k4": (
        lambda m: m.update(k4=0.1),
        r"transforms\.json \(a\) k4 must be 0: OpenCV's model has no such term; got 0.1",
    ),
    "moving": (moved, r"transforms\.json \(.*\) must have one picture at each of the 2 times, .*; got 1 pictures"),
    "rotation": (no_rotation, r"transforms\.json: a extrinsic must hold a rotation and a shift"),
    "picture": (
        lambda m: m["frames"][0].update(file_path="images/a/9.png"),
        r"9\.png \(a\) must be a readable picture",
    ),
    "lens": (lambda m: m.pop("fl_x"), r"transforms\.json \(images/a/1\.png\) must hold fl_x, .*; got no fl_x"),
    "mask": (lambda m: m["frames"][0].update(mask_path="x.png"), r"\(a\) must have a mask_path for all or none; got 1"),
    "frames": (lambda m: m.pop("frames"), r"transforms\.json must hold a list of frames; got none"),
}


@pytest.mark.parametrize("case", FAULTS)
def test_foreign_files_are_one_sentence(tmp_path, case):
    by_hand(tmp_path)
    meta = json.loads((tmp_path / "transforms.json").read_text())
    FAULTS[case][0](meta)
    (tmp_path / "transforms.json").write_text(json.dumps(meta))
    with pytest.raises(ValueError, match=FAULTS[case][1]):
        capture = read_transforms(tmp_path)
        list(capture.sources["a"].frames())


def turned_by(q: list[float], p: np.ndarray) -> np.ndarray:
    """Hamilton's q p q* for a unit quaternion (w, x, y, z)."""
    w, v = q[0], np.array(q[1:])
    return p + 2 * w * np.cross(v, p) + 2 * np.cross(v, np.cross(v, p))


def test_colmap_projects_to_the_same_pixels(tmp_path):
    full = np.array([0.1, -0.05, 0.001, 0.002, 0.01, 0.02, -0.01, 0.005])
    cameras = [replace(camera, distortion=d) for camera, d in zip(ring(3), (full, FIVE, np.zeros(12)), strict=True)]
    back = look_at(np.array([0, 0, 0.5]), np.zeros(3), np.array([0, -1.0, 0]))
    cameras.append(replace(cameras[2], name="back", T_camera_world=back))
    write_colmap(tmp_path, cameras, points=in_front(cameras[0], 4), colors=np.full((4, 3), 200))
    lens = [line.split() for line in (tmp_path / "cameras.txt").read_text().splitlines() if line[0] != "#"]
    lines = (tmp_path / "images.txt").read_text().split("\n")
    views = [line.split() for line in lines[2::2] if line]
    assert [view[9] for view in views] == [f"{camera.name}.png" for camera in cameras] and not any(lines[3::2])
    for camera, one, view in zip(cameras, lens, views, strict=True):
        assert one[0] == view[8] and one[1] == ("FULL_OPENCV" if camera.distortion.any() else "PINHOLE")
        assert (int(one[2]), int(one[3])) == camera.size
        fx, fy, cx, cy, *k = map(float, one[4:])
        k1, k2, p1, p2, k3, k4, k5, k6 = k or [0.0] * 8
        points, q, t = in_front(camera), [float(w) for w in view[1:5]], np.array([float(w) for w in view[5:8]])
        x, y, z = (turned_by(q, points) + t).T
        u, v = x / z, y / z
        r = u * u + v * v
        radial = (1 + k1 * r + k2 * r**2 + k3 * r**3) / (1 + k4 * r + k5 * r**2 + k6 * r**3)
        column = fx * (u * radial + 2 * p1 * u * v + p2 * (r + 2 * u * u)) + cx
        row = fy * (v * radial + 2 * p2 * u * v + p1 * (r + 2 * v * v)) + cy
        np.testing.assert_allclose(np.stack([column, row], axis=1) - 0.5, camera.project(points)[0], atol=1e-9)
    cloud = np.loadtxt(tmp_path / "points3D.txt")
    np.testing.assert_array_equal(cloud[:, 1:4], in_front(cameras[0], 4))
    np.testing.assert_array_equal(cloud[:, 4:], [[200, 200, 200, 0]] * 4)


def test_lenses_that_a_format_cannot_hold_are_refused(tmp_path):
    prism, plain = ring(1)[0], ring(1)[0].undistorted()
    skewed = replace(plain, K=plain.K + np.array([[0, 0.1, 0], [0, 0, 0], [0, 0, 0]]))
    with pytest.raises(ValueError, match=r"cam0001 distortion must have no thin-prism or tilt terms in COLMAP"):
        write_colmap(tmp_path, [prism])
    with pytest.raises(ValueError, match="cam0001 intrinsic must have no skew in COLMAP"):
        write_colmap(tmp_path, [skewed])
    with pytest.raises(ValueError, match="pictures must have names without spaces"):
        write_colmap(tmp_path, [plain], pictures=["a b.png"])
    with pytest.raises(ValueError, match="cam0001 distortion must end with k3 in nerfstudio"):
        written(tmp_path, [prism])
    with pytest.raises(ValueError, match="cam0001 intrinsic must have no skew in nerfstudio"):
        written(tmp_path, [skewed])
    with pytest.raises(ValueError, match="pictures of cam0001 must be 3, one a time; got 2"):
        write_transforms(tmp_path, [plain], np.arange(3.0), lambda name: [np.zeros((96, 72, 3), np.uint8)] * 2)
