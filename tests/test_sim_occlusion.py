"""What the air of a nozzle reaches: shadows of known size, convex bodies, rays cast by another library."""

import numpy as np
import pytest
from clouds import rotation, sphere

from sim._open3d import load_open3d
from sim.occlusion import reached
from sim.terms.jet import DistanceLaw, Jet, jet_forces

ORIGIN, AHEAD = np.zeros(3), np.array([0.0, 0.0, 1.0])
STEP = 0.006


def plate(half: float, height: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    """A square plate at z = height that faces down."""
    side = np.arange(-half, half + step / 2, step)
    x = np.stack([*np.meshgrid(side, side, indexing="ij"), np.full((len(side),) * 2, height)], axis=-1).reshape(-1, 3)
    return x, np.tile([0.0, 0.0, -(step**2)], (len(x), 1))


def ball_before_plate(step: float = STEP) -> tuple[np.ndarray, np.ndarray, int]:
    ball, out = sphere(int(4 * np.pi * (0.05 / step) ** 2), 0.05, (0, 0, 0.3))
    wall, back = plate(0.2, 0.5, step)
    return np.concatenate([ball, wall]), np.concatenate([out, back]), len(ball)


def test_ball_casts_a_shadow_of_the_right_size():
    y, area, n = ball_before_plate()
    seen = reached(ORIGIN, AHEAD, y, area, STEP)[n:]
    shadow = 0.5 * np.tan(np.arcsin(0.05 / 0.3))  # where the cone that touches the ball meets the plate
    radius = np.linalg.norm(y[n:, :2], axis=1)
    assert not seen[radius < shadow - 3 * STEP].any() and (seen[radius > shadow + 3 * STEP] == 1).all()
    assert np.sqrt((1 - seen).sum() * STEP**2 / np.pi) == pytest.approx(shadow, rel=0.01)


def test_outline_is_soft():
    y, area, n = ball_before_plate()
    seen = reached(ORIGIN, AHEAD, y, area, STEP)[n:]
    assert ((seen > 0.05) & (seen < 0.95)).sum() > 50


@pytest.mark.parametrize("nozzle", [(0.3, 0.1, 0.0), (0.0, -0.2, 0.25), (-0.12, 0.02, 0.03)])
def test_convex_body_shows_exactly_what_faces_the_nozzle(nozzle):
    axes, nozzle = np.array([0.1, 0.06, 0.04]), np.array(nozzle)
    x, out = sphere(3000, 1.0, (0, 0, 0))
    y, area = x * axes, out / axes * axes.prod()
    seen = reached(nozzle, -nozzle, y, area, 0.004)
    cosine = -((y - nozzle) * area).sum(axis=1) / np.linalg.norm(y - nozzle, axis=1) / np.linalg.norm(area, axis=1)
    np.testing.assert_array_equal(seen > 0, cosine > 0)
    np.testing.assert_array_equal(seen == 1, cosine >= 0.1)


def test_turning_everything_changes_nothing():
    y, area, _ = ball_before_plate(0.01)
    turn, shift = rotation(0.8), np.array([0.3, -0.1, 2.0])
    expected = reached(ORIGIN, AHEAD, y, area, 0.01)
    turned = reached(shift, turn @ AHEAD, y @ turn.T + shift, area @ turn.T, 0.01)
    np.testing.assert_allclose(turned, expected, atol=1e-6)


def test_behind_the_nozzle_nothing_is_reached():
    y, area, _ = ball_before_plate(0.02)
    assert not reached(ORIGIN, -AHEAD, y, area, 0.02).any()


def test_points_asked_for_get_the_same_answer():
    y, area, _ = ball_before_plate(0.01)
    asked = np.random.default_rng(0).random(len(y)) < 0.2
    every = reached(ORIGIN, AHEAD, y, area, 0.01)
    np.testing.assert_allclose(reached(ORIGIN, AHEAD, y, area, 0.01, asked=asked), every * asked, atol=1e-12)


def test_ring_agrees_with_cast_rays():
    """A torus seen edge-on hides its own far side: rays through its mesh say where."""
    o3d = load_open3d()
    mesh = o3d.geometry.TriangleMesh.create_torus(0.1, 0.03, 120, 60)
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    y, nozzle = corners.mean(axis=1), np.array([0.35, 0.02, 0.06])
    seen = reached(nozzle, -nozzle, y, area, 0.005)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    way = y - nozzle
    hit = scene.cast_rays(
        o3d.core.Tensor(np.concatenate([np.tile(nozzle, (len(y), 1)), way], axis=1), o3d.core.float32)
    )
    free = hit["t_hit"].numpy() > 1 - 1e-3
    facing = -(way * area).sum(axis=1) / np.linalg.norm(way, axis=1)
    weight = np.maximum(facing, 0)
    assert 0.05 < weight[~free].sum() / weight.sum() < 0.5  # the ring does hide a part of itself
    assert weight[free != (seen > 0.5)].sum() < 0.02 * weight.sum()


def test_jet_blows_on_nothing_behind_the_ball():
    y, area, n = ball_before_plate(0.01)
    jet = Jet(position=ORIGIN[None], direction=AHEAD[None], force=np.ones(1), footprint=0.03)
    forces, law = jet_forces(jet, y, area, spacing=0.01), DistanceLaw(core=1.0)
    np.testing.assert_array_equal(jet_forces(jet, y, area, spacing=0.01, law=law), forces)
    front = y[:n, 2] < 0.3 - 0.02  # clear of the horizon
    np.testing.assert_allclose(forces[0, :n][front], jet_forces(jet, y, area)[0, :n][front], rtol=1e-12)
    shade = np.linalg.norm(y[n:, :2], axis=1) < 0.05
    assert not forces[0, n:][shade].any() and jet_forces(jet, y, area)[0, n:][shade].any()


def test_every_frame_has_its_own_shade():
    y, area, n = ball_before_plate(0.01)
    position = np.array([[0, 0, 0.0], [0.1, 0, 0]])
    jet = Jet(position=position, direction=np.tile(AHEAD, (2, 1)), force=np.ones(2), footprint=0.05)
    both = jet_forces(jet, y, area, spacing=0.01)
    for k in (0, 1):
        one = Jet(position=position[[k]], direction=AHEAD[None], force=np.ones(1), footprint=0.05)
        np.testing.assert_allclose(both[k], jet_forces(one, y, area, spacing=0.01)[0], atol=1e-15)
    centre = (both[:, n:] * y[n:, :1]).sum(axis=(1, 2)) / both[:, n:].sum(axis=(1, 2))
    assert centre[1] - centre[0] > 0.05  # the bright spot on the wall wanders with the nozzle


def test_unsound_spacing_is_named():
    y, area, _ = ball_before_plate(0.02)
    with pytest.raises(ValueError, match=r"spacing must be positive; got 0\.0"):
        reached(ORIGIN, AHEAD, y, area, 0.0)
    with pytest.raises(ValueError, match="area must have shape"):
        reached(ORIGIN, AHEAD, y, area[1:], 0.02)
