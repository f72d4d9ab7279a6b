"""The rig's pictures: rasterised triangles against closed forms, the lens against a second way to bend a picture."""

from dataclasses import replace

import numpy as np
import pytest

from recon.cameras import Camera, Resampling, look_at
from recon.mattes.masks import brightness_mask
from recon.rig.backdrop import backdrop
from recon.rig.bake import Baked
from recon.rig.body import six
from recon.rig.film import Film
from recon.rig.light import irradiance, normals, plain_light
from recon.rig.motion import load_motion
from recon.rig.options import RigOptions
from recon.rig.props import nozzle, paper_half
from recon.rig.raster import Shade, rasterise
from recon.rig.replay import Replay, stream_of
from recon.rig.sensor import Sensor
from recon.rig.stage import build_stage
from recon.rig.texture import colour_of


def sphere(radius: float, centre: tuple, rings: int = 96) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and triangles (M, 3), outwards, of a sphere."""
    up, round_ = np.meshgrid(np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, 2 * rings, endpoint=False))
    points = np.stack([np.sin(up) * np.cos(round_), np.sin(up) * np.sin(round_), np.cos(up)], axis=-1)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(2 * rings), np.arange(rings), indexing="ij"))
    a, b = i * (rings + 1) + j, (i + 1) % (2 * rings) * (rings + 1) + j
    return radius * points.reshape(-1, 3) + centre, np.concatenate(
        [np.stack(t, 1) for t in ((a, a + 1, b), (a + 1, b + 1, b))]
    )


def pinhole(size: tuple[int, int], focal: float, distortion: tuple = (), target: tuple = (0, 0, 0.15)) -> Camera:
    K = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])
    T = look_at(np.array([0.0, -0.8, 0.3]), np.array(target), np.array([0, 0, 1.0]))
    return Camera(name="cam0001", K=K, T_camera_world=T, size=size, distortion=np.array(distortion))


def test_sphere_is_seen_where_rays_meet_it():
    camera, centre = pinhole((120, 200), 260.0), np.array([0.03, 0.02, 0.16])
    points, triangles = sphere(0.1, tuple(centre))
    pixels, depth = camera.project(points)
    seen = rasterise(pixels, depth, triangles, camera.size)
    rays = camera.rays(camera.grid())
    middle = rays @ (centre - camera.centre)
    inside = middle**2 - ((centre - camera.centre) ** 2).sum() + 0.1**2
    assert (seen.hit != (inside > 0)).mean() < 2e-3
    both = seen.hit & (inside > 3e-4)
    far = (middle - np.sqrt(np.maximum(inside, 0)))[both] * (rays @ camera.axis)[both]
    np.testing.assert_allclose(seen.depth[both], far, atol=3e-4)
    corners, weights = seen.corners(triangles)
    place = np.einsum("mkj,mk->mj", points[corners], weights)
    there, _ = camera.project(place)
    np.testing.assert_allclose(there, camera.grid()[seen.hit], atol=1e-2)  # perspective is right inside triangles


def test_nearer_triangle_wins_whatever_the_order():
    points = np.array([[0, 0], [9, 0], [0, 9.0], [0, 0], [9, 0], [0, 9.0]])
    depth = np.array([2.0, 2, 2, 1, 3, 3])
    for order in ([[0, 1, 2], [3, 4, 5]], [[3, 4, 5], [0, 1, 2]]):
        seen = rasterise(points, depth, np.array(order), (10, 10), flat=True)
        front = order.index([3, 4, 5])
        # by hand: the second plane is 1 + 2 (x + y) / 9, nearer than 2 where x + y < 4.5
        column, row = np.meshgrid(np.arange(10), np.arange(10))
        np.testing.assert_array_equal(seen.triangle == front, column + row < 4.5)
        assert (seen.triangle[column + row > 9] == -1).all()
    np.testing.assert_array_equal(rasterise(points * np.nan, depth, np.array(order), (10, 10)).triangle, -1)


def test_lens_bends_the_picture_as_opencv_unbends_it():
    """A film behind a strong lens, unbent by Resampling, is the film behind no lens."""
    motion = load_motion("plush")
    film = Film("plush", Replay.of(motion, 4), 96)
    lens = (-0.2, 0.05, 2e-3, -2e-3, 0.0, 0.0, 0.0, 0.0, 1e-3, 0.0, -1e-3, 0.0)
    bent = pinhole((240, 320), 300.0, lens, target=(0.15, 0, 0.35))  # the object is off the middle
    plain = bent.undistorted()
    pictures = []
    for camera in (bent, plain):
        view, out = film.view(camera, 1, 4), np.zeros((320, 240), np.float32)
        out[view.row : view.row + len(view.matte), view.column : view.column + view.matte.shape[1]] = view.matte
        pictures.append(out)
    straight = Resampling.of(bent, plain)(pictures[0])
    assert np.abs(straight - pictures[1]).mean() < 0.1 * np.abs(pictures[0] - pictures[1]).mean()
    assert ((straight > 0.5) != (pictures[1] > 0.5)).sum() < 0.01 * (pictures[1] > 0.5).sum()


def test_marker_is_drawn_where_the_layout_says():
    """The paper's middle is the marker's origin; the tube's tip is where the stream starts, the tube lies behind it."""
    replay = Replay.of(load_motion("pillow"), 5)
    T = replay.T_stage_marker(2)
    mesh = nozzle(T)
    paper = np.abs(mesh.place).max(axis=1) < 0.2  # NaN beside it
    np.testing.assert_allclose(mesh.points[paper].mean(axis=0), T[:3, 3], atol=1e-12)
    edge = np.linalg.norm(mesh.points[np.abs(mesh.place).max(axis=1) <= 1] - T[:3, 3], axis=1).max()
    assert edge == pytest.approx(paper_half() * np.sqrt(2), rel=1e-6)
    start, way = stream_of(T)
    stream = replay.stream(2)
    np.testing.assert_allclose(start, stream.position, atol=1e-12)
    np.testing.assert_allclose(way, stream.direction, atol=1e-12)
    assert ((mesh.points - start) @ way).max() < 0.015  # the end of the post behind the plate


