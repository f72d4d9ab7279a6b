"""Sampled bodies fill their shape evenly; tied markers follow every affine motion exactly."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from sim._open3d import load_open3d
from veo_ti.body import sample_box, sample_mesh, tie_markers

SIZE, CORNER = np.array([0.1, 0.03, 0.03]), np.array([-0.1, 0, 0])


@pytest.fixture(scope="module")
def beam():
    return sample_box(SIZE, 800, corner=CORNER, seed=3)


def mesh_file(path, shape):
    assert load_open3d().io.write_triangle_mesh(str(path), shape)
    return path


def torus(path, scale=1.0):
    shape = load_open3d().geometry.TriangleMesh.create_torus(0.1, 0.03, 60, 40)
    return mesh_file(path, shape.scale(scale, np.zeros(3)))


def test_volumes_sum_to_the_box(beam):
    assert beam.volume.sum() == pytest.approx(np.prod(SIZE), rel=1e-14)
    assert (beam.volume > 0).all() and len(beam.x) == 800
    first_moment = beam.volume @ beam.x / beam.volume.sum()
    np.testing.assert_allclose(first_moment, CORNER + SIZE / 2, atol=0.1 * beam.spacing)


def test_surface_points_lie_on_the_box_and_others_inside(beam):
    gap = np.minimum(beam.x - CORNER, CORNER + SIZE - beam.x).min(axis=1)
    assert (gap >= 0).all() and (gap[beam.surface] == 0).all() and (gap[~beam.surface] > 0.3 * beam.spacing).all()
    corners = np.array([[x, y, z] for x in (-0.1, 0) for y in (0, 0.03) for z in (0, 0.03)])
    np.testing.assert_allclose(cKDTree(beam.x).query(corners)[0], 0, atol=1e-15)


def test_points_are_evenly_spread_without_a_lattice(beam):
    nearest = cKDTree(beam.x).query(beam.x, k=2)[0][:, 1]
    assert nearest.min() > 0.45 * beam.spacing and nearest.max() < 1.6 * beam.spacing
    random = np.random.default_rng(0).random((800, 3)) * SIZE
    spread = cKDTree(random).query(random, k=2)[0][:, 1]
    assert nearest.std() / nearest.mean() < 0.5 * spread.std() / spread.mean()
    assert len(np.unique(np.round(beam.x[~beam.surface], 9))) > 2.9 * (~beam.surface).sum()


def test_box_normals_point_outward_and_faces_have_the_right_share(beam):
    on_top = beam.surface & (np.abs(beam.normals - [0, 0, 1]).max(axis=1) < 1e-12)
    assert (beam.x[on_top, 2] == 0.03).all() and on_top.sum() > 40
    np.testing.assert_allclose(np.linalg.norm(beam.normals[beam.surface], axis=1), 1)
    assert not beam.normals[~beam.surface].any()
    outward = np.einsum("nc,nc->n", beam.normals, beam.x - (CORNER + SIZE / 2))
    assert (outward[beam.surface] > 0).all()


def test_same_seed_gives_the_same_bits():
    a, b, c = (sample_box(SIZE, 200, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a.x, b.x)
    np.testing.assert_array_equal(a.volume, b.volume)
    assert not np.array_equal(a.x, c.x)


@pytest.mark.parametrize("name", ["torus.ply", "torus.stl"])
def test_mesh_is_filled(tmp_path, name):
    shape = load_open3d().geometry.TriangleMesh.create_torus(0.1, 0.03, 60, 40)
    body = sample_mesh(mesh_file(tmp_path / name, shape.compute_vertex_normals()), 600)
    assert len(body.x) == 600 and body.volume.sum() == pytest.approx(shape.get_volume(), rel=1e-6)
    tube = np.hypot(np.hypot(body.x[:, 0], body.x[:, 1]) - 0.1, body.x[:, 2])  # distance from the tube's centre line
    assert tube[body.surface].min() > 0.0295 and tube.max() < 0.0301 and tube[~body.surface].max() < 0.029
    ring = 0.1 * body.x * [1, 1, 0] / np.hypot(body.x[:, 0], body.x[:, 1])[:, None]
    outward = (body.x - ring) / tube[:, None]
    assert np.einsum("nc,nc->n", outward, body.normals)[body.surface].min() > 0.98


def test_mesh_lengths_are_scaled(tmp_path):
    path = torus(tmp_path / "mm.ply", scale=1000.0)
    with pytest.raises(ValueError, match="260 m across, which looks like millimetres"):
        sample_mesh(path, 400)
    assert np.ptp(sample_mesh(path, 400, scale=1e-3).x[:, 0]) == pytest.approx(0.26, rel=0.02)


def test_inside_out_mesh_is_turned(tmp_path):
    shape = load_open3d().geometry.TriangleMesh.create_box(0.1, 0.1, 0.1)
    shape.triangles = load_open3d().utility.Vector3iVector(np.asarray(shape.triangles)[:, ::-1])
    body = sample_mesh(mesh_file(tmp_path / "a.ply", shape), 300)
    assert body.volume.sum() == pytest.approx(1e-3)
    assert (np.einsum("nc,nc->n", body.normals, body.x - 0.05)[body.surface] > 0).all()


def test_shapes_without_an_inside_are_refused(tmp_path):
    o3d = load_open3d()
    holed = o3d.geometry.TriangleMesh.create_sphere(0.1)
    holed.triangles = o3d.utility.Vector3iVector(np.asarray(holed.triangles)[:-1])
    with pytest.raises(ValueError, match=r"mesh must be closed; got holes or crossing sheets in holed\.ply"):
        sample_mesh(mesh_file(tmp_path / "holed.ply", holed), 300)
    (tmp_path / "words.ply").write_text("words")
    with pytest.raises(ValueError, match="file must hold a triangle mesh"):
        sample_mesh(tmp_path / "words.ply", 300)
    with pytest.raises(ValueError, match="file must exist"):
        sample_mesh(tmp_path / "nowhere.ply", 300)
    with pytest.raises(ValueError, match="size must be positive along all three axes"):
        sample_box((0.1, 0.1, 0), 300)
    with pytest.raises(ValueError, match="100 m across, which looks like millimetres"):
        sample_box((100, 30, 30), 300)
    with pytest.raises(ValueError, match="count must be at least 32; got 3"):
        sample_box(SIZE, 3)
    with pytest.raises(ValueError, match=r"count must be larger for a shape this thin, about \d+; got 500"):
        sample_box((0.3, 0.3, 0.001), 500)


def test_tied_markers_follow_affine_motion_exactly(beam):
    markers = np.array([[0, 0.015, 0.036], [0, -0.006, 0.024], [0, 0.036, 0.006], [-0.05, 0.015, 0.015]])
    ties = tie_markers(beam.x, markers)
    np.testing.assert_allclose(np.asarray(ties.weights.sum(axis=1)).ravel(), 1, atol=1e-12)
    rng = np.random.default_rng(0)
    for _ in range(3):
        a, b = rng.standard_normal((3, 3)), rng.standard_normal(3)
        np.testing.assert_allclose(ties.positions(beam.x @ a.T + b), markers @ a.T + b, atol=1e-12)
    both = ties.positions(np.stack([beam.x, 2 * beam.x]))
    np.testing.assert_allclose(both, [markers, 2 * markers], atol=1e-12)
    assert ties.offset[0] == pytest.approx(0.006, abs=0.4e-3) and (ties.amplification < 1.5).all()


def test_tied_markers_follow_a_bent_beam(beam):
    def bent(p):  # arc of curvature 6 / m: the tip drops by 28 mm
        angle, z = 6 * (p[:, 0] + 0.1), p[:, 2] - 0.015
        across = np.stack([np.sin(angle), np.cos(angle)], axis=1) * z[:, None]
        return np.stack([np.sin(angle) / 6 + across[:, 0], p[:, 1], (np.cos(angle) - 1) / 6 + across[:, 1]], axis=1)

    markers = np.array([[0, 0.015, 0.036], [0, -0.006, 0.024], [0, 0.036, 0.006]])
    error = tie_markers(beam.x, markers).positions(bent(beam.x)) - bent(markers)
    assert np.linalg.norm(error, axis=1).max() < 0.0004  # second order: curvature x patch^2 / 2 = 6 x 0.011^2 / 2


def test_markers_that_cannot_be_tied_are_named(beam):
    with pytest.raises(
        ValueError, match=r"markers must lie within one body length, 0\.1 m, .*; got markers 1 further away"
    ):
        tie_markers(beam.x, np.array([[0, 0, 0], [100, 0, 0.0]]))
    flat = beam.x * [1, 1, 0]
    with pytest.raises(ValueError, match="x must surround marker 0 in all three directions; got points in one plane"):
        tie_markers(flat + 1e-12 * beam.x, np.array([[0, 0, 0.01]]))
