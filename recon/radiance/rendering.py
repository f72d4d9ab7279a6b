"""Pictures of a field: rays of a camera, samples where something may be, composited. The field is any function."""

from dataclasses import dataclass

import numpy as np
import torch

from recon.cameras import Camera
from recon.radiance.compositing import Composite, composite
from recon.radiance.device import array, device, tensor
from recon.radiance.fields import Field
from recon.radiance.marching import Occupancy, Samples, march
from sim.checks import require

STILL = 2  # fineness of a picture that is no film's: a pixel of a filmed one is the mean of what it covers, too
_CHUNK = 1 << 14  # rays at a time
_SLAB = 16  # samples of a ray at a time
_HIDDEN = 7.0  # optical depth, behind which less than a thousandth is seen


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """colour (h, w, 3) over black, opacity (h, w), 0 to 1; depth (h, w) [m] along the ray of what is opaque, infinite
    elsewhere."""

    colour: np.ndarray
    opacity: np.ndarray
    depth: np.ndarray


def camera_rays(camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
    """Start (P, 3) [m] and unit direction (P, 3) of the rays through all pixels' centres, row by row."""
    directions = tensor(camera.rays(camera.grid().reshape(-1, 2)).astype(np.float32))
    return tensor(camera.centre.astype(np.float32)).expand_as(directions), directions


def along(
    field: Field, occupancy: Occupancy, start: torch.Tensor, direction: torch.Tensor, frame: torch.Tensor, *,
    shift: torch.Tensor | None = None, since: torch.Tensor | None = None, until: torch.Tensor | None = None,
) -> tuple[Composite, Samples, torch.Tensor]:  # fmt: skip
    """The composite of rays (R, 3) in frames (R,), their samples, and each sample's density times its length."""
    samples = march(occupancy, start, direction, frame, step=occupancy.step, shift=shift, since=since, until=until)
    density, colour = field(samples.place, samples.frame)
    return _composited(density, colour, samples, occupancy.step), samples, density * occupancy.step


def _composited(density: torch.Tensor, colour: torch.Tensor, samples: Samples, step: float) -> Composite:
    length = torch.full_like(samples.depth, step)
    return composite(density, colour, length, samples.depth, samples.rays)


@torch.no_grad()
def render(
    field: Field, occupancy: Occupancy, camera: Camera, *, frame: int = 0, behind: Picture | None = None,
    fineness: int = 1,
) -> Picture:  # fmt: skip
    """What a camera sees of a field in a frame of the occupancy, a pixel the mean of `fineness^2` rays.

    behind: another picture of the same camera, such as a mesh that pushes the object: rays end where it is opaque, and
    what they leave clear shows it. Raises ValueError when it has another size, or when fineness is below one.
    """
    require(fineness >= 1, "fineness", "be at least 1", fineness)
    shape = camera.size[::-1]
    fits = behind is None or behind.depth.shape == shape
    require(fits, "behind", f"have {camera.name}'s size {camera.size}", behind and behind.depth.shape[::-1])
    if fineness > 1:
        size = tuple(fineness * n for n in camera.size)
        finer = None if behind is None else _repeated(behind, fineness)
        return _averaged(render(field, occupancy, camera.resized(size), frame=frame, behind=finer), fineness)
    start, direction = camera_rays(camera)
    until = _until(camera, behind)
    parts = []
    for own, toward, end in zip(*(v.split(_CHUNK) for v in (start, direction, until)), strict=True):
        frames = torch.full((len(own),), frame, device=device())
        samples = march(occupancy, own, toward, frames, step=occupancy.step, until=end)
        parts.append(_composited(*_unhidden(field, samples, occupancy.step), samples, occupancy.step))
    colour, opacity, depth = (array(torch.cat([getattr(p, n) for p in parts])) for n in ("colour", "opacity", "depth"))
    away = np.where(opacity > 0.5, depth / np.maximum(opacity, 1e-6), np.inf)
    own = Picture(colour=colour.reshape(*shape, 3), opacity=opacity.reshape(shape), depth=away.reshape(shape))
    return own if behind is None else _over(own, behind)


def _unhidden(field: Field, samples: Samples, step: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Density (S,) and colour (S, 3) of samples, front to back: the field is not asked for what is hidden."""
    density, colour = torch.zeros_like(samples.depth), torch.zeros_like(samples.place)
    before = density.new_zeros(len(samples.rays))
    order = torch.arange(len(density), device=density.device) - samples.rays[samples.ray, 0]
    for first in range(0, int(samples.rays[:, 1].max()), _SLAB):
        slab = (order >= first) & (order < first + _SLAB) & (before[samples.ray] < _HIDDEN)
        own = torch.nonzero(slab)[:, 0]
        if not len(own):
            break
        density[own], colour[own] = field(samples.place[own], samples.frame[own])
        before.index_add_(0, samples.ray[own], density[own] * step)
    return density, colour


def _repeated(picture: Picture, times: int) -> Picture:
    """With every pixel that many times along both sides."""
    colour, opacity, depth = (
        v.repeat(times, axis=0).repeat(times, axis=1) for v in (picture.colour, picture.opacity, picture.depth)
    )
    return Picture(colour=colour, opacity=opacity, depth=depth)


def _averaged(picture: Picture, times: int) -> Picture:
    """With that many pixels fewer along both sides; depth where most is opaque, of what is."""
    blocks = picture.depth.shape[0] // times, times, picture.depth.shape[1] // times, times
    opacity = picture.opacity.reshape(blocks).mean(axis=(1, 3))
    near = np.isfinite(picture.depth)
    depth = np.where(near, picture.depth, 0.0).reshape(blocks).sum(axis=(1, 3))
    depth /= np.maximum(near.reshape(blocks).sum(axis=(1, 3)), 1)
    return Picture(
        colour=picture.colour.reshape(*blocks, 3).mean(axis=(1, 3)), opacity=opacity,
        depth=np.where(opacity > 0.5, depth, np.inf),
    )  # fmt: skip


def _until(camera: Camera, behind: Picture | None) -> torch.Tensor:
    if behind is None:
        return torch.full((camera.size[0] * camera.size[1],), torch.inf, device=device())
    return tensor(np.where(behind.opacity > 0.5, behind.depth, np.inf).astype(np.float32).ravel())


def _over(own: Picture, behind: Picture) -> Picture:
    left = 1 - own.opacity
    return Picture(
        colour=own.colour + left[..., None] * behind.colour, opacity=own.opacity + left * behind.opacity,
        depth=np.minimum(own.depth, behind.depth),
    )  # fmt: skip
