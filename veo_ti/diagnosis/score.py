"""Scores: how much of the misfit each cause's fingerprint explains beyond what the nuisances can."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import log_ndtr, logsumexp

from sim.evidence import Posterior, posterior
from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.columns import Direction, directions_of
from veo_ti.diagnosis.fitted import Refit
from veo_ti.diagnosis.misfit import Misfit
from veo_ti.diagnosis.model import Model
from veo_ti.diagnosis.moments import Along, Moments, moments, moments_of
from veo_ti.diagnosis.visible import surely_visible

_WAYS = 64  # directions of a cause's parameters, evenly spread
_SURE = 4.3  # standard deviations: 3 for a false alarm in 700, 1.3 for nine in ten


@dataclass(frozen=True, kw_only=True, eq=False)
class Statistics:
    """The linearised model with its nuisances marginalised: `Sigma = s2 I + J P^-1 J^T`, never formed.

    s2 [m2] counts correlated residuals as fewer; prior (n,) holds the nuisances' variances.
    """

    moments: Moments
    s2: float
    prior: np.ndarray

    def inner(self, left: slice | np.ndarray, right: slice | np.ndarray) -> np.ndarray:
        """left^T Sigma^-1 right for columns of the moments."""
        A = self.moments.normal.A
        n = self.moments.nuisances
        return (A[left][:, right] - A[left][:, :n] @ self._taken @ A[:n][:, right]) / self.s2

    def against(self, left: slice | np.ndarray) -> np.ndarray:
        """left^T Sigma^-1 z."""
        A, b = self.moments.normal.A, self.moments.normal.b
        n = self.moments.nuisances
        return (b[left] - A[left][:, :n] @ self._taken @ b[:n]) / self.s2

    def joint(self, columns: np.ndarray, widths: np.ndarray) -> np.ndarray:
        """The most probable nuisances (n,) and parameters (d,) together."""
        return self._posterior(columns, widths).mean

    def alone(self, columns: np.ndarray) -> np.ndarray:
        """|column|^2 / s2: what would be left if no nuisance took any of it."""
        return np.diagonal(self.moments.normal.A)[columns] / self.s2

    def likeness(self, one: "Score", other: "Score") -> float:
        """Share of what `one` does beyond the nuisances, to first order, that `other` can do; both of these statistics.

        `w^T V_wo V_oo^-1 V_ow w / w^T V_ww w` at one's parameters w.
        """
        done, whole = self._imitated(other.columns, one.columns), self.inner(one.columns, one.columns)
        return float(one.theta @ done @ one.theta / max(one.theta @ whole @ one.theta, 1e-300))

    def together(self, one: "Score", other: "Score", noise: "Statistics") -> float:
        """Share of the misfit's excess that two most probably take with them, by the same statistics at the variance of
        the noise."""
        columns, widths = np.append(one.columns, other.columns), np.append(one.widths, other.widths)
        theta = self.joint(columns, widths)[self.moments.nuisances :]
        return noise.explained(columns, theta)

    def unlike(self, own: np.ndarray, others: np.ndarray, widths: np.ndarray) -> np.ndarray:
        """How far what others do beyond the nuisances is from all that directions `own` can do, to first order.

        The sine of the angle between the two, (P, n) for another cause's columns (P, d) at P places and n directions
        of its parameters, evenly spread in units of their widths (d,).
        """
        ways = widths * np.random.default_rng(0).normal(size=(_WAYS, len(widths)))
        forms = [(self._imitated(own, columns), self.inner(columns, columns)) for columns in others]
        done, whole = np.einsum("ni,pfij,nj->fpn", ways, np.array(forms), ways)
        return np.sqrt(np.clip(1 - done / np.maximum(whole, 1e-300), 0.0, 1.0))

    def _imitated(self, by: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """`V_cb V_bb^-1 V_bc`: what of other columns directions `by` can do."""
        V, C = self.inner(by, by), self.inner(by, columns)
        units = 1 / np.sqrt(np.maximum(np.diagonal(V), 1e-300))
        C = units[:, None] * C
        return C.T @ np.linalg.pinv(units[:, None] * V * units, hermitian=True) @ C

    @property
    def smooth(self) -> slice:
        """The columns of the smooth modes."""
        return slice(len(self.moments.normal.b) - self.moments.modes, None)

    def misfit(self) -> Misfit:
        """Energy of the residual in the smooth modes against its expectation."""
        return Misfit.of(self.against(self.smooth), self._smooth_covariance)

    def explained(self, columns: np.ndarray, theta: np.ndarray) -> float:
        """Share of the misfit's excess that directions take with them at theta (d,), to first order; 0 of nothing."""
        left = Misfit.of(self.against(self.smooth) - self.inner(self.smooth, columns) @ theta, self._smooth_covariance)
        whole = self.misfit().excess
        return 1 - left.excess / whole if whole else 0.0

    @cached_property
    def _smooth_covariance(self) -> np.ndarray:
        return self.inner(self.smooth, self.smooth)

    @cached_property
    def _taken(self) -> np.ndarray:
        """(A + s2 P^-1)^-1 of the nuisances."""
        return self._posterior(np.zeros(0, int), np.zeros(0)).covariance / self.s2

    def _posterior(self, columns: np.ndarray, widths: np.ndarray) -> Posterior:
        own = np.concatenate([np.arange(self.moments.nuisances), columns])
        every = self.moments.normal
        normal = replace(every, A=every.A[np.ix_(own, own)], b=every.b[own])
        return posterior(normal, np.concatenate([self.prior, widths**2]), np.sqrt(self.s2))


