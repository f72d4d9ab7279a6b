"""Linear-Gaussian inference: standard deviations against the scatter of many repetitions."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from sim.evidence import Normal, best_hyperparameters, in_parts, independent, jackknife, posterior, spread

PARTS, EACH = 8, 40
PRIOR = np.full(3, 100.0)


def repeated(shared: float, draws: int = 200) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Scatter of estimates over repetitions, and the mean sd by jackknife, posterior, and posterior of the data
    counted as `independent` says, each (3,).

    shared: share of the noise's variance that all data of a part have in common.
    """
    rng = np.random.default_rng(0)
    J = rng.normal(size=(PARTS, EACH, 3)) + 0.5
    means, jack, told, thinned = [], [], [], []
    for _ in range(draws):
        own, common = rng.normal(size=(PARTS, EACH)), rng.normal(size=(PARTS, 1))
        z = J @ [1.0, -2.0, 0.5] + np.sqrt(1 - shared) * own + np.sqrt(shared) * common
        parts = [Normal(A=j.T @ j, b=j.T @ y, c=float(y @ y), count=EACH) for j, y in zip(J, z, strict=True)]
        whole = Normal(A=sum(p.A for p in parts), b=sum(p.b for p in parts), c=0.0, count=PARTS * EACH)
        found = posterior(whole, PRIOR, 1.0)
        means.append(found.mean)
        told.append(np.sqrt(np.diagonal(found.covariance)))
        jack.append(jackknife(parts, PRIOR, 1.0))
        fewer = whole.thinned(independent(parts, PRIOR, 1.0, 0.1))
        thinned.append(np.sqrt(np.diagonal(posterior(fewer, PRIOR, 1.0).covariance)))
    return np.std(means, axis=0), np.mean(jack, axis=0), np.mean(told, axis=0), np.mean(thinned, axis=0)


def test_jackknife_tells_the_scatter_under_white_noise():
    scatter, jack, told, thinned = repeated(0.0)
    assert told == pytest.approx(scatter, rel=0.15)
    assert jack == pytest.approx(scatter, rel=0.15)
    assert thinned == pytest.approx(scatter, rel=0.15)


def test_jackknife_tells_the_scatter_where_errors_are_alike_within_a_part():
    """There the posterior, which takes all data for independent, is far too sure."""
    scatter, jack, told, thinned = repeated(0.5)
    assert (told < 0.75 * scatter).all()
    assert jack == pytest.approx(scatter, rel=0.25)
    assert np.linalg.norm(thinned) == pytest.approx(np.linalg.norm(scatter), rel=0.2)  # one number for all of them


def test_what_only_the_prior_holds_back_is_no_contradiction():
    """A narrow prior leaves every part the same wish, which says nothing against their independence."""
    rng = np.random.default_rng(4)
    J = rng.normal(size=(PARTS, EACH, 3))
    z = J @ [3.0, -3.0, 3.0] + rng.normal(size=(PARTS, EACH))
    parts = [Normal(A=j.T @ j, b=j.T @ y, c=float(y @ y), count=EACH) for j, y in zip(J, z, strict=True)]
    wide, narrow = (independent(parts, np.full(3, v), 1.0, 0.1) for v in (100.0, 0.01))
    assert wide < 2 and narrow < 3 * wide


def test_data_that_tell_nothing_contradict_nothing():
    nothing = [Normal(A=np.zeros((2, 2)), b=np.zeros(2), c=1.0, count=4) for _ in range(3)]
    assert independent(nothing, np.ones(2), 1.0, 1.7) == 1.7
    assert independent(nothing[:1], np.ones(2), 1.0, 1.7) == 1.7


@dataclass(frozen=True)
class Guess:
    length: float = 1.0
    amplitude: float = 0.7
    sigma: float = 1.0
    before: tuple[float, float] = (np.inf, np.inf)
    settled: bool = False


BASIS = SimpleNamespace(
    prior=lambda length, amplitude: np.full(12, amplitude**2), spacing=0.1, options=SimpleNamespace(modes=12)
)


