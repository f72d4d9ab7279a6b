"""Timing by turns: every peer runs once a round, so that what else the machine does falls on all of them."""

import time
from collections.abc import Callable, Mapping

import numpy as np

Job = Callable[[], object]


def interleaved(jobs: Mapping[str, Job], rounds: int, warm: int = 1) -> dict[str, np.ndarray]:
    """Seconds of every round of every job, (rounds,) each, after `warm` rounds that are not counted."""
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    for turn in range(warm + rounds):
        for name, job in jobs.items():
            begin = time.perf_counter()
            job()
            if turn >= warm:
                seconds[name].append(time.perf_counter() - begin)
    return {name: np.array(values) for name, values in seconds.items()}


def ratio(above: np.ndarray, below: np.ndarray) -> float:
    """Median over the rounds of one job's time over another's."""
    return float(np.median(above / below))


def milliseconds(seconds: np.ndarray) -> str:
    """The median, for people."""
    return f"{1e3 * np.median(seconds):.3g} ms"
