"""A model fitted to curves: the most probable parameters, their covariance, and the evidence.

Relative errors are `e = (P_measured - P_model) / scale = noise + smooth`: no simple law is exact for a real rubber, so
each may leave a smooth error of relative size `left`, chosen by its evidence. A law that needs a smaller one is the
better law, and points that share an error do not count as independent.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from veo_ti.coupons.data import Data
from veo_ti.coupons.model import Model

SYSTEMATIC = 0.015  # of the stress: what tests like these are off by at the least, specimen by specimen
LEFT = tuple(np.geomspace(SYSTEMATIC, 2.0, 36))  # smooth relative errors that a law may leave
USUAL = 0.1  # of them: what is further off is hardly a law
_STEP = 1e-5  # of a width, for derivatives
_STEPS, _ROUNDS, _SETTLED = 60, 8, 0.1
_CLOSE = 1e-4  # nats


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """covariance (1 + d, 1 + d): of log mu and theta; left: the relative size of the smooth error that remains.

    energy: sum of the squared errors in units of noise and SYSTEMATIC, of the fit that makes it smallest.
    """

    model: Model
    mu: float
    theta: np.ndarray
    covariance: np.ndarray
    evidence: float
    left: float
    energy: float

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations of theta, (d,)."""
        return np.sqrt(np.diagonal(self.covariance)[1:])

    @property
    def mu_sd(self) -> float:
        """Standard deviation of mu [Pa]."""
        return self.mu * float(np.sqrt(self.covariance[0, 0]))

    @property
    def plausible(self) -> bool:
        """Whether signs are what physics allows."""
        return bool((self.theta[self.model.positive] > 0).all())

    def stress(self, mode: str, stretch: np.ndarray) -> np.ndarray:
        """The nominal stress shown, (n,) [Pa]."""
        return self.model.stress(mode, stretch, self.mu, self.theta)

    def derivative(self, mode: str, stretch: np.ndarray) -> np.ndarray:
        """Of that stress by log mu and theta, (n, 1 + d); zero where it is not finite."""
        return _derivative(self.model, lambda p: self.model.stress(mode, stretch, *_natural(p)), self._at)

    @property
    def _at(self) -> np.ndarray:
        return np.concatenate([[np.log(self.mu)], self.theta])


def fit(model: Model, data: Data, *, start: np.ndarray | None = None, left: float | None = None) -> Fit:
    """The model's maximum a posteriori fit, its `left` of highest evidence unless given.

    Prior: log mu ~ N(log of the initial modulus, 1), theta ~ N(0, widths^2). start: a guess of the first of theta; the
    others are tried at their null and a little beside it.
    """
    plain = p = _best(model, data, SYSTEMATIC, _starts(model, data, start))
    if left is not None:
        return _fit(model, data, left, _best(model, data, left, [plain]), plain)
    left = SYSTEMATIC
    for _ in range(_ROUNDS):
        before, left = left, _likely(model, data, p)
        p = _best(model, data, left, [p])
        if abs(left - before) <= _SETTLED * left:
            break
    return _fit(model, data, left, p, plain)


def _likely(model: Model, data: Data, p: np.ndarray) -> float:
    """The size of the smooth error that has the highest evidence where the parameters stay."""
    r, J = data.mean @ _residual(model, data, p), _slope(model, data, p)
    return max(LEFT, key=lambda left: _evidence(model, data, left, p, r, J)[0])


def _fit(model: Model, data: Data, left: float, p: np.ndarray, plain: np.ndarray) -> Fit:
    r, J = data.mean @ _residual(model, data, p), _slope(model, data, p)
    evidence, H = _evidence(model, data, left, p, r, J)
    scale, residual = _scales(model), data.mean @ _residual(model, data, plain)
    return Fit(
        model=model, mu=float(np.exp(p[0])), theta=p[1:], covariance=scale[:, None] * np.linalg.inv(H) * scale,
        evidence=evidence, left=left, energy=float((residual**2 / (data.noise**2 + SYSTEMATIC**2)).sum()),
    )  # fmt: skip


def _scales(model: Model) -> np.ndarray:
    """Prior standard deviations of log mu and theta."""
    return np.concatenate([[1.0], model.width])


def _natural(p: np.ndarray) -> tuple[float, np.ndarray]:
    return float(np.exp(p[0])), p[1:]


def _shown(model: Model, data: Data, p: np.ndarray) -> np.ndarray:
    return np.concatenate([model.stress(c.mode, c.stretch, *_natural(p)) for c in data.curves])


