"""What the choice of neighbours and of the stabilisation changes: the shape of the discretisation's own error."""

import numpy as np

from sim.cloud import CloudOptions, RestCloud
from sim.elastic import Elastic
from sim.pattern import Pattern

_OTHERS = (CloudOptions(neighbours=12), CloudOptions(neighbours=6), CloudOptions(stabilisation=3.0))


def other_discretisations(elastic: Elastic) -> list[Elastic]:
    """The same material on the same points with 12 or 6 neighbours, and with three times the stabilisation.

    Fewer where so few neighbours do not surround every point.
    """
    clouds = [_rebuilt(elastic.cloud, options) for options in _OTHERS]
    return [Elastic(cloud=c, m=elastic.m, pattern=Pattern.of(c), law=elastic.law) for c in clouds if c is not None]


def _rebuilt(cloud: RestCloud, options: CloudOptions) -> RestCloud | None:
    try:
        return RestCloud.build(cloud.x, volume=cloud.volume, surface=cloud.surface, options=options)
    except ValueError:
        return None


def changed_forces(elastic: Elastic, y: np.ndarray) -> np.ndarray:
    """By how much the elastic forces at y (T, N, 3) change with each of those, (T, L, N, 3) [N]."""
    own = elastic.gradient(y)
    changes = [own - other.gradient(y) for other in other_discretisations(elastic)]
    return np.stack(changes, axis=1) if changes else np.zeros((len(y), 0, *y.shape[1:]))
