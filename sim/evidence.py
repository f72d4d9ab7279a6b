"""Linear-Gaussian inference on accumulated normal equations: posterior, evidence, and the prior's own parameters."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve

_Choice = tuple[float, float, float]  # length, amplitude, noise
_SWEEPS = 10
_WIDE = 1e4  # times a prior's variance: as good as none
_STEPS = np.array([0.67, 1.0, 1.5])  # times the prior's length or amplitude, one of which is next
_SAME = 1.2  # times, up to which two of them are the same


@dataclass(frozen=True, kw_only=True, eq=False)
class Normal:
    """z = J a + noise in accumulated form: A = J^T J (K, K), b = J^T z (K,), c = z^T z, and the number of data."""

    A: np.ndarray
    b: np.ndarray
    c: float
    count: float

    @classmethod
    def sum(cls, parts: Sequence["Normal"]) -> "Normal":
        """All the parts together."""
        return cls(A=sum(p.A for p in parts), b=sum(p.b for p in parts), c=sum(p.c for p in parts),
                   count=sum(p.count for p in parts))  # fmt: skip

    def thinned(self, factor: float) -> "Normal":
        """The same data counted as 1/factor as many: correlated residuals say less than their number."""
        return Normal(A=self.A / factor, b=self.b / factor, c=self.c / factor, count=self.count / factor)


@dataclass(frozen=True, kw_only=True, eq=False)
class Posterior:
    """Mean (K,), covariance (K, K) of the coefficients, and the log evidence of the data."""

    mean: np.ndarray
    covariance: np.ndarray
    evidence: float


def posterior(normal: Normal, prior: np.ndarray, sigma: float) -> Posterior:
    """a | z for a ~ N(0, diag prior) and noise sigma.

    `log p(z) = -(n log sigma^2 + log|I + G^1/2 A G^1/2 / sigma^2| + (c - b^T mean) / sigma^2) / 2` up to a constant.
    """
    root = np.sqrt(prior)
    inverse, logdet = _inverted(np.eye(len(root)) + root[:, None] * normal.A * root / sigma**2)
    covariance = root[:, None] * inverse * root
    mean = covariance @ normal.b / sigma**2
    misfit = (normal.c - normal.b @ mean) / sigma**2
    evidence = -0.5 * (normal.count * np.log(sigma**2) + logdet + misfit)
    return Posterior(mean=mean, covariance=covariance, evidence=float(evidence))


def _inverted(M: np.ndarray) -> tuple[np.ndarray, float]:
    """M^-1 and log|M| of an M whose eigenvalues are at least one, but for the rounding of large ones."""
    try:
        factor = cho_factor(M)
    except np.linalg.LinAlgError:
        w, V = np.linalg.eigh(M)
        w = np.maximum(w, 1.0)
        return (V / w) @ V.T, float(np.log(w).sum())
    return cho_solve(factor, np.eye(len(M))), float(2 * np.log(np.diagonal(factor[0])).sum())


def left_out(parts: Sequence[Normal], prior: np.ndarray, sigma: float) -> np.ndarray:
    """Squared error (B,) of each part of the data under coefficients that the other parts chose."""
    means = _means_without_each(parts, prior, sigma)
    return np.array([p.c - 2 * m @ p.b + m @ p.A @ m for p, m in zip(parts, means, strict=True)])


def jackknife(parts: Sequence[Normal], prior: np.ndarray, sigma: float) -> np.ndarray:
    """Standard deviations (K,) of the coefficients, from leaving out one part of the data after the other.

    `sd^2 = (B - 1)/B sum_b (mean_b - average)^2` (Tukey 1958). Unlike the posterior's they grow where parts contradict
    one another, as they do when the model is wrong or errors are alike within a part.
    """
    return np.sqrt((len(parts) - 1) * _means_without_each(parts, prior, sigma).var(axis=0))


def _means_without_each(parts: Sequence[Normal], prior: np.ndarray, sigma: float) -> np.ndarray:
    """Posterior means (B, K) under all parts but one, each left out in turn."""
    whole = Normal.sum(parts)
    rests = (Normal(A=whole.A - p.A, b=whole.b - p.b, c=0.0, count=0.0) for p in parts)
    return np.array([posterior(rest, prior, sigma).mean for rest in rests])


def spread(
    parts: Sequence[Normal], priors: Sequence[np.ndarray], sigma: float, rows: np.ndarray,
    wrong: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Standard deviation (N,) of rows r (N, K) of the coefficients, about their mean under the first of several priors.

    `sd^2 = sum_k w_k (r C_k r^T + (r (mean_k - mean_0))^2) / sum_k w_k`: which prior holds is not known either. One
    that predicts parts left out worse than the best does, by n standard errors of the difference over the parts, has
    `w = exp(-n)`. Why the evidence does not weigh them: see `_smoothest`. And what comes on top, the root of
    `sum_k w_k |r C_k W|^2 / sigma^4 / sum_k w_k`, with wrong: W = J^T D (K, L) for directions D that the data may be
    off by, one standard deviation each, and that were not looked for.
    """
    whole, wrong = Normal.sum(parts), np.zeros((rows.shape[1], 0)) if wrong is None else wrong / sigma**2
    found = [posterior(whole, prior, sigma) for prior in priors]
    seen = [rows @ p.covariance for p in found]
    variance, moved = np.array([((s * rows).sum(axis=1), ((s @ wrong) ** 2).sum(axis=1)) for s in seen]).swapaxes(0, 1)
    if len(parts) < 2:
        return np.sqrt(variance[0]), np.sqrt(moved[0])
    errors = np.array([left_out(parts, prior, sigma) for prior in priors])
    worse, doubt = _worse(errors, int(errors.sum(axis=1).argmin()))
    weights = np.exp(-worse / np.maximum(doubt, 1e-300))
    apart = np.array([rows @ (p.mean - found[0].mean) for p in found])
    return np.sqrt(weights @ (variance + apart**2) / weights.sum()), np.sqrt(weights @ moved / weights.sum())


