"""Penalised least squares of a hypothesis on the takes, with evidence that counts correlated residuals once."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from veo_ti.beam_dynamics.hypotheses import Hypothesis, Setup
from veo_ti.beam_dynamics.ritz import Physics, Ritz, Start
from veo_ti.beam_dynamics.takes import PLANE, Release

FREE = 0.1  # [s] after the release: until then the hand that held the beam is still in the motion
SWEEPS = 3  # of the residual's size and the parameters in turn
FINEST = 1e-7  # [m] size of residuals below which nothing is told apart
SLOW, HEAVY = 0.3, 0.03  # [s], [kg]


@dataclass(frozen=True, kw_only=True, eq=False)
class Data:
    """Takes with the beam's shapes about each settled pose, and what the shapes alone get wrong in each.

    defect: take -> (T, 3, 3) [m], the full simulation minus the one on shapes, at nearby parameters.
    """

    releases: tuple[Release, ...]
    ritz: Mapping[str, Ritz]  # by take
    defect: Mapping[str, np.ndarray]

    def predicted(self, setup: Setup, theta: np.ndarray) -> list[np.ndarray]:
        """Marker displacements from where they settled, take by take, (T, 3, 3) [m]."""
        return [self.one(setup.physics(theta, r), setup.start(theta, i), r) for i, r in enumerate(setup.releases)]

    def one(self, physics: Physics, start: Start, release: Release) -> np.ndarray:
        """The same of one take."""
        shapes = self.ritz[release.name].markers(physics, start, release.time)
        return shapes + start.reach * self.defect.get(release.name, 0.0) if physics.inertia else shapes


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A hypothesis at its most probable parameters."""

    setup: Setup
    theta: np.ndarray  # in the fit's coordinates
    residuals: tuple[np.ndarray, ...]  # measured minus predicted, take by take (T, 3, 3) [m]
    slopes: np.ndarray  # (n, P) d predicted / d theta, of what was fitted
    sigma: float  # [m] root mean square of what was fitted
    effective: float  # independent residuals it was fitted with

    @property
    def hypothesis(self) -> Hypothesis:
        """What was fitted."""
        return self.setup.hypothesis

    def evidence(self, effective: float) -> float:
        """Log evidence for `effective` independent residuals of unknown size, up to a constant.

        `-n/2 log sigma^2 - |theta|_P^2 / 2 - log|I + J P^-1 J^T / s^2| / 2`, s the size of one of all the residuals
        that would say as much as the independent ones.
        """
        unknowns = self.setup.unknowns
        width = np.array([u.width for u in unknowns])
        off = (self.theta - [u.mean for u in unknowns]) / width
        J = self.slopes * width * np.sqrt(effective / len(self.slopes)) / self.sigma
        volume = np.linalg.slogdet(np.eye(len(width)) + J.T @ J)[1]
        return float(-effective * np.log(self.sigma) - 0.5 * off @ off - 0.5 * volume)

    def covariance(self, effective: float) -> np.ndarray:
        """Of theta, (P, P)."""
        J = self.slopes * np.sqrt(effective / len(self.slopes)) / self.sigma
        return np.linalg.inv(J.T @ J + np.diag([u.width**-2 for u in self.setup.unknowns]))

    def bounds(self, name: str) -> tuple[float, float, float] | None:
        """A parameter and its 95 % interval; None where the fit has none of that name."""
        at = next((i for i, u in enumerate(self.setup.unknowns) if u.name == name), None)
        if at is None:
            return None
        u, middle = self.setup.unknowns[at], float(self.theta[at])
        reach = 1.96 * float(np.sqrt(self.covariance(self.effective)[at, at]))
        return u.value(middle), u.value(middle - reach), u.value(middle + reach)

    def values(self) -> dict[str, float]:
        """The shared parameters by name."""
        return self.setup.values(self.theta)