def test_light_is_what_no_shadow_leaves():
    """A sphere that nothing shades gets the plain light; the side of another one that faces it gets less."""
    points, triangles = sphere(0.05, (0, 0, 0.3), 24)
    facing = normals(points, triangles)
    np.testing.assert_allclose(facing, (points - [0, 0, 0.3]) / 0.05, atol=0.1)
    alone = irradiance(points, facing, points, triangles)
    assert np.abs(alone - plain_light(facing)).max() < 0.12 and np.abs((alone - plain_light(facing)).mean()) < 0.02
    other, _ = sphere(0.05, (0.101, 0, 0.3), 24)
    both = irradiance(
        points, facing, np.concatenate([points, other]), np.concatenate([triangles, triangles + len(points)])
    )
    assert (both < alone + 0.05).all() and both[facing[:, 0] > 0.95].mean() < 0.6 * alone[facing[:, 0] > 0.95].mean()


def test_shade_counts_what_lies_before():
    points, triangles = sphere(0.05, (0, 0, 0.3), 24)
    shade = Shade.cast(points, triangles, np.array([0, 0, -1.0]), 0.004)
    np.testing.assert_allclose(shade.lit(np.array([[0, 0, 0.35], [0, 0, 0.25], [0.2, 0.2, 0.0]]), 0.003), [1, 0, 1])


def test_baked_texture_is_the_solid_one():
    body = load_motion("leaf").body
    baked = Baked.of("leaf", body, 4, 24)
    _, triangles = body.skin(4)
    rng = np.random.default_rng(0)
    number = rng.integers(len(triangles), size=4000)
    second, third = rng.dirichlet(np.ones(3), 4000)[:, 1:].T
    weights, _ = body.skin(4)
    corner = (weights @ body.nodes)[triangles[number]]
    place = (
        corner[:, 0] + second[:, None] * (corner[:, 1] - corner[:, 0]) + third[:, None] * (corner[:, 2] - corner[:, 0])
    )
    off = baked(number, second.astype(np.float32), third.astype(np.float32)) - colour_of("leaf", place)
    assert np.abs(off).mean() < 0.012 and six(np.full((1, 3), 1 / 3)).sum() == pytest.approx(1)


def test_sensor_adds_the_noise_and_drift_asked_for():
    camera = build_stage(RigOptions(cameras=4, size=96)).cameras[0]
    flat = np.full((*camera.size[::-1], 3), 0.2, np.float32)
    quiet = Sensor.of(camera, 40, 0.0, 0.05, 0)
    levels = np.array([quiet.exposed(quiet.shown(flat), f)[0, 0, 0] for f in range(40)], float)
    # by hand: 255 * 0.2^(1 / 2.2) = 122.7, times 1.05^(1 / 2.2) at most
    assert 122.7 / 1.05**0.5 - 1 < levels.min() < 122.7 < levels.max() < 122.7 * 1.05**0.5 + 1
    noisy = Sensor.of(camera, 40, 3.0, 0.0, 0)
    frames = np.stack([noisy.exposed(noisy.shown(flat), f) for f in range(6)]).astype(float)
    assert frames.std() == pytest.approx(3.0, rel=0.03) and frames.mean() == pytest.approx(122.7, abs=0.2)
    assert abs(np.corrcoef(frames[0].ravel(), frames[1].ravel())[0, 1]) < 0.05


def test_cloth_is_dark_and_lamps_are_seen():
    stage = build_stage(RigOptions(cameras=19, size=96, greys=False))
    pictures = [backdrop(stage.on_stage(camera)) for camera in stage.cameras[:16]]
    assert max(np.median(p) for p in pictures) < 0.006  # black in the video
    assert sum(p.max() > 1 for p in pictures) >= 3
    again = backdrop(replace(stage.on_stage(stage.cameras[0])))
    np.testing.assert_array_equal(again, pictures[0])


def test_light_on_the_cloth_is_not_the_object():
    """A wide glow that the picture's edge cuts, as bright in places as a part of the object that stands alone."""
    rows, columns = np.indices((240, 160))
    glow = 14 + 45 * np.exp(-((np.hypot(rows, columns - 60) / 45) ** 2))
    thing = (np.hypot(rows - 150, columns - 80) < 35) | (np.hypot(rows - 215, columns - 80) < 12)
    noise = np.random.default_rng(0).normal(0, 1.5, glow.shape)
    found = brightness_mask(np.clip(np.where(thing, 85, glow) + noise, 0, 255).astype(np.uint8))
    assert (found & thing).sum() / (found | thing).sum() > 0.95
