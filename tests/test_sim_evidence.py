"""Linear-Gaussian inference: standard deviations against the scatter of many repetitions."""

import numpy as np
import pytest

from sim.evidence import Normal, jackknife, posterior

PARTS, EACH = 8, 40
PRIOR = np.full(3, 100.0)


def repeated(shared: float, draws: int = 200) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Estimates (R, 3) over repetitions, and the mean sd of jackknife and posterior, each (3,).

    shared: share of the noise's variance that all data of a part have in common.
    """
    rng = np.random.default_rng(0)
    J = rng.normal(size=(PARTS, EACH, 3)) + 0.5
    means, jack, told = [], [], []
    for _ in range(draws):
        own, common = rng.normal(size=(PARTS, EACH)), rng.normal(size=(PARTS, 1))
        z = J @ [1.0, -2.0, 0.5] + np.sqrt(1 - shared) * own + np.sqrt(shared) * common
        parts = [Normal(A=j.T @ j, b=j.T @ y, c=float(y @ y), count=EACH) for j, y in zip(J, z, strict=True)]
        whole = Normal(A=sum(p.A for p in parts), b=sum(p.b for p in parts), c=0.0, count=PARTS * EACH)
        found = posterior(whole, PRIOR, 1.0)
        means.append(found.mean)
        told.append(np.sqrt(np.diagonal(found.covariance)))
        jack.append(jackknife(parts, PRIOR, 1.0))
    return np.std(means, axis=0), np.mean(jack, axis=0), np.mean(told, axis=0)


def test_jackknife_tells_the_scatter_under_white_noise():
    scatter, jack, told = repeated(0.0)
    assert told == pytest.approx(scatter, rel=0.15)
    assert jack == pytest.approx(scatter, rel=0.15)


def test_jackknife_tells_the_scatter_where_errors_are_alike_within_a_part():
    """There the posterior, which takes all data for independent, is far too sure."""
    scatter, jack, told = repeated(0.5)
    assert (told < 0.75 * scatter).all()
    assert jack == pytest.approx(scatter, rel=0.25)
