"""The paper's three losses on where the object is, against numbers worked out by hand on a few rays."""

import math

import pytest
import torch

from recon.radiance.batches import Batch
from recon.radiance.compositing import composite
from recon.radiance.losses import LossWeights, background_loss, density_loss, foreground_loss, shape_loss
from recon.radiance.marching import Samples

HAZE, WALL, DEEP = 0.02, 5.0, 0.3  # density times length
RAYS = [[HAZE, WALL, DEEP, DEEP], [HAZE, HAZE], [WALL, DEEP], [WALL]]
MATTE = [1.0, 0.0, 1.0, 0.5]  # of the object, of the background, of the object, of the object's edge


def told(rays=RAYS, matte=MATTE):
    """Composite, samples, thickness and batch of rays whose samples are that thick."""
    thickness = torch.tensor([t for ray in rays for t in ray], requires_grad=True)
    numbers = torch.tensor([len(ray) for ray in rays])
    packed = torch.stack([numbers.cumsum(0) - numbers, numbers], dim=1).int()
    depth = torch.cat([torch.arange(n) + 1.0 for n in numbers])
    ray = torch.repeat_interleave(torch.arange(len(rays)), numbers)
    none = torch.zeros(len(rays), 3)
    samples = Samples(place=torch.zeros(len(depth), 3), depth=depth, ray=ray, frame=0 * ray, rays=packed)
    batch = Batch(start=none, direction=none, frame=0 * numbers, camera=0 * numbers, colour=none,
                  matte=torch.tensor(matte), grey=numbers < 0)  # fmt: skip
    seen = composite(thickness, torch.zeros(len(depth), 3), torch.ones(len(depth)), depth, packed)
    return seen, samples, thickness, batch


def pulled(loss: torch.Tensor, thickness: torch.Tensor) -> list[int]:
    """Samples whose thickness the loss has a say in."""
    return torch.nonzero(torch.autograd.grad(loss, thickness)[0])[:, 0].tolist()


def test_background_loss_is_what_rays_beside_the_object_hide():
    seen, _, thickness, batch = told()
    loss = background_loss(seen, batch)
    assert loss.item() == pytest.approx(1 - math.exp(-2 * HAZE), rel=1e-5)
    assert pulled(loss, thickness) == [4, 5]


def test_foreground_loss_is_the_haze_before_the_surface_and_leaves_the_surface_alone():
    seen, samples, thickness, batch = told()
    loss = foreground_loss(seen, samples, thickness, batch)
    assert loss.item() == pytest.approx(1 - math.exp(-HAZE), rel=1e-5)
    assert pulled(loss, thickness) == [0]


def test_density_loss_is_what_is_clear_behind_the_surface():
    seen, samples, thickness, batch = told()
    loss = density_loss(seen, samples, thickness, batch)
    solid = [math.exp(-t) for t in (WALL, DEEP, DEEP, WALL, DEEP)]
    assert loss.item() == pytest.approx(sum(solid) / len(solid), rel=1e-5)
    assert pulled(loss, thickness) == [1, 2, 3, 6, 7]


def test_losses_add_up_by_their_weights():
    rays = told()
    alone = {"background": background_loss(rays[0], rays[3]), "foreground": foreground_loss(*rays),
             "density": density_loss(*rays)}  # fmt: skip
    for name, loss in alone.items():
        chosen = LossWeights(**{"density": 0.0, name: 3.0})
        assert shape_loss(*rays, chosen).item() == pytest.approx(3 * loss.item(), rel=1e-6)
    every = LossWeights(background=1.0, foreground=2.0, density=4.0)
    expected = alone["background"] + 2 * alone["foreground"] + 4 * alone["density"]
    assert shape_loss(*rays, every).item() == pytest.approx(expected.item(), rel=1e-6)


def test_rays_that_meet_nothing_lose_nothing():
    seen, samples, thickness, batch = told([[HAZE]], [0.5])
    every = LossWeights(background=1.0, foreground=1.0, density=1.0)
    assert shape_loss(seen, samples, thickness, batch, every).item() == 0


def test_a_negative_weight_is_refused():
    with pytest.raises(ValueError, match="weight of the foreground loss must be zero or more; got -1"):
        LossWeights(foreground=-1)
