"""The scores' statistics against dense algebra."""

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
