"""What a trained field must get right: the filmed colours, an opaque inside, and a warp that undoes the bending."""

import torch

from recon.radiance.batches import Batch
from recon.radiance.compositing import Composite
from recon.radiance.fields import Dynamic
from recon.radiance.marching import Samples

_LUMINANCE = (0.299, 0.587, 0.114)
_BEND = 0.1  # of a colour, up to which an error counts squared
_HIDDEN = 0.1  # transmittance below which a sample lies behind the surface
_SOLID = 0.95  # matte above which a ray is one of the object's
_VISIBLE = 0.05  # opacity of samples that teach the forward warp
_MOST_WARPED = 4096  # of them


def colour_loss(seen: Composite, batch: Batch, gains: torch.Tensor, behind: torch.Tensor) -> torch.Tensor:
    """Smooth L1 between prediction and picture, both over the colours `behind` (R, 3).

    Grey cameras are compared in luminance after their own gain and bias, gains (C, 2). Background and foreground losses
    of the paper in one: over a random colour, what is not the object must be clear and what is must be opaque.
    """
    luminance = torch.tensor(_LUMINANCE)
    behind = torch.where(batch.grey[:, None], (behind @ luminance)[:, None], behind)
    own = seen.colour
    gain, bias = gains[batch.camera].T
    grey = (own @ luminance) * gain + bias * seen.opacity
    own = torch.where(batch.grey[:, None], grey[:, None], own)
    predicted = own + (1 - seen.opacity)[:, None] * behind
    filmed = batch.colour + (1 - batch.matte)[:, None] * behind
    return torch.nn.functional.smooth_l1_loss(predicted, filmed, beta=_BEND) / _BEND


def density_loss(seen: Composite, samples: Samples, thickness: torch.Tensor, batch: Batch) -> torch.Tensor:
    """Mean transparency of the samples behind the surface on rays of the object (paper: L_density).

    thickness (S,): density times length of the samples.
    """
    weight = seen.weight.detach()
    passed = torch.cumsum(weight, dim=0)
    first = samples.rays[:, 0].long().clamp(max=max(len(weight) - 1, 0))
    left = 1 - (passed - (passed[first] - weight[first])[samples.ray])
    inside = (left < _HIDDEN) & (batch.matte[samples.ray] > _SOLID)
    return (torch.exp(-thickness) * inside).sum() / inside.sum().clamp(min=1)


def warp_loss(
    model: Dynamic, samples: Samples, canonical: torch.Tensor, thickness: torch.Tensor, generator: torch.Generator
) -> torch.Tensor | None:
    """Mean distance between samples and where w carries their canonical places, in box sides; None without samples.

    Bending and latents are taken as they are: w follows b and never pulls at it.
    """
    visible = torch.nonzero(thickness.detach() > _VISIBLE)[:, 0]
    if len(visible) > _MOST_WARPED:
        visible = visible[torch.randint(0, len(visible), (_MOST_WARPED,), generator=generator)]
    if not len(visible):
        return None
    there = model.warped(canonical.detach()[visible], samples.frame[visible])
    return (there - samples.place[visible]).norm(dim=1).mean() / model.canonical.box.side
