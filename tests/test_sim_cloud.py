"""The rest cloud: linear exactness, the divergence theorem, volumes, surfaces, and the sentences of bad clouds."""

import clouds
import numpy as np
import pytest
import sim_cases

from sim.cloud import CloudOptions, RestCloud

F0 = np.array([[1.3, 0.4, -0.2], [0.1, 0.8, 0.3], [-0.3, 0.2, 1.1]])
KINDS = ("jittered", "regular", "poisson")
MODES = ("consistent", "paper")


def uniform_stress_force(cloud: RestCloud) -> np.ndarray:
    """What a uniform stress pushes each point with, beyond its area vector times that stress, (N, 3) [N]."""
    return cloud.divergence(np.tile(F0, (1, cloud.count, 1, 1)))[0] - cloud.area @ F0.T


def stretched_block(ratio: float) -> np.ndarray:
    """A regular grid whose step in x is `ratio` times the others."""
    return clouds.block((8, 6, 5), (0.7 * ratio, 0.5, 0.4), jitter=0.0)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("kind", KINDS)
def test_linear_fields_are_reproduced_exactly(kind, mode):
    cloud = sim_cases.cloud(kind, mode)
    F = cloud.deformation_gradient((cloud.x @ F0.T + [1.0, -2.0, 3.0])[None])
    assert np.abs(F - F0).max() < 1e-10


@pytest.mark.parametrize("ratio", [1.5, 2.0])
def test_anisotropic_grid_is_linearly_exact_and_obeys_the_divergence_theorem(ratio):
    cloud = RestCloud.build(stretched_block(ratio))
    size = np.linalg.norm(cloud.area, axis=1).max() * np.linalg.norm(F0)
    assert np.abs(cloud.deformation_gradient((cloud.x @ F0.T)[None]) - F0).max() < 1e-10
    assert np.abs(uniform_stress_force(cloud)).max() < 1e-5 * size


@pytest.mark.parametrize("kind", KINDS)
def test_uniform_stress_acts_on_the_surface_only(kind):
    cloud = sim_cases.cloud(kind)
    size = np.linalg.norm(cloud.area, axis=1).max() * np.linalg.norm(F0)
    assert np.abs(uniform_stress_force(cloud)).max() < 1e-5 * size
    assert (cloud.area[~cloud.surface] == 0).all()


@pytest.mark.parametrize("kind", KINDS)
def test_plain_scheme_breaks_the_divergence_theorem(kind):
    cloud = sim_cases.cloud(kind, "paper")
    size = np.linalg.norm(cloud.area, axis=1).max() * np.linalg.norm(F0)
    assert np.abs(uniform_stress_force(cloud)).max() > 0.1 * size


