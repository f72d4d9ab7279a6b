"""The scores' statistics against dense algebra."""

from types import SimpleNamespace

import numpy as np
import pytest

from sim.evidence import Normal
from veo_ti.diagnosis.moments import Fingerprints, Moments
from veo_ti.diagnosis.score import Statistics


def test_statistics_are_those_of_the_dense_covariance():
    """Against Sigma = s2 I + J P J^T formed whole, from random columns."""
    random = np.random.default_rng(0)
    X, z = random.normal(size=(7, 40)), random.normal(size=40)
    found = Moments(
        normal=Normal(A=X @ X.T, b=X @ z, c=float(z @ z), count=40),
        nuisances=3,
        modes=2,
        kept=Fingerprints(frames=np.zeros(0, int), columns=()),
    )
    prior = np.array([0.5, 2.0, 1.0])
    statistics = Statistics(moments=found, s2=0.3, prior=prior)
    Sigma = 0.3 * np.eye(40) + X[:3].T @ (prior[:, None] * X[:3])
    S = X[3:5]
    assert statistics.inner(np.array([3, 4]), np.array([3, 4])) == pytest.approx(S @ np.linalg.solve(Sigma, S.T))
    assert statistics.against(np.array([3, 4])) == pytest.approx(S @ np.linalg.solve(Sigma, z))


@pytest.mark.parametrize("unit", [1.0, 1e-9])
def test_likeness_is_the_share_that_another_can_do_beside_the_nuisances(unit):
    """Against least squares with whitened columns, in whatever unit the other one counts."""
    random = np.random.default_rng(1)
    X, z = random.normal(size=(7, 40)), random.normal(size=40)
    X[5] = 0.7 * X[3] - 0.4 * X[4] + 0.1 * X[5]
    X[5:] *= np.array([[1.0], [unit]])
    normal = Normal(A=X @ X.T, b=X @ z, c=float(z @ z), count=40)
    kept = Fingerprints(frames=np.zeros(0, int), columns=())
    statistics = Statistics(
        moments=Moments(normal=normal, nuisances=3, modes=0, kept=kept), s2=0.3, prior=np.array([0.5, 2.0, 1.0])
    )
    one = SimpleNamespace(columns=np.array([3, 4]), theta=np.array([1.0, -0.5]))
    other = SimpleNamespace(columns=np.array([5, 6]))
    Sigma = 0.3 * np.eye(40) + X[:3].T @ (statistics.prior[:, None] * X[:3])
    white = np.linalg.inv(np.linalg.cholesky(Sigma))
    done, can = white @ X[3:5].T @ one.theta, white @ (X[5:] / np.linalg.norm(X[5:], axis=1)[:, None]).T
    left = done - can @ np.linalg.lstsq(can, done, rcond=None)[0]
    assert statistics.likeness(one, other) == pytest.approx(1 - (left @ left) / (done @ done), abs=1e-9)
    assert 0.3 < statistics.likeness(one, other) < 0.999
    assert statistics.likeness(one, one) == pytest.approx(1.0)
