"""Several objects as one cloud whose parts are not connected, so that one solve moves them all."""

from itertools import accumulate, pairwise

import numpy as np

from sim.checks import require
from sim.cloud import RestCloud
from sim.hull import Hull

_PER_POINT = ("x", "weights", "arms", "gradients", "volume", "area", "surface", "reach", "incident_slot")


def join_clouds(*clouds: RestCloud) -> RestCloud:
    """One cloud of all points in order, each part with its own neighbours, volumes and surface.

    Building a cloud from the concatenated points would tie parts together where they come near each other.
    Raises ValueError for clouds built with different options.
    """
    options = clouds[0].options
    require(all(c.options == options for c in clouds), "clouds", "share their options", [c.options for c in clouds])
    arrays = {name: np.concatenate([getattr(c, name) for c in clouds]) for name in _PER_POINT}
    starts = [0, *accumulate(c.count for c in clouds)]
    edges = [0, *accumulate(c.neighbours.size for c in clouds)]
    islands = [0, *accumulate(int(c.island.max()) + 1 for c in clouds)]
    first = np.concatenate([c.incident_start[:-1] + n for c, n in zip(clouds, edges, strict=False)] + [edges[-1:]])
    hull = Hull(
        tetrahedra=np.concatenate([c.hull.tetrahedra + n for c, n in zip(clouds, starts, strict=False)]),
        faces=np.concatenate([c.hull.faces + n for c, n in zip(clouds, starts, strict=False)]),
    )
    return RestCloud(
        hull=hull, **arrays, options=options, incident_start=first.astype(np.int32),
        island=_shifted(clouds, "island", islands),
        neighbours=_shifted(clouds, "neighbours", starts), incident_point=_shifted(clouds, "incident_point", starts),
    )  # fmt: skip


def part_slices(*clouds: RestCloud) -> tuple[slice, ...]:
    """Where each cloud's points are among the joined ones."""
    starts = [0, *accumulate(c.count for c in clouds)]
    return tuple(slice(a, b) for a, b in pairwise(starts))


def _shifted(clouds: tuple[RestCloud, ...], name: str, by: list[int]) -> np.ndarray:
    parts = [getattr(c, name) for c in clouds]
    return np.concatenate([part + part.dtype.type(n) for part, n in zip(parts, by, strict=False)])
