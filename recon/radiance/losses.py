"""What a trained field must get right: the filmed colours, an opaque inside, a motion that hardly stretches."""

from dataclasses import dataclass, fields

import torch

from recon.radiance.batches import Batch
from recon.radiance.compositing import Composite
from recon.radiance.fields import Dynamic
from recon.radiance.marching import Samples
from sim.checks import require

_LUMINANCE = (0.299, 0.587, 0.114)
_BEND = 0.1  # of a colour, up to which an error counts squared
_HIDDEN = 0.1  # transmittance below which a sample lies behind the surface
_CLEAR = 0.9  # transmittance above which a sample lies before it
_SOLID, _EMPTY = 0.95, 0.05  # matte above which a ray is one of the object's, below which one of the background
_VISIBLE = 0.05  # opacity of samples that teach the motion
_MOST_WARPED, _MOST_PAIRED = 4096, 2048  # of them, and of those that ask the bending how it stretches
_PAIR = 0.05  # of the box's side, between two places whose distance is to stay


@dataclass(frozen=True, kw_only=True)
class LossWeights:
    """Of the paper's L_background, L_foreground and L_density and of our L_elastic, beside the colours' one.

    The colours, compared over a random colour, ask for the first two already; here they can be asked for more strongly,
    as the paper does sequence by sequence. Raises ValueError when one is negative.
    """

    background: float = 0.0
    foreground: float = 0.0
    density: float = 0.01
    elastic: float = 20.0

    def __post_init__(self) -> None:
        for name in (f.name for f in fields(self)):
            require(getattr(self, name) >= 0, f"weight of the {name} loss", "be zero or more", getattr(self, name))


def shape_loss(
    seen: Composite, samples: Samples, thickness: torch.Tensor, batch: Batch, weights: LossWeights
) -> torch.Tensor:
    """What the mattes say of where the object is: the weighted sum of the three losses below; thickness (S,)."""
    total = thickness.new_zeros(())
    if weights.background:
        total = total + weights.background * background_loss(seen, batch)
    if weights.foreground:
        total = total + weights.foreground * foreground_loss(seen, samples, thickness, batch)
    if weights.density:
        total = total + weights.density * density_loss(seen, samples, thickness, batch)
    return total


def colour_loss(seen: Composite, batch: Batch, gains: torch.Tensor, behind: torch.Tensor) -> torch.Tensor:
    """Smooth L1 between prediction and picture, both over the colours `behind` (R, 3).

    Grey cameras are compared in luminance after their own gain and bias, gains (C, 2). Over a random
    colour, what is not the object must be clear and what is must be opaque.
    """
    own = seen.colour
    if batch.grey.any():
        luminance, (gain, bias) = own.new_tensor(_LUMINANCE), gains[batch.camera].T
        behind = torch.where(batch.grey[:, None], (behind @ luminance)[:, None], behind)
        grey = (own @ luminance) * gain + bias * seen.opacity
        own = torch.where(batch.grey[:, None], grey[:, None], own)
    predicted = own + (1 - seen.opacity)[:, None] * behind
    filmed = batch.colour + (1 - batch.matte)[:, None] * behind
    return torch.nn.functional.smooth_l1_loss(predicted, filmed, beta=_BEND) / _BEND


def background_loss(seen: Composite, batch: Batch) -> torch.Tensor:
    """Mean opacity of the rays that miss the object (paper: L_background)."""
    outside = batch.matte < _EMPTY
    return _mean(seen.opacity, outside)


def foreground_loss(seen: Composite, samples: Samples, thickness: torch.Tensor, batch: Batch) -> torch.Tensor:
    """Mean opacity of the samples before the surface on rays of the object (paper: L_foreground).

    thickness (S,): density times length of the samples.
    """
    before = (_left(seen, samples) > _CLEAR) & (batch.matte[samples.ray] > _SOLID)
    return _mean(1 - torch.exp(-thickness), before)


def density_loss(seen: Composite, samples: Samples, thickness: torch.Tensor, batch: Batch) -> torch.Tensor:
    """Mean transparency of the samples behind the surface on rays of the object (paper: L_density).

    thickness (S,): density times length of the samples.
    """
    behind = (_left(seen, samples) < _HIDDEN) & (batch.matte[samples.ray] > _SOLID)
    return _mean(torch.exp(-thickness), behind)


def _left(seen: Composite, samples: Samples) -> torch.Tensor:
    """Share of the light that is left behind each sample, (S,)."""
    weight = seen.weight.detach()
    passed = torch.cumsum(weight, dim=0)
    first = samples.rays[:, 0].long().clamp(max=max(len(weight) - 1, 0))
    return 1 - (passed - (passed[first] - weight[first])[samples.ray])


def _mean(values: torch.Tensor, of: torch.Tensor) -> torch.Tensor:
    """Of those chosen; zero where there are none."""
    return (values * of).sum() / of.sum().clamp(min=1)


def motion_loss(
    model: Dynamic, samples: Samples, canonical: torch.Tensor, thickness: torch.Tensor, weights: LossWeights,
    generator: torch.Generator,
) -> torch.Tensor:  # fmt: skip
    """What samples that are not clear ask of the motion: the two losses below; zero without such samples."""
    visible = torch.nonzero(thickness.detach() > _VISIBLE)[:, 0]
    if not len(visible):
        return thickness.new_zeros(())
    total = warp_loss(model, samples, canonical, _some(visible, _MOST_WARPED, generator))
    if weights.elastic:
        pairs = _some(visible, _MOST_PAIRED, generator)
        total = total + weights.elastic * elastic_loss(model, samples, canonical, pairs, generator)
    return total


def warp_loss(model: Dynamic, samples: Samples, canonical: torch.Tensor, chosen: torch.Tensor) -> torch.Tensor:
    """Mean distance between the chosen samples and where w carries their canonical places, in box sides.

    Bending and latents are taken as they are: w follows b and never pulls at it.
    """
    there = model.warped(canonical.detach()[chosen], samples.frame[chosen])
    return (there - samples.place[chosen]).norm(dim=1).mean() / model.canonical.box.side


def elastic_loss(
    model: Dynamic, samples: Samples, canonical: torch.Tensor, chosen: torch.Tensor, generator: torch.Generator
) -> torch.Tensor:
    """Mean square of the strain `|d + b(x + d) - b(x)| / |d| - 1` between the chosen samples x and places beside them.

    d is of one length and points anywhere. Pictures hardly tell a limb that bends from one whose slices slide; a soft
    object's do not (in the manner of the elastic regularisation of Park et al. 2021, "Nerfies").
    """
    length = _PAIR * model.canonical.box.side
    toward = torch.randn(len(chosen), 3, generator=generator).to(canonical)
    aside = torch.nn.functional.normalize(toward, dim=1) * length
    there = model.bent(samples.place[chosen] + aside, samples.frame[chosen])
    return (((there - canonical[chosen]).norm(dim=1) / length - 1) ** 2).mean()


def _some(which: torch.Tensor, most: int, generator: torch.Generator) -> torch.Tensor:
    """So many at most, drawn at random."""
    if len(which) <= most:
        return which
    return which[torch.randint(0, len(which), (most,), generator=generator).to(which.device)]
