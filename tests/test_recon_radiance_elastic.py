"""What the elastic loss makes of bendings whose strain is known."""

from types import SimpleNamespace

import pytest
import torch

from recon.radiance.losses import LossWeights, elastic_loss, motion_loss, warp_loss
from recon.radiance.marching import Samples

COUNT, SIDE = 20_000, 0.4
TURN = torch.tensor([[0.0, -1, 0], [0.6, 0, -0.8], [0.8, 0, 0.6]])
SHEAR = torch.eye(3) + 0.1 * torch.tensor([[0.0, 1, 0], [0, 0, 0], [0, 0, 0]])


def bent_by(F: torch.Tensor, thickness: float = 1.0):
    """A model that bends by `x -> F x + c`, samples, their canonical places, their thickness; w leaves all in place."""
    place = torch.rand(COUNT, 3, generator=torch.Generator().manual_seed(1))
    bent = lambda x, frame: x @ F.T + torch.tensor([0.3, -0.1, 0.2])  # noqa: E731
    model = SimpleNamespace(
        bent=bent, warped=lambda x, frame: x, canonical=SimpleNamespace(box=SimpleNamespace(side=SIDE))
    )
    number = torch.arange(COUNT)
    samples = Samples(place=place, depth=place[:, 0], ray=number, frame=0 * number, rays=torch.zeros(1, 2).int())
    return model, samples, bent(place, None), torch.full((COUNT,), thickness)


def elastic(F: torch.Tensor) -> float:
    model, samples, canonical, _ = bent_by(F)
    return elastic_loss(model, samples, canonical, torch.arange(COUNT), torch.Generator().manual_seed(0)).item()


def test_a_rigid_motion_costs_nothing():
    assert elastic(TURN) < 1e-9


@pytest.mark.parametrize("stretch", [0.8, 1.05, 1.3])
def test_a_uniform_stretch_costs_the_square_of_its_strain(stretch):
    assert elastic(stretch * TURN) == pytest.approx((stretch - 1) ** 2, rel=1e-3)


def test_a_shear_costs_its_mean_over_all_directions():
    """Of a strain E, `n E n` squared is `(2 E:E + tr^2 E) / 15` in the mean; a shear g has E:E = g^2 / 2 and no
    trace, to first order in g."""
    assert elastic(SHEAR) == pytest.approx(0.1**2 / 15, rel=0.05)


def test_what_the_motion_loses_adds_up_by_the_weight():
    def lost(weight: float) -> float:
        given = bent_by(1.1 * torch.eye(3))
        return motion_loss(*given, LossWeights(elastic=weight), torch.Generator().manual_seed(0)).item()

    assert lost(3.0) - lost(0.0) == pytest.approx(3 * 0.1**2, rel=1e-3)
    model, samples, canonical, _ = bent_by(1.1 * torch.eye(3))
    assert lost(0.0) == pytest.approx(warp_loss(model, samples, canonical, torch.arange(COUNT)).item(), rel=0.05)


def test_clear_samples_ask_for_nothing_and_the_bending_is_pulled_by_strain():
    assert motion_loss(*bent_by(TURN, 0.0), LossWeights(), torch.Generator()).item() == 0
    F = (1.2 * TURN).requires_grad_()
    model, samples, canonical, _ = bent_by(F)
    loss = elastic_loss(model, samples, canonical, torch.arange(COUNT), torch.Generator().manual_seed(0))
    (pull,) = torch.autograd.grad(loss, F)
    # Of F = s TURN the loss is (s - 1)^2, which rises by 2 (s - 1) per unit of s.
    assert (pull * TURN).sum().item() == pytest.approx(2 * 0.2, rel=1e-2)
