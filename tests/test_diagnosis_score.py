"""The scores' statistics against dense algebra."""

from dataclasses import replace
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


@pytest.fixture(params=[1.0, 1e-9])
def mixed(request) -> tuple[Statistics, np.ndarray]:
    """Statistics of columns 3 and 4, and of 5 and 6 in another unit, which can do some of that; whitened columns."""
    random = np.random.default_rng(1)
    X, z = random.normal(size=(7, 40)), random.normal(size=40)
    X[5] = 0.7 * X[3] - 0.4 * X[4] + 0.1 * X[5]
    X[5:] *= np.array([[1.0], [request.param]])
    normal = Normal(A=X @ X.T, b=X @ z, c=float(z @ z), count=40)
    kept = Fingerprints(frames=np.zeros(0, int), columns=())
    statistics = Statistics(
        moments=Moments(normal=normal, nuisances=3, modes=0, kept=kept), s2=0.3, prior=np.array([0.5, 2.0, 1.0])
    )
    Sigma = 0.3 * np.eye(40) + X[:3].T @ (statistics.prior[:, None] * X[:3])
    return statistics, np.linalg.inv(np.linalg.cholesky(Sigma)) @ X.T


def missed(done: np.ndarray, can: np.ndarray) -> np.ndarray:
    """The share of columns `done`, squared, that least squares with columns `can` leave."""
    can = can / np.linalg.norm(can, axis=0)
    left = done - can @ np.linalg.lstsq(can, done, rcond=None)[0]
    return (left**2).sum(axis=0) / (done**2).sum(axis=0)


def test_likeness_is_the_share_that_another_can_do_beside_the_nuisances(mixed):
    """Against least squares with whitened columns, in whatever unit the other one counts."""
    statistics, white = mixed
    one = SimpleNamespace(columns=np.array([3, 4]), theta=np.array([1.0, -0.5]))
    other = SimpleNamespace(columns=np.array([5, 6]))
    left = float(missed(white[:, 3:5] @ one.theta[:, None], white[:, 5:])[0])
    assert statistics.likeness(one, other) == pytest.approx(1 - left, abs=1e-9)
    assert 0.3 < statistics.likeness(one, other) < 0.999
    assert statistics.likeness(one, one) == pytest.approx(1.0)


def test_a_cause_is_unlike_another_by_what_that_leaves_of_it_in_all_directions(mixed):
    """One place whose directions are drawn, against as many drawn here; one of the same columns; and one parameter."""
    statistics, white = mixed
    widths, own = np.array([2.0, 0.5]), np.array([5, 6])
    sines = statistics.unlike(own, np.array([[3, 4], [5, 6]]), widths)
    ways = widths[:, None] * np.random.default_rng(7).normal(size=(2, 4000))
    expected = np.sqrt(missed(white[:, 3:5] @ ways, white[:, 5:]))
    assert sines[0].mean() == pytest.approx(expected.mean(), rel=0.1)
    assert sines[0].std() == pytest.approx(expected.std(), rel=0.25)
    assert sines[1] == pytest.approx(0.0, abs=1e-5)
    alone = statistics.unlike(own, np.array([[3]]), np.array([1.0]))
    assert alone == pytest.approx(np.sqrt(missed(white[:, 3:4], white[:, 5:])[0]))


def test_two_together_take_what_both_most_probably_do_at_once():
    """Against least squares under the prior on dense columns, and what that leaves in modes that see all."""
    random = np.random.default_rng(2)
    columns, modes = random.normal(size=(4, 40)), random.normal(size=(60, 40))
    z = columns.T @ np.array([0.3, 2.0, -1.0, 4.0]) + 0.1 * random.normal(size=40)
    X = np.concatenate([columns, modes])
    normal = Normal(A=X @ X.T, b=X @ z, c=float(z @ z), count=40)
    kept = Fingerprints(frames=np.zeros(0, int), columns=())
    s2, prior, widths = 0.5, np.array([2.0]), np.array([1.0, 1.0, 3.0])
    statistics = Statistics(moments=Moments(normal=normal, nuisances=1, modes=60, kept=kept), s2=s2, prior=prior)
    precision = columns @ columns.T / s2 + np.diag(1 / np.append(prior, widths**2))
    theta = np.linalg.solve(precision, columns @ z / s2)[1:]

    def excess(left: np.ndarray) -> float:
        taken = np.linalg.inv(0.01 * np.eye(40) + prior * np.outer(columns[0], columns[0]))
        u, C = modes @ taken @ left, modes @ taken @ modes.T
        return u @ u - np.trace(C)

    one = SimpleNamespace(columns=np.array([1, 2]), widths=widths[:2])
    other = SimpleNamespace(columns=np.array([3]), widths=widths[2:])
    expected = 1 - excess(z - columns[1:].T @ theta) / excess(z)
    assert statistics.together(one, other, replace(statistics, s2=0.01)) == pytest.approx(expected)
    assert 0.5 < expected < 1
