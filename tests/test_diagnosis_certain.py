"""Whether a cause may be absent, by its own parameters."""

from types import SimpleNamespace

import numpy as np
import pytest
from test_diagnosis_verdict import Fitted

from veo_ti.diagnosis.fitted import Refit


@pytest.mark.parametrize(
    ("theta", "nats", "certain"),
    [
        ((3.0, 0.1), 0.0, True),
        ((-1.9, 1.0), 0.0, False),
        ((-2.0, 0.0), 0.0, True),
        ((1.0, 0.0), 40.0, False),  # worth 50
        ((1.0, 0.0), 150.0, False),  # a deviation counts for the root of three
        ((1.0, 0.0), 250.0, True),  # of five: seed 2934, an obstacle that is certain, however stiff it is
    ],
)
def test_a_cause_is_certain_where_one_parameter_is_two_deviations_from_nothing(theta, nats, certain):
    """Of two causes the second one's own parameters count; the data leave a tenth of what frames leave."""
    covariance = 1e-2 * np.eye(2)
    last = Fitted(cause=None, theta=np.array(theta), sd=np.ones(2), covariance=covariance)
    first = Fitted(cause=None, theta=np.full(1, 9.0), sd=np.ones(1), covariance=np.eye(1))
    for parts in ((last,), (first, last)):
        assert Refit.certain(SimpleNamespace(apart=lambda parts=parts: parts), nats) == certain


@pytest.mark.parametrize(("frames", "certain"), [(1.0, True), (30.0, False)])
def test_parameters_that_hide_each_other_may_be_certain_together(frames, certain):
    """Fifty deviations from nothing along one way, half of one across it: each alone may be zero. frames: times the
    posterior's deviations, that leaving out runs of frames shows."""
    turn = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2)
    covariance = turn @ np.diag([1e-4, 1.0]) @ turn.T
    theta = turn @ np.array([0.5, 0.5])
    own = Fitted(cause=None, theta=theta, sd=frames * np.sqrt(np.diagonal(covariance)), covariance=covariance)
    assert (np.abs(theta) < 1.96 * own.spread).all()
    assert Refit.certain(SimpleNamespace(apart=lambda: (own,))) == certain