def fit(hypothesis: Hypothesis, data: Data, *, effective: float) -> Fit:
    """The most probable parameters, `effective` of all residuals being independent.

    From the priors' centres; without inertia also from slow times, because a fast approach is over before the first
    frame that is fitted and has no slope there; where no hung mass is told, also from fittings that do its work.
    """
    setup = Setup(hypothesis=hypothesis, releases=data.releases)
    unknowns = setup.unknowns
    mean, width = np.array([u.mean for u in unknowns]), np.array([u.width for u in unknowns])
    measured = _flat([r.w for r in data.releases], data)
    share = np.sqrt(effective / len(measured))

    def shown(theta: np.ndarray) -> np.ndarray:
        return _flat(data.predicted(setup, theta), data)

    def off(theta: np.ndarray) -> float:
        return max(float(np.sqrt(np.mean((measured - shown(theta)) ** 2))), FINEST)

    def closer(theta: np.ndarray, sigma: float) -> np.ndarray:
        found = least_squares(
            lambda z: np.concatenate([share / sigma * (measured - shown(mean + width * z)), z]),
            (theta - mean) / width, method="trf", bounds=(-6.0, 6.0), max_nfev=60, xtol=1e-5, ftol=1e-6, gtol=1e-6,
        )  # fmt: skip
        return mean + width * found.x

    second = {"s": SLOW} if not hypothesis.inertia else {"kg": HEAVY} if hypothesis.weight == "force" else {}
    other = np.array([u.coordinate(second[u.unit]) if u.unit in second and u.positive else u.mean for u in unknowns])
    starts = [mean] if (other == mean).all() else [mean, other]
    theta = min((closer(t, off(t)) for t in starts), key=off)
    for _ in range(SWEEPS - 1):
        theta = closer(theta, off(theta))
    residuals = tuple(r.w - w for r, w in zip(data.releases, data.predicted(setup, theta), strict=True))
    return Fit(
        setup=setup, theta=theta, residuals=residuals, slopes=_slopes(shown, theta, width), sigma=off(theta),
        effective=effective,
    )  # fmt: skip


def _flat(each: Sequence[np.ndarray], data: Data) -> np.ndarray:
    """What is fitted of displacements of every take, in one row."""
    return np.concatenate([seen(fitted_part(w, r)) for w, r in zip(each, data.releases, strict=True)])


def _slopes(shown: Callable[[np.ndarray], np.ndarray], theta: np.ndarray, width: np.ndarray) -> np.ndarray:
    steps = 1e-3 * width
    return np.stack([
        (shown(theta + h * e) - shown(theta - h * e)) / (2 * h) for h, e in zip(steps, np.eye(len(theta)), strict=True)
    ], axis=1)  # fmt: skip


def seen(w: np.ndarray) -> np.ndarray:
    """What is fitted of displacements (T, M, 3): the plane of the loads, flat."""
    return w[:, :, PLANE].reshape(-1)


def fitted_part(w: np.ndarray, release: Release) -> np.ndarray:
    """The frames (T', M, 3) that fits look at."""
    return w[release.time >= FREE]


def effective_count(residuals: Sequence[np.ndarray]) -> float:
    """How many independent numbers have as well-known a variance as these residuals (T, M, 3).

    Of a series, T / sum_k rho_k^2 over all lags (Bayley and Hammersley 1946), which counts a lasting oscillation as
    little; of channels that move together, (sum of the eigenvalues of their covariance)^2 / sum of their squares.
    """
    return float(sum(_effective(r[:, :, PLANE].reshape(len(r), -1)) for r in residuals))


def _effective(r: np.ndarray) -> float:
    T = len(r)
    size = np.linalg.eigvalsh(r.T @ r)
    channels = float(size.sum() ** 2 / max((size**2).sum(), 1e-300))
    wave = np.fft.rfft(r, n=2 * T, axis=0)
    rho = np.fft.irfft((np.abs(wave) ** 2).sum(axis=1), n=2 * T)[:T]
    rho = rho / max(rho[0], 1e-300)
    chance = (1 - 1 / T) / channels  # what the squares below sum to for white residuals
    return T / (1 + max(0.0, 2 * float((rho[1:] ** 2).sum()) - chance)) * channels