def independent(parts: Sequence[Normal], prior: np.ndarray, sigma: float, least: float) -> float:
    """How many residuals make one independent one, at least `least`, from how far parts of the data pull apart.

    `f = sigma^2 sum_b g_b^T C g_b / sum_b tr(C (A_b - A_b A^-1 A_b))`, with the pulls g_b = (b_b - A_b a) / sigma^2 of
    the parts on what they would choose together without a prior, and C the posterior's covariance where the data count
    as 1/f as many. Independent residuals give 1 (the cluster-robust variance of Liang and Zeger 1986, as one number);
    errors alike in neighbouring points and frames, or a wrong model, let each part pull its own way.
    """
    if len(parts) < 2:
        return least
    whole, factor = Normal.sum(parts), least
    free = posterior(whole, _WIDE * prior, sigma)
    pulls = np.array([n.b - n.A @ free.mean for n in parts]) / sigma
    apart = sum(n.A - n.A @ free.covariance @ n.A / sigma**2 for n in parts)
    for _ in range(_SWEEPS):
        C = posterior(whole.thinned(factor), prior, sigma).covariance
        expected = max(float((C * apart).sum()), 1e-300)
        factor = max(least, np.sqrt(factor * np.einsum("bk,kl,bl", pulls, C, pulls) / expected))
    return float(factor)


def noise_level(normal: Normal, prior: np.ndarray, sigma: float, steps: int = 8) -> float:
    """The noise that maximises the evidence: residual energy over the degrees of freedom that the fit leaves."""
    for _ in range(steps):
        p = posterior(normal, prior, sigma)
        misfit = normal.c - 2 * normal.b @ p.mean + p.mean @ normal.A @ p.mean
        used = float((p.covariance * normal.A).sum()) / sigma**2
        sigma = float(np.sqrt(max(misfit, 1e-300) / max(normal.count - used, 1.0)))
    return sigma


