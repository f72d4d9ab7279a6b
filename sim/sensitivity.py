"""How the equilibrium moves with the material: forward sensitivities, one factorisation per frame, many directions."""

from collections.abc import Iterator

import numpy as np

from sim.energy import Energy
from sim.linear import Layout, solve_directly


def sensitivities(energy: Energy, y: np.ndarray, directions: np.ndarray, *, chunk: int = 4) -> Iterator[np.ndarray]:
    """dy/da of every frame in turn, (K, N, 3), for parameter changes dm/da = directions (K, N, P).

    `S = -H^-1 d(dE/dy)/dm : directions`. The force of a parameter change is the elastic gradient with the parameters
    replaced by their change, because the law is linear in them.
    """
    layout = Layout(pattern=energy.elastic.pattern)
    changes = [energy.elastic.with_parameters(d) for d in directions]
    for first in range(0, len(y), chunk):
        index = np.arange(first, min(first + chunk, len(y)))
        part, state = energy.frames(index), y[index]
        right = np.stack([-energy.free(change.gradient(state)) for change in changes], axis=1)
        yield from solve_directly(part.tangent(state), layout, right)
