"""Pixels to train on: the rays of all cameras that meet the object's hull, drawn at random with what was filmed."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch

from recon.radiance.device import array, device, tensor
from recon.radiance.marching import Occupancy, meets
from recon.radiance.rendering import camera_rays
from recon.views import Views
from sim.checks import require

_OUTSIDE = 2  # of the pixels beside the object one in so many is enough, and leaves more of a batch to the object


@dataclass(frozen=True, kw_only=True, eq=False)
class Batch:
    """Of R pixels: rays (start, direction (R, 3)), frame (R,), camera (R,), the object's colour over black (R, 3) 0 to
    1 (grey thrice), matte (R,) 0 to 1, and whether the camera is grey (R,)."""

    start: torch.Tensor
    direction: torch.Tensor
    frame: torch.Tensor
    camera: torch.Tensor
    colour: torch.Tensor
    matte: torch.Tensor
    grey: torch.Tensor


@dataclass(frozen=True, kw_only=True, eq=False)
class Pixels:
    """All pixels of all training cameras, camera after camera, and of each frame the ones to train on: those whose ray
    meets its hull, of those beside the object one in two."""

    first: np.ndarray  # (C + 1,) where each camera's pixels begin
    grey: torch.Tensor  # (C,) bool
    centres: torch.Tensor  # (C, 3) [m]
    directions: torch.Tensor  # (P, 3)
    hits: tuple[np.ndarray, ...]  # by frame, (H,) int32 pixel numbers
    filmed: tuple[np.ndarray, ...]  # by frame, (H, 4) uint8 colour and matte

    @classmethod
    def of(cls, views: Views, occupancy: Occupancy) -> "Pixels":
        """Raises ValueError naming the frame that no camera's hull shows."""
        require(len(views.mattes) == len(views.cameras), "mattes", "be there for every camera; make them first", "none")
        rays = [camera_rays(camera) for camera in views.cameras]
        first = np.cumsum([0, *(len(d) for _, d in rays)])
        inside = np.concatenate([i.ravel() for i in views.inside])
        starts, directions = (torch.cat([r[i] for r in rays]) for i in (0, 1))
        hits, pictures = [], []
        for frame in range(len(views.times)):
            met = meets(occupancy, starts, directions, torch.full((len(starts),), frame, device=device()))
            hit = np.flatnonzero(array(met) & inside).astype(np.int32)
            require(len(hit) > 0, f"frame {frame}", "show the object in some camera", "no pixel")
            filmed = _filmed(views, first, frame, hit)
            kept = (filmed[:, 3] > 0) | ((hit + frame) % _OUTSIDE == 0)
            hits.append(hit[kept])
            pictures.append(filmed[kept])
        return cls(
            first=first, grey=tensor(np.array([camera.stream != "colour" for camera in views.cameras])),
            centres=torch.stack([s[0] for s, _ in rays]), directions=directions, hits=tuple(hits),
            filmed=tuple(pictures),
        )  # fmt: skip

    def draw(self, frames: torch.Tensor, generator: torch.Generator) -> Batch:
        """One pixel at random for each of some frames (R,)."""
        chosen = torch.rand(len(frames), generator=generator).numpy()
        number, filmed = np.empty(len(frames), np.int32), np.empty((len(frames), 4), np.uint8)
        for frame in np.unique(frames.numpy()):
            own = np.flatnonzero(frames.numpy() == frame)
            at = (chosen[own] * len(self.hits[frame])).astype(np.int64)
            number[own], filmed[own] = self.hits[frame][at], self.filmed[frame][at]
        camera = tensor(np.searchsorted(self.first, number, side="right") - 1)
        seen = tensor(filmed) / 255
        return Batch(
            start=self.centres[camera], direction=self.directions[tensor(number)], frame=frames.to(device()),
            camera=camera, colour=seen[:, :3], matte=seen[:, 3], grey=self.grey[camera],
        )  # fmt: skip


def _filmed(views: Views, first: np.ndarray, frame: int, number: np.ndarray) -> np.ndarray:
    """Colour (grey thrice) and matte of a frame's pixels, whose numbers ascend, (H, 4) uint8."""
    filmed = np.empty((len(number), 4), np.uint8)
    ends = np.searchsorted(number, first)
    for c, (begin, end) in enumerate(pairwise(ends)):
        pixel, image = number[begin:end] - first[c], np.asarray(views.images[c][frame])
        filmed[begin:end, :3] = image.reshape(image.shape[0] * image.shape[1], -1)[pixel]
        filmed[begin:end, 3] = np.asarray(views.mattes[c][frame]).ravel()[pixel]
    return filmed


def frames_of(count: int, frames: Sequence[int], generator: torch.Generator) -> torch.Tensor:
    """`count` frames drawn at random from some."""
    return torch.tensor(frames)[torch.randint(0, len(frames), (count,), generator=generator)]
