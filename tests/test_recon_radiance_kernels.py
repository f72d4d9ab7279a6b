"""Taichi kernels behind torch: values and gradients against torch in double precision, marching against numpy."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from recon.radiance.compositing import composite
from recon.radiance.hashgrid import FEATURES, HashEncoding, HashGrid, kernels_of
from recon.radiance.marching import Occupancy, march
from recon.radiance.rendering import along
from recon.radiance.stopping import Stops

SMALL = HashGrid(levels=3, coarsest=3, finest=11, log2_table=8)  # the first level dense, the others hashed
PRIMES = (1, 2654435761, 805459861)


def encoded(places: torch.Tensor, table: torch.Tensor, grid: HashGrid) -> torch.Tensor:
    """The hash grid in plain torch."""
    corners = torch.tensor([[i & 1, (i >> 1) & 1, (i >> 2) & 1] for i in range(8)])
    out = []
    for cells, first, dense in grid.layout.tolist():
        p = places.clamp(0, 0.999999) * cells
        low = p.detach().floor()
        at = low.long()[:, None] + corners
        if dense:
            row = at[..., 0] + (cells + 1) * (at[..., 1] + (cells + 1) * at[..., 2])
        else:
            mixed = torch.zeros_like(at[..., 0])
            for a in range(3):
                mixed ^= (at[..., a] * PRIMES[a]) & 0xFFFFFFFF
            row = mixed & (2**grid.log2_table - 1)
        inside = (p - low)[:, None]
        weight = torch.where(corners.bool(), inside, 1 - inside).prod(dim=-1)
        out.append((table[first + row] * weight[..., None]).sum(dim=1))
    return torch.cat(out, dim=1)


@pytest.fixture()
def places() -> torch.Tensor:
    inside = torch.rand(40, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    beyond = torch.tensor([[-0.2, 0.5, 0.5], [0.3, 1.4, 0.6]], dtype=torch.float64)
    return torch.cat([inside, beyond])


def test_hash_grid_interpolates_as_the_reference_does(places):
    encoding = HashEncoding(SMALL, dtype=torch.float64)
    torch.testing.assert_close(encoding(places), encoded(places, encoding.table, SMALL), rtol=1e-12, atol=1e-14)


def test_hash_grid_passes_both_gradients_on(places):
    encoding = HashEncoding(SMALL, seed=2, dtype=torch.float64)
    pulled = torch.randn(len(places), SMALL.width, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    found = []
    for function in (encoding, lambda p: encoded(p, encoding.table, SMALL)):
        p = places.clone().requires_grad_()
        encoding.table.grad = None
        (function(p) * pulled).sum().backward()
        found.append((p.grad, encoding.table.grad.clone()))
    for ours, theirs in zip(*found, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-10, atol=1e-12)


def test_adding_at_once_gives_the_gradient_of_adding_in_order():
    """What a GPU adds up; where many places share few entries, none may be lost."""
    grid = HashEncoding(SMALL, dtype=torch.float64)
    generator = torch.Generator().manual_seed(4)
    places = torch.rand(5000, 3, generator=generator, dtype=torch.float64)
    pulled = torch.randn(5000, SMALL.levels, FEATURES, generator=generator, dtype=torch.float64)
    found = [torch.zeros_like(grid.table) for _ in range(2)]
    kernels = kernels_of(torch.float64)
    for add, out in zip((kernels.table_gradient, kernels.table_gradient_at_once), found, strict=True):
        add(places, grid.layout, 2**SMALL.log2_table - 1, pulled, out.detach())
    torch.testing.assert_close(*found, rtol=1e-12, atol=1e-12)


def test_a_level_without_weight_is_seen_but_does_not_pull(places):
    encoding = HashEncoding(SMALL, dtype=torch.float64)
    encoding.level_weight[1:] = 0
    p = places.clone().requires_grad_()
    encoding(p)[:, 2:].sum().backward()
    assert not p.grad.any() and encoding.table.grad.any()


def test_hash_tables_take_what_the_grid_says():
    for grid in (SMALL, HashGrid(), HashGrid(levels=1, coarsest=4, finest=4)):
        cells, first, dense = grid.layout[-1].tolist()
        assert HashEncoding(grid).table.shape == (grid.entries, 2)
        assert dense == ((cells + 1) ** 3 <= 2**grid.log2_table)
        assert first < grid.entries
    with pytest.raises(ValueError, match="hash grid must have levels, rising resolutions"):
        HashGrid(coarsest=8, finest=4)


COUNTS = (3, 0, 5)  # samples of three rays


@pytest.fixture()
def packed() -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(0)
    total = sum(COUNTS)
    density = 4 * torch.rand(total, generator=generator, dtype=torch.float64)
    colour = torch.rand(total, 3, generator=generator, dtype=torch.float64)
    length = 0.1 + 0.2 * torch.rand(total, generator=generator, dtype=torch.float64)
    depth = torch.arange(total, dtype=torch.float64)
    rays = torch.tensor([[0, 3], [3, 0], [3, 5]], dtype=torch.int32)
    return density, colour, length, depth, rays


def composited(density, colour, length, depth, rays) -> tuple[torch.Tensor, ...]:
    """Volume rendering in plain torch, ray by ray."""
    rows, weights = [], []
    for first, count in rays.tolist():
        part = slice(first, first + count)
        optical = density[part] * length[part]
        before = torch.cumsum(optical, dim=0) - optical
        w = torch.exp(-before) * (1 - torch.exp(-optical))
        rows.append(torch.cat([w @ colour[part], w.sum()[None], (w @ depth[part])[None]]))
        weights.append(w)
    return torch.stack(rows), torch.cat(weights)


def test_compositing_is_the_reference_and_an_empty_ray_is_clear(packed):
    found, (sums, weight) = composite(*packed), composited(*packed)
    torch.testing.assert_close(torch.cat([found.colour, found.opacity[:, None], found.depth[:, None]], dim=1), sums)
    torch.testing.assert_close(found.weight, weight)
    assert found.opacity[1] == 0 and not found.colour[1].any()


def test_compositing_passes_gradients_of_every_output_on(packed):
    density, colour, *rest = packed
    density.requires_grad_(), colour.requires_grad_()

    def outputs(d: torch.Tensor, c: torch.Tensor) -> tuple[torch.Tensor, ...]:
        found = composite(d, c, *rest)
        return found.colour, found.opacity, found.depth, found.weight

    assert torch.autograd.gradcheck(outputs, (density, colour), eps=1e-6, atol=1e-8)


def test_a_dense_slab_hides_what_is_behind_it():
    rays = torch.tensor([[0, 2]], dtype=torch.int32)
    colours = torch.tensor([[1.0, 0, 0], [0, 1.0, 0]])
    found = composite(torch.tensor([1e4, 1e4]), colours, torch.ones(2), torch.tensor([1.0, 2.0]), rays)
    torch.testing.assert_close(found.colour, torch.tensor([[1.0, 0, 0]]))
    assert found.depth.item() == pytest.approx(1.0)


@pytest.fixture()
def occupancy() -> Occupancy:
    cells = (torch.rand(2, 6, 5, 4, generator=torch.Generator().manual_seed(4)) < 0.4).to(torch.uint8)
    return Occupancy(cells=cells, origin=torch.tensor([-0.3, 0.1, 0.0]), spacing=0.1)


def test_samples_lie_where_the_frames_cells_are_occupied(occupancy):
    """Against the same rule for a ray in numpy; rays that miss the box have none."""
    rng = np.random.default_rng(0)
    start = rng.normal(size=(60, 3)) * 2
    goal = np.array([0.0, 0.35, 0.2]) + rng.uniform(-0.4, 0.4, size=(60, 3))
    direction = (goal - start) / np.linalg.norm(goal - start, axis=1, keepdims=True)
    frame, step = rng.integers(0, 2, 60), 0.03
    found = march(occupancy, *(torch.tensor(v, dtype=torch.float32) for v in (start, direction)),
                  torch.tensor(frame), step=step)  # fmt: skip
    low, size = occupancy.origin.numpy(), occupancy.size.numpy()
    counts, differ = [], 0
    for r in range(60):
        with np.errstate(divide="ignore"):
            ends = np.sort((np.stack([low, low + size]) - start[r]) / direction[r], axis=0)
        near, far = max(ends[0].max(), 0), ends[1].min()
        depth = near + step * (0.5 + np.arange(max(0, np.ceil((far - near) / step - 0.5))))
        at = start[r] + depth[:, None] * direction[r]
        cell = np.clip(np.floor((at - low) / 0.1).astype(int), 0, np.array([5, 4, 3]))
        kept = occupancy.cells[frame[r]].numpy()[tuple(cell.T)] > 0
        counts.append(kept.sum())
        differ += abs(int(found.rays[r, 1]) - counts[-1])
    assert differ <= 2  # places on a cell's face, rounded differently
    assert sum(counts) > 100 and 0 in counts
    assert (found.frame.numpy() == frame[found.ray.numpy()]).all()
    inside = (found.place.numpy() >= low - 1e-5).all() and (found.place.numpy() <= low + size + 1e-5).all()
    assert inside


def test_packed_rays_follow_one_another(occupancy):
    start = torch.tensor([[0.0, 0.3, -1.0], [5.0, 5.0, 5.0], [0.1, 0.2, -1.0]])
    found = march(occupancy, start, torch.tensor([[0.0, 0, 1]] * 3), torch.zeros(3, dtype=torch.long), step=0.05)
    first, count = found.rays.T.tolist()
    assert first == [0, count[0], count[0]] and count[1] == 0
    assert found.ray.tolist() == [0] * count[0] + [2] * count[2]
    assert (torch.diff(found.depth[: count[0]]) > 0).all()


def test_occupancy_of_another_kind_is_refused():
    with pytest.raises(ValueError, match=r"cells must be \(T, X, Y, Z\) uint8"):
        Occupancy(cells=torch.ones(3, 3, 3), origin=torch.zeros(3), spacing=0.1)


def test_rays_end_behind_what_is_opaque_and_show_the_same(occupancy):
    """A slab half a cell thick in the second frame; nobody looked at the first."""
    full = replace(occupancy, cells=torch.ones(2, 12, 12, 12, dtype=torch.uint8), origin=torch.zeros(3), spacing=0.1)

    def field(places, frame):
        slab = (places[:, 2] > 0.4) & (places[:, 2] < 0.6)
        return torch.where(slab, 400.0, 0.01), places

    stops = Stops.of(full)
    stops.look(field, [1])
    start = torch.tensor([[0.55, 0.55, -1.0], [0.55, 0.55, -1.0], [-0.2, 0.3, -1.0], [0.5, 0.5, 0.65]])
    direction, frame = torch.tensor([[0.0, 0, 1]] * 4), torch.tensor([1, 0, 1, 1])
    until = stops.span(start, direction, frame)[1]
    assert 1.6 <= until[0] <= 2.1 and (until[[1, 3]] > torch.tensor([2.199, 0.549])).all()  # those leave the box
    ends = [along(field, full, start, direction, frame, until=u)[0] for u in (until, None)]
    torch.testing.assert_close(ends[0].colour, ends[1].colour, atol=1e-3, rtol=0)


def test_rays_that_begin_and_end_around_occupied_cells_lose_no_samples(occupancy):
    """Along the middles of all columns of cells, where no corner is cut; another one misses all."""
    x, y = torch.meshgrid(torch.arange(6), torch.arange(5), indexing="ij")
    columns = torch.stack([0.1 * x + 0.05, 0.1 * y + 0.05, torch.full_like(x, -1.0)], dim=-1).reshape(-1, 3)
    start = torch.cat([columns, torch.full((1, 3), 3.0)]) + occupancy.origin
    direction, frame = torch.tensor([[0.0, 0, 1]] * len(start)), torch.arange(len(start)) % 2
    since, until = Stops.of(occupancy).span(start, direction, frame)
    whole = march(occupancy, start, direction, frame, step=0.01).rays[:, 1]
    found = march(occupancy, start, direction, frame, step=0.01, since=since, until=until).rays[:, 1]
    assert (since[:-1] > 0.9).all() and (found - whole).abs().max() <= 2  # they begin at another phase of the same step
    assert whole.sum() > 400 and found[-1] == 0


def test_a_coarse_cell_is_looked_at_where_any_of_its_parts_is_occupied(occupancy):
    found = Stops.of(occupancy).occupied
    assert found.shape == (2, 3, 3, 2)
    padded = torch.zeros(2, 6, 6, 4, dtype=torch.uint8)
    padded[:, :, :5] = occupancy.cells
    assert (found == padded.reshape(2, 3, 2, 3, 2, 2, 2).amax(dim=(2, 4, 6)).bool()).all()
