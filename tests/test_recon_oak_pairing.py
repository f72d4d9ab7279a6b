"""Groups of pictures by time: what must hold for any recording, and what the clocks are said to do."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recon.oak.pairing import StreamTimes, clocks, pair

TICK = 2.0**-20  # [s]: differences of times are exact
PERIOD = 26_214 * TICK  # 40 fps
HALF = PERIOD / 2


@st.composite
def recordings(draw):
    """Streams at 40 fps that begin when they like, run 1 % fast or slow, tremble, and lose pictures."""
    streams = []
    for n in range(draw(st.integers(1, 5))):
        start, step = draw(st.integers(0, 100_000)), draw(st.integers(25_950, 26_470))
        pictures = st.tuples(st.integers(-8_000, 8_000), st.sampled_from([True, True, True, False]))
        drawn = draw(st.lists(pictures, max_size=15))
        ticks = [start + i * step + tremble for i, (tremble, kept) in enumerate(drawn) if kept]
        streams.append(StreamTimes(name=f"cam{n + 1:04d}", time=TICK * np.array(ticks)))
    return streams


def taken(streams, groups):
    return np.stack([s.time[groups.index[:, n]] for n, s in enumerate(streams)], axis=1)


@settings(max_examples=80, deadline=None, derandomize=True)
@given(streams=recordings(), within=st.sampled_from([HALF, PERIOD, 3_000 * TICK]))
def test_no_group_spans_more_and_every_picture_is_counted_once(streams, within):
    groups = pair(streams, within)
    times = taken(streams, groups)
    assert (np.ptp(times, axis=1) <= within).all() and (np.diff(groups.index, axis=0) > 0).all()
    np.testing.assert_array_equal(groups.spread, np.ptp(times, axis=1))
    np.testing.assert_array_equal(groups.dropped + len(groups.index), [len(s.time) for s in streams])
    assert groups.dropped.max() <= groups.incomplete <= groups.dropped.sum()


@settings(max_examples=60, deadline=None, derandomize=True)
@given(streams=recordings(), seed=st.integers(0, 100), later=st.integers(-10_000_000, 10_000_000))
def test_neither_order_nor_the_start_of_time_matters(streams, seed, later):
    order = np.random.default_rng(seed).permutation(len(streams))
    moved = [StreamTimes(name=streams[n].name, time=streams[n].time + later * TICK) for n in order]
    groups, other = pair(streams, HALF), pair(moved, HALF)
    np.testing.assert_array_equal(other.index, groups.index[:, order])
    np.testing.assert_array_equal(other.dropped, groups.dropped[order])
    assert other.incomplete == groups.incomplete


@settings(max_examples=60, deadline=None, derandomize=True)
@given(data=st.data(), cameras=st.integers(2, 6), count=st.integers(1, 20))
def test_synchronised_cameras_lose_exactly_the_moments_that_one_of_them_lost(data, cameras, count):
    """A rig on one trigger, trembling by up to an eighth of a frame: the moments that all saw, and only those."""
    tremble = st.lists(st.integers(-3_000, 3_000), min_size=count, max_size=count)
    seen = np.array([data.draw(st.lists(st.booleans(), min_size=count, max_size=count)) for _ in range(cameras)])
    streams = []
    for n in range(cameras):
        times = PERIOD * np.arange(count) + 1e-6 * np.array(data.draw(tremble))
        streams.append(StreamTimes(name=f"cam{n:04d}", time=times[seen[n]]))
    groups = pair(streams, HALF)
    moments = np.round(taken(streams, groups) / PERIOD).astype(int)
    together = np.flatnonzero(seen.all(axis=0))
    np.testing.assert_array_equal(moments, np.repeat(together[:, None], cameras, axis=1))
    assert groups.incomplete == (seen.any(axis=0) & ~seen.all(axis=0)).sum()


def test_of_two_possible_groups_the_tighter_one_is_taken():
    # by hand, within 25 ms: 0 and 24 would do, but 25 and 24 are closer; then 50 and 49
    streams = [
        StreamTimes(name="a", time=1e-3 * np.array([0.0, 25, 50])),
        StreamTimes(name="b", time=1e-3 * np.array([24.0, 49])),
    ]
    groups = pair(streams, 0.025)
    np.testing.assert_array_equal(groups.index, [[1, 0], [2, 1]])
    np.testing.assert_array_equal(groups.dropped, [1, 0])


def test_three_free_cameras_in_unlucky_phases_need_the_wider_span():
    streams = [StreamTimes(name=f"c{n}", time=1e-3 * (25.0 * np.arange(20) + 8.3 * n)) for n in range(3)]
    assert len(pair(streams, HALF).index) == 0 and pair(streams, HALF).incomplete >= 20
    assert len(pair(streams, PERIOD).index) == 20


def test_clocks_are_those_that_were_put_in():
    """A camera 2 ms late and one whose frames last 100 ppm longer, with trembling and lost pictures."""
    rng = np.random.default_rng(3)
    frames = np.arange(400)
    exact = 0.025 * frames
    late = exact + 2e-3 + 1e-4 * rng.standard_normal(400)
    slow = exact * (1 + 1e-4) + 1e-4 * rng.standard_normal(400)
    kept = rng.random(400) > 0.1
    streams = [
        StreamTimes(name="exact", time=exact),
        StreamTimes(name="late", time=late[kept]),
        StreamTimes(name="slow", time=slow[:300]),
    ]
    groups = pair(streams, HALF)
    run = clocks(streams, groups)
    np.testing.assert_allclose(run.offset[1] - run.offset[0], 2e-3, atol=3e-5)
    np.testing.assert_allclose(run.drift, [0, 0, 1e-4], atol=8e-6)
    one = [StreamTimes(name="one", time=np.array([1.0]))]
    np.testing.assert_array_equal(clocks(one, pair(one, HALF)).drift, [0])


def test_times_that_go_backwards_and_no_streams_are_refused():
    with pytest.raises(ValueError, match=r"cam0002\.left times must increase .* got 0\.900000 s after 1\.000000 s at"):
        StreamTimes(name="cam0002.left", time=np.array([0.5, 1.0, 0.9]))
    with pytest.raises(ValueError, match=r"cam0002\.left times must be finite"):
        StreamTimes(name="cam0002.left", time=np.array([0.5, np.nan]))
    with pytest.raises(ValueError, match="streams must be at least one; got 0"):
        pair([], HALF)
    with pytest.raises(ValueError, match="within must be positive; got nan"):
        pair([StreamTimes(name="a", time=np.zeros(0))], float("nan"))