def best_hyperparameters(parts: Sequence[Normal], basis: Any, state: Any, sigma: float | None, floor: float) -> Any:
    """The state with the noise (where sigma is None) and the prior's length and amplitude for data in parts.

    Searched among the neighbours of the present values on a logarithmic grid, so that they move gently: those of
    highest evidence, then the smoothest that predicts parts left out as well (`_smoothest`). The amplitude of log mu
    stays below 1.5: a wrong model would else buy its fit with wild moduli. While the noise is below `floor`, the
    linearisation is too far from the data to choose a prior by: only the noise is set, to the floor. A choice that
    leads back to where the prior was two choices ago would do so for ever: of these two the smoother one is kept.
    """
    normal = Normal.sum(parts)

    def noise(length: float, amplitude: float) -> float:
        return sigma or noise_level(normal, basis.prior(length, amplitude), state.sigma)

    present = noise(state.length, state.amplitude)
    if present < floor or not basis.options.modes or state.settled:
        return replace(state, sigma=max(present, floor))
    shortest = 2 * basis.spacing
    near = [(max(state.length * i, shortest), min(state.amplitude * j, 1.5)) for i in _STEPS for j in _STEPS]
    choices = [(*c, noise(*c)) for c in near]
    scores = [posterior(normal, basis.prior(*c), s).evidence for *c, s in choices]
    chosen = _smoothest(parts, basis, choices, choices[int(np.argmax(scores))])
    now = state.length, state.amplitude, present
    back = _same(chosen, state.before) and not _same(chosen, now)
    length, amplitude, level = min(now, chosen, key=_smoothness) if back else chosen
    return replace(state, length=length, amplitude=amplitude, sigma=level, before=now[:2], settled=back)


def _same(one: Sequence[float], other: Sequence[float]) -> bool:
    return all(max(a, b) < _SAME * min(a, b) for a, b in zip(one[:2], other[:2], strict=True))


def _smoothness(choice: _Choice) -> tuple[float, float]:
    """By which choices are ordered, the smoothest first."""
    return choice[1], -choice[0]


def _smoothest(parts: Sequence[Normal], basis: Any, choices: Sequence[_Choice], best: _Choice) -> _Choice:
    """The choice of least amplitude, and of those the longest, that predicts parts left out like the best does.

    That is, within one standard error of the difference over the parts (Breiman et al. 1984). The evidence takes
    residuals for independent; errors that are alike in neighbouring points and frames, as those of a reconstruction
    are, would by it look like stiffness that varies.
    """
    if len(parts) < 2:
        return best
    plainer = [c for c in choices if c[0] >= best[0] and c[1] <= best[1]]
    errors = np.array([left_out(parts, basis.prior(*c), s) for *c, s in plainer])
    worse, doubt = _worse(errors, plainer.index(best))
    return min((c for c, well in zip(plainer, worse <= doubt, strict=True) if well), key=_smoothness)


def _worse(errors: np.ndarray, best: int) -> tuple[np.ndarray, np.ndarray]:
    """By how much more than `best` each of several choices errs (K,), and the standard error of that over the parts
    that were left out; errors (K, B)."""
    worse = errors - errors[best]
    return worse.sum(axis=1), np.sqrt(errors.shape[1]) * worse.std(axis=1, ddof=1)


def in_parts(frames: Sequence[Normal], most: int) -> list[Normal]:
    """Neighbouring frames together, in at most so many parts that know about equally much."""
    known = np.cumsum([np.trace(frame.A) for frame in frames])
    part = np.minimum((most * known / max(known[-1], 1e-300)).astype(int), most - 1)
    groups = ([f for f, n in zip(frames, part, strict=True) if n == k] for k in range(most))
    return [Normal.sum(group) for group in groups if group]


def design_effect(residual: np.ndarray, seen: np.ndarray, modes: np.ndarray) -> float:
    """How many correlated residuals make one independent one (Kish's design effect), at least 1.

    The energy of the residual (T, N, 3) in smooth modes (N, K) over what white residuals of the same size would have.
    Discretisation error and tracking drift are smooth; taken for white noise, they would be fitted by the material.
    """
    total = (residual**2).sum() / max(3 * int(seen.sum()), 1)
    projected = np.einsum("nk,tnc->tkc", modes, residual)
    expected = total * np.einsum("nk,tn->tk", modes**2, seen.astype(float))
    return float(max(1.0, (projected**2).sum() / (3 * max(expected.sum(), 1e-300))))
