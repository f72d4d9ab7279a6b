"""Directions that are worth a try: all around, or those in which something moves or is pushed."""

from collections.abc import Sequence
from itertools import product

import numpy as np

Way = tuple[float, float, float]  # a unit vector

_SIDES = [np.array(side) for side in product((-1, 0, 1), repeat=3) if any(side)]
ALL_AROUND: tuple[Way, ...] = tuple(tuple((side / np.linalg.norm(side)).tolist()) for side in _SIDES)

_STRONG = 0.3  # of the longest, that is asked for a direction
_APART = np.cos(np.deg2rad(25))  # between those that are told apart


def ways_of(vectors: np.ndarray) -> list[Way]:
    """The directions of those (T, 3) that are not much shorter than the longest, which comes first."""
    size = np.linalg.norm(vectors, axis=1)
    return [tuple((vectors[t] / size[t]).tolist()) for t in np.argsort(-size) if size[t] > _STRONG * size.max()]


def distinct(ways: Sequence[Way], most: int) -> list[Way]:
    """The first of those that lie close together, so many at most."""
    kept: list[Way] = []
    for way in ways:
        if all(np.dot(way, other) < _APART for other in kept) and len(kept) < most:
            kept.append(way)
    return kept


def in_words(way: Sequence[float]) -> str:
    """In words."""
    return f"({', '.join(f'{c:.2f}' for c in way)})"
