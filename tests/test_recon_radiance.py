"""A painted ellipsoid that moves: field, motion and cloud from its pictures, judged by its closed form."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from ellipsoid_scene import RADII, drawn, inside, ring, silhouette

from recon.quality.similarity import psnr
from recon.radiance.cloudwarp import CloudWarp, cloud_occupancy, moved_field
from recon.radiance.device import array, device, tensor
from recon.radiance.extraction import ExtractOptions, carried, extract
from recon.radiance.fields import Box, Dynamic, FieldOptions
from recon.radiance.hashgrid import HashGrid
from recon.radiance.options import TrainOptions
from recon.radiance.rendering import Picture, along, camera_rays, render
from recon.radiance.storage import load_trained, save_trained
from recon.radiance.training import train
from recon.views import Views
from veo_ti.reconstruction.rerender import Rerenderer

SIZE, TRAIN = (44, 48), 7
MIDDLE = np.array([[0, 0, 0], [0.02, 0.006, -0.01]])  # [m], 8 % of the object's diagonal
GRID = HashGrid(levels=5, coarsest=8, finest=64, log2_table=13)
OPTIONS = TrainOptions(canonical_steps=120, motion_steps=180, samples=4096, cells=32,
                       field=FieldOptions(grid=GRID), pulling=3)  # fmt: skip


def filmed(cameras, mattes: bool = True) -> Views:
    def pictures(camera):
        rays = camera.rays(camera.grid())
        return np.stack([drawn(camera, m, rays).clip(0, 255).astype(np.uint8) for m in MIDDLE])

    shown = tuple(np.stack([255 * silhouette(c, m).astype(np.uint8) for m in MIDDLE]) for c in cameras)
    return Views(
        cameras=tuple(cameras), times=np.array([0.0, 0.025]), images=tuple(map(pictures, cameras)),
        mattes=shown if mattes else (), inside=tuple(np.ones(c.size[::-1], bool) for c in cameras),
    )  # fmt: skip


@pytest.fixture(scope="module")
def cameras():
    return [replace(camera, distortion=np.zeros(5)) for camera in ring(TRAIN + 1, SIZE, focal=72.0)]


@pytest.fixture(scope="module")
def views(cameras) -> Views:
    return filmed(cameras[:TRAIN])


@pytest.fixture(scope="module")
def trained(views, tmp_path_factory):
    return train(views, tmp_path_factory.mktemp("training"), OPTIONS)


@pytest.fixture(scope="module")
def cloud(trained, views):
    return extract(trained, views, ExtractOptions(points=1500))


def test_a_camera_that_taught_nothing_sees_the_object_in_both_frames(trained, cameras):
    camera = cameras[TRAIN]
    assert trained.status == "done"
    for frame, middle in enumerate(MIDDLE):
        shown = render(trained.field, trained.occupancy, camera, frame=frame)
        matte = silhouette(camera, middle)
        target = drawn(camera, middle, camera.rays(camera.grid())) / 255
        flat = np.broadcast_to(target[matte].mean(axis=0), target.shape)
        assert psnr(shown.colour, target, matte) > psnr(flat, target, matte) + 3
        assert shown.opacity[matte].mean() > 0.93 and shown.opacity[~matte].mean() < 0.1
        assert np.median(shown.depth[matte]) == pytest.approx(0.8 - RADII.mean(), abs=0.05)


def test_points_of_the_surface_are_carried_along(trained):
    points = inside(400, MIDDLE[0])
    skin = points / np.linalg.norm(points / RADII, axis=1, keepdims=True) * 0.95
    still, there = (array(carried(trained.field, tensor(skin.astype(np.float32)), frame)) for frame in (0, 1))
    off = np.linalg.norm(there - skin - MIDDLE[1], axis=1)
    assert off.mean() < 0.4 * np.linalg.norm(MIDDLE[1])
    assert np.linalg.norm(still - skin, axis=1).mean() < 0.4 * np.linalg.norm(MIDDLE[1])


def test_cloud_fills_the_object_with_its_skin_flagged(cloud):
    """Points inside, grown by a spacing; normals against the ellipsoid's own."""
    at = np.linalg.norm(cloud.points[0] / (RADII + cloud.spacing), axis=1)
    assert 800 < len(at) <= 1500
    assert (at < 1).mean() > 0.95
    normal = cloud.points[0] / RADII**2
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    agree = (normal * cloud.normals).sum(axis=1)[cloud.surface]
    assert 0.2 < cloud.surface.mean() < 0.8 and agree.mean() > 0.85
    assert not cloud.normals[~cloud.surface].any()
    depth = np.linalg.norm(cloud.points[0] / RADII, axis=1)
    assert depth[cloud.surface].mean() > depth[~cloud.surface].mean() + 0.15