@dataclass(frozen=True, kw_only=True, eq=False)
class Score:
    """A cause before any refit. theta (d,), sd (d,) and place: the most probable ones to first order."""

    cause: Cause
    place: Any
    theta: np.ndarray
    sd: np.ndarray
    log_bayes: float
    statistic: float  # u^T V^-1 u at the place
    keep: float  # share of the fingerprint that the nuisances cannot imitate
    explained: float  # share of the misfit's excess beyond noise that it takes with it, to first order
    detectable: np.ndarray  # (d,) smallest value that would be seen in nine cases of ten
    nuisances: np.ndarray  # (n,) the most probable ones beside theta
    columns: np.ndarray  # (d,) of its directions in the statistics it was made by
    widths: np.ndarray  # (d,) of its parameters' priors
    unlike: Mapping[str, np.ndarray] = field(default_factory=dict)  # of a lawful cause, how far others are from it

    @property
    def name(self) -> str:
        """The cause's name."""
        return self.cause.name


def score(
    statistics: Statistics, noise: Statistics, cause: Cause, widths: np.ndarray, places: Sequence[Any],
    columns: np.ndarray, least: float,
) -> Score:  # fmt: skip
    """The score of one cause; columns (places, d) of its directions. The number of places is paid for.

    noise: the statistics at the variance of the noise, and least: the norm over all data of an effect that surely
    stands out from the simulation's own error [m], in which the smallest detectable size is meant.
    """
    results = [_at(statistics, cause, widths, c) for c in columns]
    evidence = np.array([r[0] for r in results])
    best = int(np.argmax(evidence))
    theta, sd, statistic, keep = results[best][1:]
    V = np.diagonal(noise.inner(columns[best], columns[best]))
    needed = max(_SURE, least / np.sqrt(noise.s2))
    detectable = needed / np.sqrt(np.maximum(V, 1e-300))
    return Score(
        cause=cause, place=places[best], theta=theta, sd=sd, statistic=statistic, keep=keep, detectable=detectable,
        explained=noise.explained(columns[best], theta),
        log_bayes=float(logsumexp(evidence) - np.log(len(evidence))),
        nuisances=statistics.joint(columns[best], widths)[: statistics.moments.nuisances], columns=columns[best],
        widths=widths,
    )  # fmt: skip


def _at(statistics: Statistics, cause: Cause, widths: np.ndarray, columns: np.ndarray) -> tuple:
    """Work in units of the prior's widths, in which the parameters are of order one."""
    V = widths[:, None] * statistics.inner(columns, columns) * widths
    u = widths * statistics.against(columns)
    precision = V + np.eye(len(u))
    covariance = np.linalg.inv(precision)
    mean = covariance @ u
    log_bayes = 0.5 * u @ mean - 0.5 * np.linalg.slogdet(precision)[1]
    if len(u) == 1 and cause.parameters[0].positive:  # half the prior's mass sits where physics is
        log_bayes += np.log(2) + log_ndtr(mean[0] / np.sqrt(covariance[0, 0]))
    alone = widths**2 * statistics.alone(columns)
    keep = float(np.sqrt(np.trace(V) / max(alone.sum(), 1e-300)))
    statistic = float(u @ np.linalg.pinv(V, hermitian=True) @ u)
    return float(log_bayes), widths * mean, widths * np.sqrt(np.diagonal(covariance)), statistic, keep


def scores_of(
    current: Refit, model: Model, floor: float, modes: np.ndarray, tries: Sequence[tuple[Cause, Sequence[Any]]]
) -> tuple[Statistics, tuple[Score, ...]]:
    """The score of every cause over its places beside what `current` holds, best first.

    A cause that it holds is one more nuisance: beside the other one it may be larger or smaller than alone.
    """
    taken, beside = current.taken_in(), Along.with_cause(current.cause, current.scene, current.theta, current.place)
    scene, held, prior = taken.scene, [], taken.prior
    if current.cause is not None:
        held = directions_of(current.cause, current.scene, current.place, current.theta)
        prior = np.concatenate([prior, current.cause.widths(current.scene) ** 2])
    directions: list[Direction] = []
    table = []
    for cause, places in tries:
        columns = []
        for place in places:
            made = directions_of(cause, scene, place)
            columns.append(range(len(directions), len(directions) + len(made)))
            directions += made
        table.append((cause, places, np.array(columns)))
    K = model.basis.log_mu.shape[1]
    found = moments(
        scene, model.basis, taken.around[:K], [*model.extra, *held], directions, along=beside,
        residual=scene.target.residual(taken.simulated), modes=modes,
    )  # fmt: skip
    statistics = Statistics(moments=found, s2=model.s2, prior=prior)
    least = surely_visible(scene, np.sqrt(floor), coarse=model.coarse) * np.sqrt(found.normal.count)
    noise = replace(statistics, s2=floor)
    scores = [
        score(statistics, noise, cause, cause.widths(scene), places, columns + found.nuisances, least)
        for cause, places, columns in table
    ]
    scores = [
        replace(s, unlike={
            cause.name: statistics.unlike(s.columns, columns + found.nuisances, cause.widths(scene))
            for cause, _, columns in table if cause is not s.cause
        }) if s.cause.lawful else s
        for s in scores
    ]  # fmt: skip
    return statistics, tuple(sorted(scores, key=lambda s: -s.log_bayes))


def statistics_of(result: Refit, model: Model, modes: np.ndarray) -> Statistics:
    """The nuisances and the smooth modes against what a refit leaves, with its own fingerprints."""
    taken, K = result.taken_in(), model.basis.log_mu.shape[1]
    residual = taken.scene.target.residual(taken.simulated) * taken.scene.train[:, None, None]
    found = moments_of(result.kept, result.around[:K], len(model.extra), residual, taken.scene.target.seen, modes)
    return Statistics(moments=found, s2=model.s2, prior=taken.prior)
