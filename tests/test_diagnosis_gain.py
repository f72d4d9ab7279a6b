"""What knowing a cause gains."""

import numpy as np
import pytest

from sim.target import Target
from veo_ti.diagnosis.gain import measure_gain


def test_gain_is_judged_on_held_out_frames_only():
    random = np.random.default_rng(0)
    truth = np.zeros((24, 30, 3))
    target = Target(y=truth + 0.1 * random.normal(size=truth.shape), seen=np.ones((24, 30), bool))
    train = np.arange(24) % 8 < 5
    off = np.where(train[:, None, None], 5.0, 0.3) * np.ones_like(truth)
    models = {"before": truth + off, "after": truth, "homogeneous": truth + 2 * off, "no_change": truth + off}
    gain = measure_gain(target, train, models, 0.1)
    assert gain.before_mm == pytest.approx(1e3 * np.hypot(0.3, 0.1), rel=0.05)
    assert gain.after_mm == pytest.approx(100, rel=0.05)
    low, high = gain.gained_mm[1:]
    assert low <= gain.gained_mm[0] <= high and gain.confirmed
    same = measure_gain(target, train, models | {"after": truth + off}, 0.1)
    assert same.gained_mm == (0.0, 0.0, 0.0) and not same.confirmed
    assert measure_gain(target, np.ones(24, bool), models, 0.1) is None
