"""The interval of a gain: as wide as blocks of frames scatter, not as frames do."""

import numpy as np
import pytest

from veo_ti.held_out import interval

HELD = np.array([3, 4, 10, 11, 17, 18, 24, 25, 31, 32, 38, 39])  # six runs of two


def test_a_statistic_that_never_changes_has_no_width():
    assert interval(lambda frames: 2.0, HELD) == (2.0, 2.0)


def test_the_interval_of_a_mean_is_that_of_the_runs_means():
    rng = np.random.default_rng(0)
    count, blocks = 60, rng.normal(size=60)
    held = np.flatnonzero(np.arange(4 * count) % 4 < 2)  # runs of two, alike within
    error = np.zeros(4 * count)
    error[held] = np.repeat(blocks, 2)
    low, high = interval(lambda frames: error[frames].mean(), held)
    wanted = 2 * 1.96 * blocks.std() / np.sqrt(count)  # frames taken for independent would give it 1.4 times narrower
    assert high - low == pytest.approx(wanted, rel=0.1)
    assert low < blocks.mean() < high


def test_few_runs_are_drawn_frame_by_frame_and_a_seed_draws_the_same():
    one_run = np.arange(5, 15)
    low, high = interval(lambda frames: frames.mean(), one_run, seed=3)
    assert low < one_run.mean() < high
    assert interval(lambda frames: frames.mean(), one_run, seed=3) == (low, high)
