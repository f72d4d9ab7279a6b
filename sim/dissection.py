"""The order in which a sparse matrix is eliminated: a nested dissection of the points, and its dense fronts.

George (1973) for the ordering, with the fewest points that separate (Pothen & Fan 1990), Duff and Reid (1983) for the
fronts. It depends on the pattern alone and is made once; SuperLU makes its own for every matrix anew.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import maximum_bipartite_matching

from sim.pattern import Pattern

_LEAF = 40  # points that are not dissected further
Runs = tuple[tuple[slice, slice], ...]  # coordinates of a part, and those of the whole that they are


@dataclass(frozen=True, kw_only=True, eq=False)
class Front:
    """Points [first, last) of the elimination order, those after them that they reach, and what is summed in."""

    first: int
    last: int
    above: np.ndarray  # (b,) elimination numbers, ascending
    pair: np.ndarray  # pairs of the pattern that enter here, with their
    row: np.ndarray  # place among own and above, and
    column: np.ndarray  # place among own
    children: tuple[tuple[int, Runs, Runs], ...]  # fronts whose rest enters here, and where: among own, above

    @property
    def own(self) -> slice:
        """Coordinates of the points."""
        return slice(3 * self.first, 3 * self.last)


@dataclass(frozen=True, kw_only=True, eq=False)
class Dissection:
    """The order in which points are eliminated, and the fronts, children before parents."""

    order: np.ndarray  # (N,) points
    fronts: tuple[Front, ...]

    @classmethod
    def of(cls, pattern: Pattern, x: np.ndarray) -> "Dissection":
        """Dissect the points x (N, 3) by the separators of the pattern's graph, halves first."""
        N = len(x)
        graph = sp.csr_matrix((np.ones(len(pattern.indices)), pattern.indices, pattern.indptr), shape=(N, N))
        groups = list(_dissected(_along_a_curve(x), x, graph))
        order = np.concatenate(groups)
        number = np.empty(N, int)
        number[order] = np.arange(N)
        return cls(order=order, fronts=_fronts(groups, number, pattern))

    @cached_property
    def size(self) -> int:
        """Numbers of one factor."""
        return sum(9 * (f.last - f.first) * (f.last - f.first + len(f.above)) for f in self.fronts)

    def parts(self, rows: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Of factors rows (F, size), for every front: the inverse of its own block of L, and the rows of L below it."""
        F, parts, end = len(rows), [], 0
        for front in self.fronts:
            own, above = 3 * (front.last - front.first), 3 * len(front.above)
            middle, begin, end = end + own**2, end, end + own * (own + above)
            parts.append((rows[:, begin:middle].reshape(F, own, own), rows[:, middle:end].reshape(F, above, own)))
        return parts


def _dissected(points: np.ndarray, x: np.ndarray, graph: sp.csr_matrix) -> Iterator[np.ndarray]:
    """Groups of points in the order of their elimination: both halves, then what separates them."""
    if len(points) <= _LEAF:
        yield points
        return
    left, right, between = min((_halves(points, x[points, a], graph) for a in range(3)), key=lambda cut: len(cut[2]))
    if not len(left) or not len(right):
        yield points
        return
    yield from _dissected(left, x, graph)
    yield from _dissected(right, x, graph)
    if len(between):
        yield between


def _halves(
    points: np.ndarray, along: np.ndarray, graph: sp.csr_matrix
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The points in two halves along a coordinate, without the fewest that leave none of the one beside the other, and
    these."""
    lower = np.zeros(len(points), bool)
    lower[np.argsort(along, kind="stable")[: len(points) // 2]] = True
    between = np.zeros(len(points), bool)
    between[lower], between[~lower] = _cover(graph[points[lower]][:, points[~lower]])
    return points[lower & ~between], points[~lower & ~between], points[between]


def _cover(edges: sp.csr_matrix) -> tuple[np.ndarray, np.ndarray]:
    """The fewest rows and columns that hold all edges between them (Konig's theorem): as many as can be matched."""
    partner = maximum_bipartite_matching(edges, perm_type="column")
    matched, before = partner >= 0, None
    reached = ~matched  # rows, by alternating paths from those without a partner
    while before is None or (reached != before).any():
        before, columns = reached, edges.T @ reached.astype(float) > 0
        reached = ~matched | columns[partner]
    return matched & ~reached, columns


def _runs(places: np.ndarray, own: int) -> tuple[Runs, Runs]:
    """Ascending places of points as runs of neighbouring coordinates: those among the first `own`, and beyond these."""
    cuts = np.concatenate([[0], np.flatnonzero(np.diff(places) > 1) + 1, [len(places)]])
    cuts = np.unique([*cuts, np.searchsorted(places, own)]).tolist()
    within: list[tuple[slice, slice]] = []
    beyond: list[tuple[slice, slice]] = []
    for a, b in itertools.pairwise(cuts):
        first = int(places[a])
        runs, begin = (within, 3 * first) if first < own else (beyond, 3 * (first - own))
        runs.append((slice(3 * a, 3 * b), slice(begin, begin + 3 * (b - a))))
    return tuple(within), tuple(beyond)


def _along_a_curve(x: np.ndarray) -> np.ndarray:
    """The points' order along Morton's curve: what a half reaches of a separator then comes in few runs."""
    cells = ((x - x.min(axis=0)) / max(float(np.ptp(x, axis=0).max()), 1e-300) * 1023).astype(np.int64)
    bits = (cells[:, :, None] >> np.arange(10)) & 1
    return np.argsort((bits << (3 * np.arange(10) + np.arange(3)[:, None])).sum(axis=(1, 2)), kind="stable")


def _fronts(groups: list[np.ndarray], number: np.ndarray, pattern: Pattern) -> tuple[Front, ...]:
    """What enters each front and where: entries of the matrix by the earlier of their two points, rests by the first
    point that they reach."""
    ends = np.cumsum([len(group) for group in groups])
    owner = np.repeat(np.arange(len(groups)), np.diff(ends, prepend=0))  # of an elimination number
    row, column = number[pattern.rows], number[pattern.indices]
    entering = np.flatnonzero(row >= column)
    entering = entering[np.argsort(owner[column[entering]], kind="stable")]
    starts = np.searchsorted(owner[column[entering]], np.arange(len(groups) + 1))
    pending: list[list[tuple[int, np.ndarray]]] = [[] for _ in groups]
    fronts = []
    for k, last in enumerate(ends):
        first, pair = last - len(groups[k]), entering[starts[k] : starts[k + 1]]
        reached = np.unique(np.concatenate([row[pair], *(above for _, above in pending[k])]))
        above = reached[reached >= last]
        places = np.concatenate([np.arange(first, last), above])
        fronts.append(
            Front(
                first=first, last=last, above=above, pair=pair, row=np.searchsorted(places, row[pair]),
                column=column[pair] - first,
                children=tuple(
                    (child, *_runs(np.searchsorted(places, reach), last - first)) for child, reach in pending[k]
                ),
            )
        )  # fmt: skip
        if len(above):
            pending[owner[above[0]]].append((k, above))
    return tuple(fronts)