def chosen_amplitude(spread: float, shared: float, parts: int, draws: int = 30) -> float:
    """Median amplitude after a few rounds, for coefficients of that spread that all parts see alike."""
    rng, found = np.random.default_rng(1), []
    for _ in range(draws):
        a = spread * rng.normal(size=12)
        J = rng.normal(size=(5, 60, 12))
        bias = J @ (np.sqrt(shared) * rng.normal(size=(5, 12, 1)))  # what one part alone takes for coefficients
        z = J @ a + bias[..., 0] + rng.normal(size=(5, 60))
        frames = [Normal(A=j.T @ j, b=j.T @ y, c=float(y @ y), count=60) for j, y in zip(J, z, strict=True)]
        guess = Guess()
        for _ in range(8):
            guess = best_hyperparameters(in_parts(frames, parts), BASIS, guess, None, floor=0.0)
        found.append(guess.amplitude)
    return float(np.median(found))


def test_coefficients_that_only_single_parts_want_are_kept_small():
    assert chosen_amplitude(0.0, shared=1.0, parts=5) < 0.5 * chosen_amplitude(0.0, shared=1.0, parts=1)


def test_coefficients_that_all_parts_tell_are_found():
    assert 0.2 < chosen_amplitude(0.7, shared=0.0, parts=5) < 1.1


def test_a_prior_that_two_states_choose_in_turn_settles_at_the_smoother_one():
    """As where each is linearised at what the other one's prior led to: coefficients fall off soon or late."""
    number, rng = np.arange(12), np.random.default_rng(0)

    def prior(length, amplitude):
        return amplitude**2 * np.maximum(np.exp(-((number * length) ** 2)), 1e-9)

    basis = SimpleNamespace(prior=prior, spacing=0.01, options=SimpleNamespace(modes=12))
    J, a, guess, seen = rng.normal(size=(5, 60, 12)), rng.normal(size=12), Guess(length=0.3), []
    for n in range(12):
        z = J @ (a * np.sqrt(prior((0.1, 0.3)[n % 2], 0.7))) + 0.5 * rng.normal(size=(5, 60))
        frames = [Normal(A=j.T @ j, b=j.T @ y, c=float(y @ y), count=60) for j, y in zip(J, z, strict=True)]
        wild = best_hyperparameters(in_parts(frames, 5), basis, replace(guess, settled=False, before=(0, 0)), None, 0.0)
        guess = best_hyperparameters(in_parts(frames, 5), basis, guess, None, floor=0.0)
        seen.append((guess.length, wild.length))
    kept, chosen = (np.array(one[2:]) for one in zip(*seen, strict=True))
    assert guess.settled and len(set(kept)) == 1
    assert (chosen[::2] < 0.9 * kept[0]).all() and (chosen[1::2] > 0.99 * kept[0]).all()  # what it would go on to


def test_priors_count_by_how_well_they_predict_parts_left_out():
    """One coefficient seen once in every part, under a prior that holds it at zero or none at all."""
    z = np.array([1.0, -0.4, 0.8, 0.3])
    parts = [Normal(A=np.eye(1), b=np.array([v]), c=v**2, count=1) for v in z]
    free = np.array([(v - np.delete(z, i).mean()) ** 2 for i, v in enumerate(z)])
    worse = z**2 - free if free.sum() < (z**2).sum() else free - z**2
    less = np.exp(-worse.sum() / (2 * worse.std(ddof=1)))
    held, told = (1.0, less) if free.sum() > (z**2).sum() else (less, 1.0)
    priors, row = [np.full(1, 1e-9), np.full(1, 1e9)], np.ones((1, 1))
    expected = told * (1 / 4 + z.mean() ** 2) / (held + told)
    assert spread(parts, priors, 1.0, row)[0][0] ** 2 == pytest.approx(expected, rel=1e-6)
    about_free = (held * z.mean() ** 2 + told / 4) / (held + told)
    assert spread(parts, priors[::-1], 1.0, row)[0][0] ** 2 == pytest.approx(about_free, rel=1e-6)
    assert spread(parts, priors[1:], 1.0, row)[0][0] ** 2 == pytest.approx(1 / 4)  # nothing to choose from
    assert spread(parts[:1], priors[::-1], 1.0, row)[0][0] ** 2 == pytest.approx(1)  # nothing to leave out