@pytest.mark.parametrize(("thick", "asked"), [(5.0, (1.0, 1.0)), (5000.0, (0.2, 0.7))])
def test_a_field_is_not_asked_for_what_is_hidden_and_the_picture_is_the_same(cameras, thick, asked):
    """Fog of `thick` [1/m] in a cube, coloured by place, against the composite of all samples."""
    steps, camera, count = np.linspace(-0.06, 0.06, 13), cameras[0], []
    occupancy = cloud_occupancy(np.stack(np.meshgrid(steps, steps, steps), -1).reshape(-1, 3), cut=0.02, cells=200)

    def fog(places: torch.Tensor, frame: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        count.append(len(places))
        inside = places.abs().max(dim=1).values < 0.05
        return thick * inside, 0.5 + 8 * places.clamp(-0.05, 0.05)

    shown, (start, direction) = render(fog, occupancy, camera), camera_rays(camera)
    few, first = sum(count), torch.zeros(len(start), dtype=torch.long, device=device())
    whole, samples, _ = along(fog, occupancy, start, direction, first)
    assert np.abs(shown.colour - array(whole.colour).reshape(shown.colour.shape)).max() < 1e-3
    assert np.abs(shown.opacity - array(whole.opacity).reshape(shown.opacity.shape)).max() < 1e-3
    assert array(whole.opacity).max() > 0.2 and asked[0] <= few / len(samples.depth) <= asked[1]


def test_the_more_rays_a_pixel_has_the_better_it_shows_how_much_an_edge_covers(cameras):
    """Of a solid whose edge runs through the camera itself, so that it is a straight line in the picture."""
    camera = cameras[0]
    right, down = camera.T_camera_world[:2, :3]
    normal = np.cos(0.4) * right + np.sin(0.4) * down
    steps = np.linspace(-0.06, 0.06, 13)
    occupancy = cloud_occupancy(np.stack(np.meshgrid(steps, steps, steps), -1).reshape(-1, 3), cut=0.02, cells=32)

    def solid(places: torch.Tensor, frame: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        inside = (places - tensor(camera.centre).float()) @ tensor(normal).float() < 0
        return 1e5 * inside, torch.ones_like(places)

    around = (np.array(camera.size) // 2)[None, None] + np.stack(np.meshgrid(*[np.arange(-3.0, 4)] * 2), -1)
    within = (np.stack(np.meshgrid(*[np.arange(32)] * 2), -1).reshape(-1, 2) + 0.5) / 32 - 0.5
    covered = (camera.rays(around[:, :, None] + within) @ normal < 0).mean(axis=2)
    columns, rows = np.moveaxis(around.astype(int), -1, 0)
    off = {}
    for fineness in (1, 2, 4):
        shown = render(solid, occupancy, camera, fineness=fineness)
        off[fineness] = np.abs(shown.opacity[rows, columns] - covered).max()
    assert off[1] > 0.25 and off[2] < 0.25 and off[4] < 0.1
    with pytest.raises(ValueError, match="fineness must be at least 1; got 0"):
        render(solid, occupancy, camera, fineness=0)


def test_a_cloud_at_rest_shows_what_the_field_shows(trained, cloud, cameras):
    """With fewer points than pixels, and the bending of frame 0 interpolated between them."""
    camera, renderer = cameras[TRAIN], Rerenderer(trained=trained, rest=cloud.points[0], spacing=cloud.spacing)
    shift = tensor(np.array([0.05, -0.08, 0.03], np.float32))
    with torch.no_grad():  # a motion of all frames together, which no training took away
        trained.field.bending.network[-1].bias += shift
        whole = render(trained.field, trained.occupancy, camera)
        shown = renderer.picture(cloud.points[0], camera)
        trained.field.bending.network[-1].bias -= shift
    plain = render(trained.field, trained.occupancy, camera)
    matte = (whole.opacity > 0.5) & np.isfinite(shown.depth)
    assert psnr(shown.colour, whole.colour, matte) > psnr(plain.colour, whole.colour, matte) + 10


def test_a_moved_cloud_shows_the_object_where_it_was_moved_to(trained, cloud, cameras):
    """A shift nobody filmed, against the picture of the shifted ellipsoid; before it, something opaque hides it."""
    shift, camera = np.array([-0.02, 0.03, 0.015]), cameras[TRAIN]
    rest = cloud.points[0]
    warp, cut = CloudWarp.of(rest, rest + shift), 1.5 * cloud.spacing
    field = moved_field(trained.field.canonical, warp, cut)
    occupancy = cloud_occupancy(rest + shift, cut=cut, cells=48)
    shown, matte = render(field, occupancy, camera), silhouette(camera, shift)
    still = render(trained.field, trained.occupancy, camera)
    target = drawn(camera, shift, camera.rays(camera.grid())) / 255
    assert psnr(shown.colour, target, matte) > psnr(still.colour, target, matte) + 3
    assert (shown.opacity[matte] > 0.5).mean() > 0.93
    shape = camera.size[::-1]
    wall = Picture(colour=np.full((*shape, 3), 0.5), opacity=np.ones(shape), depth=np.full(shape, 0.3))
    for fineness in (1, 2):
        hidden = render(field, occupancy, camera, behind=wall, fineness=fineness)
        assert hidden.colour == pytest.approx(wall.colour, abs=1e-6) and hidden.depth == pytest.approx(wall.depth)
        with pytest.raises(ValueError, match=r"behind must have \w+'s size \(44, 48\); got \(48, 44\)"):
            render(field, occupancy, camera, behind=replace(wall, depth=wall.depth.T), fineness=fineness)
    far = replace(wall, depth=np.full(shape, 3.0))
    both = render(field, occupancy, camera, behind=far).colour
    assert both[matte] == pytest.approx((shown.colour + (1 - shown.opacity)[..., None] * 0.5)[matte], abs=1e-5)


def test_a_field_is_read_back_as_it_was(trained, cameras, tmp_path):
    kept = load_trained(save_trained(tmp_path / "field.pt", trained, OPTIONS.field))
    first, second = (render(t.field, t.occupancy, cameras[0], frame=1).colour for t in (trained, kept))
    assert (first == second).all() and (kept.status, kept.made_from) == ("done", trained.made_from)
    (tmp_path / "field.pt").write_bytes(b"no field")
    with pytest.raises(ValueError, match=r"field\.pt must be a field that veo reconstruct wrote; got"):
        load_trained(tmp_path / "field.pt")


def test_the_papers_encoding_is_an_option():
    paper = FieldOptions.paper()
    model = Dynamic(Box(origin=np.zeros(3), side=1.0), 2, replace(paper, width=16, depth=2))
    density, colour = model(torch.rand(5, 3), torch.zeros(5, dtype=torch.long))
    assert paper.encoding == "positional" and (density > 0).all() and colour.shape == (5, 3)


def test_rays_meet_the_pixels_they_belong_to(cameras):
    start, direction = camera_rays(cameras[0])
    pixels, _ = cameras[0].project(array((start + 0.7 * direction).double()))
    assert pixels == pytest.approx(cameras[0].grid().reshape(-1, 2), abs=1e-3)
