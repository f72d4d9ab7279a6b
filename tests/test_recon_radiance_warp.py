"""Re-rendering from a moved cloud: the paper's interpolation against scipy, its guards, and where the field is cut."""

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from recon.radiance.cloudwarp import CloudWarp, cloud_occupancy, densified, moved_field, neighbours
from recon.radiance.device import array

SHIFT = np.array([0.2, 0.1, 0.0])


@pytest.fixture(scope="module")
def clouds() -> tuple[np.ndarray, np.ndarray]:
    """A ball of points, and what a bend makes of it; a few points stand far off."""
    rng = np.random.default_rng(0)
    rest = rng.normal(size=(1500, 3))
    rest *= 0.1 * (rng.random(1500) ** (1 / 3) / np.linalg.norm(rest, axis=1))[:, None]
    rest[:4] += [0.5, 0, 0]
    moved = rest + np.stack([2 * rest[:, 2] ** 2, 0 * rest[:, 0], 0.3 * rest[:, 0]], axis=1) + [0.1, 0, -0.05]
    return rest, moved


def interpolated(rest: np.ndarray, moved: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The paper's formula with scipy's neighbours."""
    distance, near = cKDTree(moved).query(places, 5)
    weight = 1 / distance
    weight -= weight.min(axis=1, keepdims=True)
    share = weight / weight.sum(axis=1, keepdims=True)
    return places + (share[..., None] * (rest - moved)[near]).sum(axis=1), distance[:, 0]


def test_places_go_where_the_papers_formula_says_inside_and_far_away(clouds):
    rest, moved = clouds
    rng = np.random.default_rng(1)
    near = moved[rng.integers(0, len(moved), 400)] + rng.normal(size=(400, 3)) * 0.01
    far = rng.uniform(-1.5, 1.5, size=(100, 3))
    places = np.concatenate([near, far]).astype(np.float32)
    found, nearest = (v.numpy() for v in CloudWarp.of(rest, moved)(torch.from_numpy(places)))
    expected, distance = interpolated(rest, moved, places.astype(float))
    assert np.abs(found - expected).max() < 2e-5
    assert nearest == pytest.approx(distance, abs=1e-6)


def test_a_cut_changes_nothing_within_it_and_leaves_the_rest_beyond(clouds):
    rest, moved = clouds
    warp, cut = CloudWarp.of(rest, moved), 0.02
    places = torch.from_numpy(np.random.default_rng(1).uniform(-0.2, 0.4, size=(4000, 3)).astype(np.float32))
    (found, nearest), (short, known) = warp(places), warp(places, cut)
    near = nearest <= cut
    assert 50 < near.sum() < 3000
    assert (short[near] == found[near]).all() and (known[near] == nearest[near]).all()
    assert (known[~near] > cut).all()


def test_a_shift_is_undone_exactly(clouds):
    rest, _ = clouds
    places = torch.from_numpy((rest + SHIFT).astype(np.float32))
    found, nearest = CloudWarp.of(rest, rest + SHIFT)(places)
    assert np.abs(found.numpy() - rest).max() < 1e-6
    assert nearest.max() < 1e-6


def test_five_points_equally_far_have_an_equal_say():
    """Where the paper's weights are 0/0."""
    angle = 2 * np.pi * np.arange(5) / 5
    moved = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    rest = moved + np.arange(5)[:, None] * [0, 0, 1.0]
    found, _ = CloudWarp.of(rest, moved)(torch.zeros(1, 3))
    assert found.numpy() == pytest.approx(np.array([[0, 0, 2.0]]), abs=1e-5)


def test_the_field_is_clear_away_from_the_cloud(clouds):
    rest, moved = clouds
    full = moved_field(lambda p: (torch.ones(len(p)), torch.ones(len(p), 3)), CloudWarp.of(rest, moved), cut=0.02)
    middle, away = moved[10:11], moved[10:11] + np.array([0, 5.0, 0])
    density, _ = full(torch.from_numpy(np.concatenate([middle, away]).astype(np.float32)), torch.zeros(2))
    assert density.tolist() == [1.0, 0.0]


def test_occupancy_holds_all_that_is_within_the_cut(clouds):
    _, moved = clouds
    occupancy = cloud_occupancy(moved, cut=0.02, cells=40)
    rng = np.random.default_rng(2)
    step = rng.normal(size=(2000, 3))
    step *= 0.0199 / np.linalg.norm(step, axis=1, keepdims=True)
    near = moved[rng.integers(0, len(moved), 2000)] + step
    cell = np.floor((near - array(occupancy.origin)) / occupancy.spacing).astype(int)
    assert array(occupancy.cells[0])[tuple(cell.T)].all()
    assert occupancy.cells.float().mean() < 0.2


def test_points_in_between_move_with_their_neighbours(clouds):
    rest, moved = clouds
    more, there = densified(rest, moved, neighbours(rest), stretched=0)
    assert len(more) > 2 * len(rest) and (more[: len(rest)] == rest).all()
    bend = more + np.stack([2 * more[:, 2] ** 2, 0 * more[:, 0], 0.3 * more[:, 0]], axis=1) + [0.1, 0, -0.05]
    assert np.median(np.linalg.norm(there - bend, axis=1)) < 1e-4


@pytest.mark.parametrize(("stretch", "holes"), [(1.0, 0.0), (2.5, 0.05)])
def test_a_stretched_body_has_no_holes_once_points_are_put_in_between(stretch, holes):
    """A block pulled long, asked for in its inside: cut away half way between its points, unless there are others."""
    rest = np.stack(np.meshgrid(*[np.arange(12.0)] * 3), axis=-1).reshape(-1, 3)
    pull = np.array([stretch, 1.0, 1.0])
    places = np.random.default_rng(1).uniform(1, 10, (4000, 3))
    asked, frames = torch.from_numpy((places * pull).astype(np.float32)), torch.zeros(4000, dtype=torch.long)
    found, added = [], []
    for cloud in ((rest, rest * pull), densified(rest, rest * pull, neighbours(rest))):
        field = moved_field(lambda p: (torch.ones(len(p)), p), CloudWarp.of(*cloud), 1.2)
        density, where = field(asked, frames)
        inside = density > 0
        assert np.abs(where[inside].numpy() - places[inside.numpy()]).mean() < 0.2
        found.append(1 - float(inside.float().mean()))
        added.append(len(cloud[0]) - len(rest))
    assert found[0] >= holes and found[1] < 0.01
    along = 11 * 12 * 12 if stretch > 1.5 else 0  # pairs, and a few aslant at the border
    assert added[0] == 0 and along <= added[1] <= 1.5 * along


def test_fewer_than_five_points_are_refused():
    with pytest.raises(ValueError, match="rest must have at least 5 points; got 4"):
        CloudWarp.of(np.zeros((4, 3)), np.zeros((4, 3)))
