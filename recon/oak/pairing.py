"""Pictures of many cameras that belong together: groups by time, and what the cameras' clocks do."""

import heapq
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.checks import as_array, require


@dataclass(frozen=True, kw_only=True, eq=False)
class StreamTimes:
    """When each picture of one stream was taken, (F,) [s] on a clock that all streams share.

    Raises ValueError when a time does not come after the one before it.
    """

    name: str
    time: np.ndarray

    def __post_init__(self) -> None:
        time = as_array(f"{self.name} times", self.time, (None,))
        back = np.flatnonzero(np.diff(time) <= 0)
        if len(back):
            at = int(back[0])
            went = f"{time[at + 1]:.6f} s after {time[at]:.6f} s at picture {at + 1}"
            require(False, f"{self.name} times", "increase from picture to picture", went)
        object.__setattr__(self, "time", time)


@dataclass(frozen=True, kw_only=True, eq=False)
class Groups:
    """Pictures that were taken together: one of every stream in each group.

    index (G, N): which picture of each stream; time (G,) [s]: the middle of each group; spread (G,) [s]: from its
    first picture to its last, never above `within`. dropped (N,): pictures of each stream that are in no group.
    incomplete: moments at which some streams had a picture, but not all.
    """

    names: tuple[str, ...]
    within: float  # [s]
    index: np.ndarray
    time: np.ndarray
    spread: np.ndarray
    dropped: np.ndarray
    incomplete: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Clocks:
    """How the streams run against one another, (N,) each.

    offset [s]: how long after its group's middle a stream's picture comes, the mean over all groups. drift (ratio):
    how much longer a stream's frame lasts than the median stream's; 1e-6 is one microsecond lost a second.
    """

    names: tuple[str, ...]
    offset: np.ndarray
    drift: np.ndarray


def pair(streams: Sequence[StreamTimes], within: float) -> Groups:
    """Groups of one picture a stream that were all taken within `within` [s], in order, no picture in two groups.

    The pivot is the latest of the streams' next pictures. Of all groups that hold it the one with the least spread is
    taken (as ROS's ApproximateTime filter does); what is left over is counted. The result depends neither on the
    order of the streams nor on when time began. Raises ValueError without streams or for a span that is not positive.
    """
    require(len(streams) > 0, "streams", "be at least one", 0)
    require(bool(within > 0), "within", "be positive", within)
    times = [s.time.tolist() for s in streams]
    heads, found = [0] * len(times), []
    while all(i < len(t) for i, t in zip(heads, times, strict=True)):
        pivot = max(t[i] for i, t in zip(heads, times, strict=True))
        group = _tightest(times, heads, pivot)
        if _spread(times, group) <= within:
            found.append(group)
            heads = [i + 1 for i in group]
        else:  # a group with any picture up to the pivot would be no tighter than this one
            heads = [bisect_right(t, pivot, lo=i) for i, t in zip(heads, times, strict=True)]
    index = np.array(found, dtype=int).reshape(-1, len(times))
    return _groups(streams, within, index)


def _tightest(times: list[list[float]], heads: list[int], pivot: float) -> list[int]:
    """The group with the least spread among those that hold the pivot: drop the earliest picture again and again."""
    group = best = list(heads)
    least = _spread(times, group)
    queue = [(t[i], n) for n, (i, t) in enumerate(zip(group, times, strict=True))]
    heapq.heapify(queue)
    last = pivot
    while queue[0][0] < pivot:
        n = queue[0][1]
        if group[n] + 1 == len(times[n]):
            break
        group = [i + (k == n) for k, i in enumerate(group)]
        heapq.heapreplace(queue, (times[n][group[n]], n))
        last = max(last, times[n][group[n]])
        if last - queue[0][0] < least:
            best, least = group, last - queue[0][0]
    return best


def _spread(times: list[list[float]], group: list[int]) -> float:
    taken = [t[i] for i, t in zip(group, times, strict=True)]
    return max(taken) - min(taken)


def _groups(streams: Sequence[StreamTimes], within: float, index: np.ndarray) -> Groups:
    taken = np.stack([s.time[index[:, n]] for n, s in enumerate(streams)])
    first, last = taken.min(axis=0), taken.max(axis=0)
    left = [np.delete(s.time, index[:, n]) for n, s in enumerate(streams)]
    return Groups(
        names=tuple(s.name for s in streams),
        within=within,
        index=index,
        time=(first + last) / 2,
        spread=last - first,
        dropped=np.array([len(t) for t in left]),
        incomplete=_moments(left, within),
    )


def _moments(left: list[np.ndarray], within: float) -> int:
    """At how many moments the pictures that are left over were taken: within that span, each stream once."""
    pictures = sorted((t, n) for n, times in enumerate(left) for t in times.tolist())
    count, began, seen = 0, -np.inf, set()
    for t, n in pictures:
        if t - began > within or n in seen:
            count, began, seen = count + 1, t, set()
        seen.add(n)
    return count


def clocks(streams: Sequence[StreamTimes], groups: Groups) -> Clocks:
    """How the streams' clocks run against one another; 0 where a stream has too few pictures to tell."""
    off = [s.time[groups.index[:, n]] - groups.time for n, s in enumerate(streams)]
    periods = np.array([_period(s.time) for s in streams])
    known = periods > 0
    middle = np.median(periods[known]) if known.any() else 1.0
    return Clocks(
        names=groups.names,
        offset=np.array([o.mean() if len(o) else 0.0 for o in off]),
        drift=np.where(known, periods / middle - 1, 0.0),
    )


def _period(time: np.ndarray) -> float:
    """How long a frame lasts [s]: the slope of time over the count of frames, those that are missing counted in."""
    if len(time) < 3:
        return 0.0
    steps = np.diff(time)
    count = np.concatenate([[0.0], np.cumsum(np.maximum(1, np.round(steps / np.median(steps))))])
    return float(np.polyfit(count - count.mean(), time - time.mean(), 1)[0])