def test_intervals_hold_the_truth_where_the_first_prior_is_too_stiff():
    rng, held = np.random.default_rng(4), []
    priors = [np.full(12, amplitude**2) for amplitude in (0.1, 0.35, 0.7, 1.4)]
    for _ in range(60):
        a, J = 0.7 * rng.normal(size=12), rng.normal(size=(5, 8, 12))
        z = J @ a + 2 * rng.normal(size=(5, 8))
        parts = [Normal(A=j.T @ j, b=j.T @ y, c=float(y @ y), count=8) for j, y in zip(J, z, strict=True)]
        off = np.abs(posterior(Normal.sum(parts), priors[0], 2.0).mean - a)
        held.append([off < 1.96 * spread(parts, some, 2.0, np.eye(12))[0] for some in (priors[:1], priors)])
    stiff, mixed = np.mean(held, axis=(0, 2))
    assert stiff < 0.5 < 0.85 < mixed < 0.99


def test_directions_that_data_may_be_off_by_widen_what_they_do_to_the_coefficients():
    """Against the errors of the same estimate over many draws of coefficients, noise and how far the data are off."""
    rng, prior = np.random.default_rng(5), np.full(4, 0.5)
    J, D, rows = rng.normal(size=(30, 4)), 0.6 * rng.normal(size=(30, 2)), rng.normal(size=(3, 4))
    off = []
    for _ in range(4000):
        a, e = np.sqrt(prior) * rng.normal(size=4), rng.normal(size=2)
        z = J @ a + D @ e + 0.7 * rng.normal(size=30)
        off.append(rows @ (posterior(Normal(A=J.T @ J, b=J.T @ z, c=float(z @ z), count=30), prior, 0.7).mean - a))
    part = Normal(A=J.T @ J, b=J.T @ z, c=float(z @ z), count=30)
    assert np.hypot(*spread([part], [prior], 0.7, rows, J.T @ D)) == pytest.approx(np.std(off, axis=0), rel=0.05)
    assert (spread([part], [prior], 0.7, rows)[0] < 0.9 * np.std(off, axis=0)).all()


def test_parts_hold_all_frames_and_know_about_equally_much():
    rng = np.random.default_rng(2)
    J = [rng.normal(size=(20, 3)) * (0.0 if k < 4 else 1.0) for k in range(24)]
    frames = [Normal(A=j.T @ j, b=j.T @ np.ones(20), c=20.0, count=20) for j in J]
    parts = in_parts(frames, 5)
    whole = Normal.sum(parts)
    np.testing.assert_allclose(whole.A, sum(f.A for f in frames))
    assert whole.count == 480 and len(parts) == 5
    known = np.array([np.trace(part.A) for part in parts])
    assert known.max() < 2 * known.min()


def test_rounding_of_large_curvatures_leaves_a_posterior():
    """Columns in single precision can make `J^T J` indefinite by as much as its rounding."""
    rng = np.random.default_rng(3)
    J = rng.normal(size=(40, 3)) @ rng.normal(size=(3, 6))
    A, truth = J.T @ J, rng.normal(size=6)
    rounded = A - 1e-7 * np.abs(A).max() * np.eye(6)
    found, exact = (posterior(Normal(A=M, b=A @ truth, c=0.0, count=40), np.ones(6), 1e-5) for M in (rounded, A))
    assert np.linalg.eigvalsh(np.eye(6) + rounded / 1e-10).min() < 0
    assert np.linalg.norm(J @ (found.mean - exact.mean)) < 0.01 * np.linalg.norm(J @ exact.mean)
    assert (np.linalg.eigvalsh(found.covariance) > 0).all()
