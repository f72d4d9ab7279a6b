"""What a model gains on frames that chose nothing, with an interval over blocks of frames."""

from collections.abc import Callable

import numpy as np

_DRAWS = 2000
_FEW = 4  # runs of frames, below which single frames are drawn


def interval(statistic: Callable[[np.ndarray], float], held: np.ndarray, *, seed: int = 0) -> tuple[float, float]:
    """95 % of what a statistic of frame indices is when runs of neighbouring held-out frames are drawn anew.

    held (H,): the held-out frames, ascending. A bootstrap over runs, never over points nor, unless there are but few,
    over frames: errors are alike in neighbouring ones.
    """
    runs = np.split(held, np.flatnonzero(np.diff(held) > 1) + 1)
    if len(runs) < _FEW:
        runs = list(held[:, None])
    random = np.random.default_rng(seed)
    draws = (random.integers(len(runs), size=len(runs)) for _ in range(_DRAWS))
    values = [statistic(np.concatenate([runs[i] for i in draw])) for draw in draws]
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)
