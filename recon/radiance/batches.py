"""Pixels to train on: the rays of all cameras that meet the object's hull, drawn at random with what was filmed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from recon.radiance.marching import Occupancy, meets
from recon.radiance.rendering import camera_rays
from recon.views import Views
from sim.checks import require


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
    """All pixels of all training cameras, camera after camera, and those of each frame whose ray meets its hull."""

    views: Views
    first: np.ndarray  # (C + 1,) where each camera's pixels begin
    centres: torch.Tensor  # (C, 3) [m]
    directions: torch.Tensor  # (P, 3)
    hits: tuple[np.ndarray, ...]  # by frame, (H,) pixel numbers

    @classmethod
    def of(cls, views: Views, occupancy: Occupancy) -> "Pixels":
        """Raises ValueError naming the frame that no camera's hull shows."""
        require(len(views.mattes) == len(views.cameras), "mattes", "be there for every camera; make them first", "none")
        rays = [camera_rays(camera) for camera in views.cameras]
        first = np.cumsum([0, *(len(d) for _, d in rays)])
        inside = np.concatenate([i.ravel() for i in views.inside])
        starts, directions = (torch.cat([r[i] for r in rays]) for i in (0, 1))
        hits = []
        for frame in range(len(views.times)):
            met = meets(occupancy, starts, directions, torch.full((len(starts),), frame))
            hit = np.flatnonzero(met.numpy() & inside)
            require(len(hit) > 0, f"frame {frame}", "show the object in some camera", "no pixel")
            hits.append(hit)
        centres = torch.stack([s[0] for s, _ in rays])
        return cls(views=views, first=first, centres=centres, directions=directions, hits=tuple(hits))

    def draw(self, frames: torch.Tensor, generator: torch.Generator) -> Batch:
        """One pixel at random for each of some frames (R,)."""
        chosen = torch.rand(len(frames), generator=generator).numpy()
        number = np.empty(len(frames), np.int64)
        for frame in np.unique(frames.numpy()):
            own = np.flatnonzero(frames.numpy() == frame)
            number[own] = self.hits[frame][(chosen[own] * len(self.hits[frame])).astype(np.int64)]
        camera = np.searchsorted(self.first, number, side="right") - 1
        colour, matte = self._filmed(frames.numpy(), camera, number - self.first[camera])
        streams = np.array([c.stream != "colour" for c in self.views.cameras])
        return Batch(
            start=self.centres[camera], direction=self.directions[number], frame=frames,
            camera=torch.from_numpy(camera), colour=colour, matte=matte, grey=torch.from_numpy(streams[camera]),
        )  # fmt: skip

    def _filmed(self, frame: np.ndarray, camera: np.ndarray, pixel: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        colour, matte = np.empty((len(frame), 3), np.float32), np.empty(len(frame), np.float32)
        for c in np.unique(camera):
            own = np.flatnonzero(camera == c)
            row, column = np.divmod(pixel[own], self.views.cameras[c].size[0])
            seen = self.views.images[c][frame[own], row, column]
            colour[own] = seen if seen.ndim == 2 else seen[:, None]
            matte[own] = self.views.mattes[c][frame[own], row, column]
        return torch.from_numpy(colour / 255), torch.from_numpy(matte / 255)


def frames_of(count: int, frames: Sequence[int], generator: torch.Generator) -> torch.Tensor:
    """`count` frames drawn at random from some."""
    return torch.tensor(frames)[torch.randint(0, len(frames), (count,), generator=generator)]
