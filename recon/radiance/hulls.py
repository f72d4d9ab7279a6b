"""Where each frame may have something: the visual hulls of the mattes, on one grid for all frames."""

from collections.abc import Callable

import numpy as np

from recon.hull import Hull, HullOptions, visual_hull
from recon.radiance.device import tensor
from recon.radiance.fields import Box
from recon.radiance.marching import Occupancy
from recon.views import Views
from sim.checks import require

_FIRST_LOOKS = 6  # frames whose hulls say how large the common box must be
_MARGIN = 0.15  # of the box's size, that frames in between may reach further


def hulls_of(views: Views, *, cells: int = 96, say: Callable[[str], None] | None = None) -> tuple[Box, Occupancy]:
    """The cube around the object in all frames, and what of it each frame's mattes allow.

    cells: along the longest side. Raises ValueError without mattes, with one camera only, and naming the frame whose
    mattes are empty or have no part of space in common.
    """
    require(len(views.cameras) >= 2, "cameras", "be at least two; one alone shows no depth", len(views.cameras))
    require(len(views.mattes) == len(views.cameras), "mattes", "be there for every camera; make them first", "none")
    count = len(views.times)
    first = np.unique(np.linspace(0, count - 1, _FIRST_LOOKS).astype(int)).tolist()
    looks = [_hull(views, frame, HullOptions(cells=32), None) for frame in first]
    low = np.min([h.points.min(axis=0) - h.spacing for h in looks], axis=0)
    high = np.max([h.points.max(axis=0) + h.spacing for h in looks], axis=0)
    margin = _MARGIN * (high - low).max()
    bounds = np.stack([low - margin, high + margin])
    frames = []
    for frame in range(count):
        if say is not None:
            say(f"hull of frame {frame + 1} of {count}")
        frames.append(_hull(views, frame, HullOptions(cells=cells), bounds))
    occupied = tensor(np.stack([h.occupied for h in frames]).astype(np.uint8))
    origin = tensor(bounds[0].astype(np.float32))
    box = Box(origin=bounds[0], side=float(np.ptp(bounds, axis=0).max()))
    return box, Occupancy(cells=occupied, origin=origin, spacing=frames[0].spacing)


def _hull(views: Views, frame: int, options: HullOptions, bounds: np.ndarray | None) -> Hull:
    mattes = [np.asarray(m[frame]) > 127 for m in views.mattes]
    try:
        return visual_hull(views.cameras, mattes, options, bounds)
    except ValueError as error:
        raise ValueError(f"frame {frame}: {error}") from None