def _residual(model: Model, data: Data, p: np.ndarray) -> np.ndarray:
    return (data.stress - _shown(model, data, p)) / data.scale


def _derivative(model: Model, of: Callable[[np.ndarray], np.ndarray], p: np.ndarray) -> np.ndarray:
    """One-sided differences by every parameter, away from where a law ends; zero where they are not finite."""
    here, columns = of(p), []
    for k, step in enumerate(_STEP * _scales(model)):
        beside = p.copy()
        beside[k] += step
        if not model.allows(beside[1:]):
            step = -step
            beside[k] = p[k] + step
        with np.errstate(invalid="ignore"):  # locked: infinity less infinity
            columns.append((of(beside) - here) / step)
    J = np.stack(columns, axis=1)
    return np.where(np.isfinite(J), J, 0.0)


def _slope(model: Model, data: Data, p: np.ndarray) -> np.ndarray:
    """Derivative of the pieces' relative stress by log mu and theta, (b, 1 + d)."""
    return data.mean @ (_derivative(model, lambda q: _shown(model, data, q), p) / data.scale[:, None])


def _starts(model: Model, data: Data, start: np.ndarray | None) -> list[np.ndarray]:
    """The null and a little of every effect; only of those that a given start says nothing about."""
    known = np.zeros(0) if start is None else start
    width = model.width[len(known) :]
    centre = np.log(data.modulus)
    guesses = [np.concatenate([[centre], known, share * width]) for share in (0.0, 0.3)]
    return [guess for guess in guesses if model.allows(guess[1:])]


def _best(model: Model, data: Data, left: float, starts: Sequence[np.ndarray]) -> np.ndarray:
    """The most probable (log mu, theta): Levenberg and Marquardt's method from each start."""
    root = np.hypot(data.noise, left)
    centre = np.concatenate([[np.log(data.modulus)], np.zeros(len(model.width))])
    found = [_descend(model, data, root, centre, start) for start in starts]
    return min(found, key=lambda pair: pair[0])[1]


def _descend(model: Model, data: Data, root: np.ndarray, centre: np.ndarray, p: np.ndarray) -> tuple[float, np.ndarray]:
    scale = _scales(model)

    def whitened(q: np.ndarray) -> np.ndarray | None:
        r = _residual(model, data, q) if model.allows(q[1:]) else np.full(1, np.inf)
        if not np.isfinite(r).all():
            return None
        return np.concatenate([data.mean @ r / root, (q - centre) / scale])

    r = whitened(p)
    if r is None:
        return np.inf, p
    damping = 1e-3
    for _ in range(_STEPS):
        J = np.concatenate([-_slope(model, data, p) / root[:, None] * scale, np.eye(len(p))])
        A, b = J.T @ J, J.T @ r
        while damping < 1e8:
            change = -scale * np.linalg.solve(A + damping * np.diag(np.diagonal(A)), b)
            trial = whitened(p + change)
            if trial is not None and trial @ trial < r @ r:
                break
            damping *= 4
        else:
            break
        gained = r @ r - trial @ trial
        p, r, damping = p + change, trial, damping / 10
        if gained < _CLOSE:
            break
    return float(r @ r), p


def _evidence(
    model: Model, data: Data, left: float, p: np.ndarray, residual: np.ndarray, slope: np.ndarray
) -> tuple[float, np.ndarray]:
    """Laplace's log evidence, and the Hessian of the cost in units of the prior's widths.

    `log Z = -(r^T C^-1 r + log det C + |phi - phi0|^2 + log det H + (left / USUAL)^2) / 2`, `C = noise^2 + left^2`,
    `H = J^T C^-1 J + 1`, up to a constant; half of a positive parameter's prior sits where physics is, so its density
    counts twice.
    """
    scale = _scales(model)
    root = np.hypot(data.noise, left)
    r, J = residual / root, slope / root[:, None] * scale
    H = J.T @ J + np.eye(len(p))
    phi = np.concatenate([[p[0] - np.log(data.modulus)], p[1:]]) / scale
    value = -0.5 * (r @ r + phi @ phi + np.linalg.slogdet(H)[1] + (left / USUAL) ** 2) - np.log(root).sum()
    sd = scale[1:] * np.sqrt(np.diagonal(np.linalg.inv(H))[1:])
    one_sided = np.log(2) + log_ndtr(p[1:] / sd)
    return float(value + one_sided[model.positive].sum()), H