@pytest.mark.parametrize("mode", MODES)
def test_divergence_is_the_transpose_of_the_gradient(mode):
    cloud, random = sim_cases.cloud("jittered", mode), np.random.default_rng(0)
    P, u = random.normal(size=(2, cloud.count, 3, 3)), random.normal(size=(2, cloud.count, 3))
    power = (cloud.volume[:, None, None] * P * (cloud.deformation_gradient(u + cloud.x) - np.eye(3))).sum()
    assert (cloud.divergence(P) * u).sum() == pytest.approx(power, rel=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_volumes_sum_to_the_box(kind):
    cloud = sim_cases.cloud(kind, count=1000)
    assert cloud.volume.sum() == pytest.approx(sim_cases.SIZE.prod(), rel=2e-3)
    assert (cloud.volume > 0).all()


def test_volume_of_a_bent_bar_has_no_flesh_in_its_corner():
    x = clouds.block((9, 9, 4), (0.8, 0.8, 0.3), jitter=0.1)
    bar = x[(x[:, 0] < 0.31) | (x[:, 1] < 0.31)]
    step = 0.1
    assert RestCloud.build(bar).volume.sum() == pytest.approx(0.3 * (0.8**2 - 0.5**2), abs=0.3 * 0.5 * step)


@pytest.mark.parametrize("kind", KINDS)
def test_area_vectors_close_and_measure_the_volume(kind):
    cloud = sim_cases.cloud(kind)
    assert np.abs(cloud.area.sum(axis=0)).max() < 1e-12
    assert cloud.x.T @ cloud.area == pytest.approx(cloud.volume.sum() * np.eye(3), abs=2e-2 * cloud.volume.sum())


def test_surface_of_a_box_is_found_with_its_normals():
    cloud, size = sim_cases.cloud("jittered"), sim_cases.SIZE
    low, high = cloud.x < 1e-9, cloud.x > size - 1e-9
    assert (cloud.surface == (low | high).any(axis=1)).all()
    face = (low.sum(axis=1) + high.sum(axis=1)) == 1  # neither edge nor corner
    outward = high[face].astype(float) - low[face]
    assert (cloud.normals[face] * outward).sum(axis=1).min() > 0.99
    assert np.abs(cloud.area[high[:, 0], 0].sum() - size[1] * size[2]) < 0.1 * size[1] * size[2]


def test_normals_of_edges_and_corners_do_not_depend_on_how_the_faces_are_cut():
    h, ends = np.array([1.0, 0.8, 0.9]), np.array([3, 4, 3])  # of a grid whose squares are cut along either diagonal
    at = np.indices(ends + 1).reshape(3, -1).T
    side = (at == ends).astype(float) - (at == 0)
    beside = h[[1, 2, 0]] * h[[2, 0, 1]] / 4  # a quarter of each square, that a point of a flat grid has on each side
    expected = side * beside * np.where(side == 0, 2, 1).prod(axis=1, keepdims=True)
    cloud = RestCloud.build(at * h)
    expected /= np.maximum(np.linalg.norm(expected, axis=1, keepdims=True), 1e-300)
    np.testing.assert_allclose(cloud.normals, expected, atol=1e-12)


def test_cloud_does_not_depend_on_the_order_of_its_points():
    cloud = sim_cases.cloud("jittered")
    order = np.random.default_rng(1).permutation(cloud.count)
    other, y = RestCloud.build(cloud.x[order]), sim_cases.bent(cloud)
    # The hull shakes points by 1e-6 of their spacing, each by its place in the list.
    assert np.abs(other.deformation_gradient(y[:, order]) - cloud.deformation_gradient(y)[:, order]).max() < 1e-4
    assert other.volume == pytest.approx(cloud.volume[order], rel=1e-3)


def test_cloud_is_the_same_to_the_bit_when_built_twice():
    cloud = sim_cases.cloud("poisson")
    again = RestCloud.build(cloud.x)
    assert (again.gradients == cloud.gradients).all()
    assert (again.volume == cloud.volume).all()


def test_gradients_do_not_depend_on_the_unit_of_length():
    cloud = sim_cases.cloud("jittered")
    assert sim_cases.relative(1e3 * RestCloud.build(1e3 * cloud.x).gradients, cloud.gradients) < 1e-6


def test_incident_lists_hold_every_edge_once():
    cloud = sim_cases.cloud("jittered")
    ends = np.repeat(np.arange(cloud.count), np.diff(cloud.incident_start))
    assert (cloud.neighbours[cloud.incident_point, cloud.incident_slot] == ends).all()
    assert len(set(zip(cloud.incident_point, cloud.incident_slot, strict=True))) == cloud.neighbours.size


def test_separate_bodies_are_told_apart():
    x = clouds.block((4, 4, 4), (0.3, 0.3, 0.3))
    cloud = RestCloud.build(np.concatenate([x, x + np.array([5.0, 0, 0])]))
    assert (cloud.island == np.repeat(cloud.island[[0, -1]], len(x))).all()
    assert cloud.island[0] != cloud.island[-1]


def test_given_volumes_and_surface_are_taken():
    x, random = sim_cases.points(), np.random.default_rng(0)
    volume, surface = random.uniform(1, 2, len(x)), random.uniform(size=len(x)) < 0.5
    cloud = RestCloud.build(x, volume=volume, surface=surface)
    assert (cloud.volume == volume).all()
    assert (cloud.surface == surface).all()
    assert RestCloud.build(x, volume=0.7).volume.sum() == pytest.approx(0.7, rel=1e-12)


def forked(jitter: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices of unit cells that fill a body with two ears a cell apart, their volumes, and their outward normals."""
    cells = np.ones((7, 4, 7), bool)
    cells[3, :, 3:] = False
    volume, outward = np.zeros((8, 5, 8)), np.zeros((8, 5, 8, 3))
    for corner in np.ndindex(2, 2, 2):
        at = tuple(slice(c, c + n) for c, n in zip(corner, cells.shape, strict=True))
        volume[at] += cells / 8
        outward[at] += cells[..., None] * (2 * np.array(corner) - 1)
    there = volume > 0
    x = np.argwhere(there) + jitter * np.random.default_rng(2).uniform(-1, 1, (there.sum(), 3))
    size = np.linalg.norm(outward[there], axis=1, keepdims=True)
    return x, volume[there], np.divide(outward[there], size, out=0 * outward[there], where=size > 0)


@pytest.mark.parametrize("jitter", [0.0, 0.1])
def test_a_gap_as_wide_as_points_are_apart_is_told_by_their_volumes(jitter):
    x, volume, normals = forked(jitter)
    surface = normals.any(axis=1)
    closed, carved = (RestCloud.build(x, volume=v, surface=surface) for v in (volume.sum(), volume))
    walls = (x[:, 0] > 2.5) & (x[:, 0] < 4.5) & (x[:, 2] > 3.5)
    before, after = ((cloud.normals * normals)[walls].sum(axis=1) for cloud in (closed, carved))
    assert np.mean(before < 0.5) > 0.4 and np.mean(after < 0.5) < 0.2
    assert (1 - after**2).mean() < 0.5 * (1 - before**2).mean()  # of what slides along them
    assert closed.hull.volume(x).sum() > 1.05 * volume.sum()
    assert carved.hull.volume(x).sum() == pytest.approx(volume.sum(), rel=0.03)


def test_a_body_without_gaps_is_left_as_it_is():
    x, volume, normals = forked(0.1)
    left = x[:, 0] < 3.5
    half = RestCloud.build(x[left])
    assert half.hull.carved(x[left], half.volume, normals[left].any(axis=1)) is half.hull
    everything = np.ones(len(x), bool)  # a shell tells nothing of what is inside
    assert (closed := RestCloud.build(x)).hull.carved(x, volume, everything) is closed.hull


def test_coinciding_points_are_named():
    x = sim_cases.points().copy()
    x[[20, 31]] = x[7]
    with pytest.raises(ValueError, match=r"x must hold no point twice; got 3 coinciding points: 7, 20, 31$"):
        RestCloud.build(x)


def test_flat_cloud_is_named():
    x = np.random.default_rng(0).uniform(size=(40, 3)) * [1.0, 1.0, 0.0]
    with pytest.raises(ValueError, match=r"x must surround every point .*flat neighbourhoods at points 0, 1, 2, 3, 4"):
        RestCloud.build(x)


def test_flat_part_is_named_by_its_indices():
    block = clouds.block((4, 4, 4), (0.3, 0.3, 0.3))
    sheet = np.random.default_rng(0).uniform(size=(64, 3)) * [1.0, 1.0, 0.0] + [9.0, 0, 0]
    with pytest.raises(ValueError, match=r"flat neighbourhoods at points 64, 65, 66, 67, 68 and 59 more"):
        RestCloud.build(np.concatenate([block, sheet]))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda x: {"x": x[:4]}, r"x must hold more than \d+ points; got 4"),
        (lambda x: {"x": x[:, :2]}, r"x must have shape \(any, 3\)"),
        (lambda x: {"x": np.where(np.arange(len(x))[:, None] == 3, np.nan, x)}, r"x must be finite; .* at \(3, 0\)"),
        (lambda x: {"x": x, "volume": -1.0}, r"volume must be positive; got -1"),
        (lambda x: {"x": x, "volume": np.zeros(len(x))}, r"volume must be positive at every point; got 0"),
        (lambda x: {"x": x, "volume": np.ones(3)}, r"volume must have shape"),
        (lambda x: {"x": x, "surface": np.ones(3, bool)}, r"surface must have shape"),
    ],
)
def test_bad_input_ends_in_a_sentence(change, sentence):
    with pytest.raises(ValueError, match=sentence):
        RestCloud.build(**change(sim_cases.points()))


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"neighbours": 3}, r"neighbours must be at least 4; got 3"),
        ({"mode": "exact"}, r"mode must be 'consistent' or 'paper'; got 'exact'"),
        ({"stabilisation": -1.0}, r"stabilisation must not be negative; got -1"),
    ],
)
def test_impossible_options_end_in_a_sentence(options, sentence):
    with pytest.raises(ValueError, match=sentence):
        CloudOptions(**options)
