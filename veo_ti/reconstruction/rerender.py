"""The object as it would look in states that nobody filmed, and the paper's Table 2 of simulated states."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from recon.cameras import Camera
from recon.quality.lpips import Lpips
from recon.quality.similarity import QualityRow, quality_row
from recon.radiance.cloudwarp import CloudWarp, cloud_occupancy, densified, moved_field, neighbours
from recon.radiance.device import array, tensor
from recon.radiance.rendering import Picture, render
from recon.radiance.training import Trained
from recon.views import Views

CUT = 1.5  # spacings from the cloud beyond which the field is cut away


@dataclass(frozen=True, kw_only=True, eq=False)
class Rerenderer:
    """A trained field bent by a cloud: rest (N, 3) [m] as in frame 0, spacing [m] between its points."""

    trained: Trained
    rest: np.ndarray
    spacing: float

    @cached_property
    def canonical(self) -> np.ndarray:
        """The cloud in the canonical state, (N, 3) [m]: interpolated like its motion, so that no network is asked for
        every sample."""
        with torch.no_grad():
            return array(self.trained.field.from_first(tensor(self.rest.astype(np.float32))).double())

    @cached_property
    def neighbours(self) -> np.ndarray:
        """Pairs (P, 2) between which a strongly stretched state gets a point."""
        return neighbours(self.canonical)

    def picture(self, moved: np.ndarray, camera: Camera, behind: Picture | None = None) -> Picture:
        """The object with its points at `moved` (N, 3) [m], as a camera sees it; behind: see `render`."""
        cut = CUT * self.spacing
        canonical, moved = densified(self.canonical, moved, self.neighbours)
        field = moved_field(self.trained.field.canonical, CloudWarp.of(canonical, moved), cut)
        return render(field, cloud_occupancy(moved, cut=cut), camera, behind=behind)


def table_two(
    renderer: Rerenderer, judges: Views, frames: Sequence[int], states: np.ndarray, lpips: Lpips | None
) -> tuple[QualityRow, list[np.ndarray]]:
    """Quality on cameras that taught nothing of clouds `states` (F, N, 3) [m] in filmed frames (F,); the pictures too.

    The paper's Table 2 (tab:rerender) with simulated, and with reconstructed clouds, which are its upper bound.
    """
    shown, filmed, mattes = [], [], []
    moved = dict(zip(frames, states, strict=True))
    for camera, frame, picture, matte in judges.looks(frames):
        shown.append(renderer.picture(moved[frame], camera).colour)
        filmed.append(picture)
        mattes.append(matte)
    return quality_row(shown, filmed, mattes, lpips), shown
