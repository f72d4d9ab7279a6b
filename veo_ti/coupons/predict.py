"""What a law fitted to some curves says of others: errors on data that chose nothing, beside plain predictions."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from veo_ti.coupons.curves import Curve, first_invariant, free_of_pressure, principal
from veo_ti.coupons.data import pieces_of
from veo_ti.coupons.fit import USUAL, Fit
from veo_ti.coupons.search import Found

_DRAWS = 2000
LABELS = {
    "no_change": "no change (zero stress)", "hold_residual": "refit, holding its residual at the nearest stretch",
    "refit_only": "refit of the Neo-Hookean law only", "after": "with the named causes",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Fold:
    """One division of the data. found: what the training curves alone chose; held: what was kept from them."""

    train: tuple[Curve, ...]
    held: tuple[Curve, ...]
    found: Found

    @property
    def label(self) -> str:
        """In words: which modes taught, which were predicted."""
        return f"{_names(self.train)} -> {_names(self.held)}"

    def predicted(self, curve: Curve) -> dict[str, np.ndarray]:
        """The stress of a held-out curve by each way of predicting, (n,) [Pa]."""
        plain = self.found.baseline.fit
        refit = plain.stress(curve.mode, curve.stretch)
        return {
            "no_change": np.zeros(len(curve)), "hold_residual": refit + self._held_residual(plain, curve),
            "refit_only": refit, "after": self.found.applied.fit.stress(curve.mode, curve.stretch),
        }  # fmt: skip

    def _held_residual(self, plain: Fit, curve: Curve) -> np.ndarray:
        """The Neo-Hookean fit's residual at the training point of nearest stretch, its own mode's first, (n,) [Pa]."""
        same = [c for c in self.train if c.mode == curve.mode] or self.train
        stretch = np.concatenate([c.stretch for c in same])
        residual = np.concatenate([c.stress - plain.stress(c.mode, c.stretch) for c in same])
        return residual[np.abs(np.log(curve.stretch[:, None] / stretch)).argmin(axis=1)]


def _names(curves: Sequence[Curve]) -> str:
    return ", ".join(f"{c.mode} {c.stretch.min():.3g}-{c.stretch.max():.3g}" for c in curves)


def usual_mooney_rivlin(curves: Sequence[Curve]) -> tuple[float, float]:
    """C1, C2 [Pa] of `W = C1 (I1 - 3) + C2 (I2 - 3)` by least squares in stress, unweighted, as it is usually done."""
    columns, stress = [], np.concatenate([c.stress for c in curves])
    for c in curves:
        s = principal(c.mode, c.stretch)
        by_I1, by_I2 = 2 * s, 2 * s * ((s**2).sum(axis=1, keepdims=True) - s**2)
        columns.append(np.stack([free_of_pressure(s, by_I1), free_of_pressure(s, by_I2)], axis=1))
    C1, C2 = np.linalg.lstsq(np.concatenate(columns), stress, rcond=None)[0]
    return float(C1), float(C2)


def mooney_rivlin(curve: Curve, C1: float, C2: float) -> np.ndarray:
    """Its nominal stress at a curve's stretches, (n,) [Pa]."""
    s = principal(curve.mode, curve.stretch)
    return free_of_pressure(s, 2 * s * (C1 + C2 * ((s**2).sum(axis=1, keepdims=True) - s**2)))


def relative(curve: Curve, stress: np.ndarray) -> np.ndarray:
    """Errors in units of the curve's scale, (n,)."""
    return (stress - curve.stress) / curve.scale


def rms(errors: np.ndarray) -> float:
    """Root mean square; infinite where a law has locked."""
    with np.errstate(over="ignore"):
        return float(np.sqrt((errors**2).mean()))


def r_squared(curve: Curve, stress: np.ndarray) -> float:
    """1 - sum (P - P_model)^2 / sum (P - mean P)^2 of one curve."""
    spread = float(((curve.stress - curve.stress.mean()) ** 2).sum())
    with np.errstate(over="ignore"):
        return 1 - float(((curve.stress - stress) ** 2).sum()) / spread


@dataclass(frozen=True, kw_only=True)
class Gain:
    """Root mean square relative errors of the held-out points by each way of predicting, and refit only minus after.

    gained: value and 95 % interval over pieces of curves drawn anew, never over points; the same in Pa in mean_pa.
    coverage: share of the held-out points inside the 95 % intervals of their prediction.
    """

    errors: dict[str, float]
    errors_pa: dict[str, float]
    gained: tuple[float, float, float]
    coverage: float
    points: int

    @property
    def confirmed(self) -> bool:
        """Whether the interval leaves out zero."""
        return self.gained[1] > 0


def measure_gain(folds: Sequence[Fold], *, seed: int = 0) -> Gain | None:
    """Pool the held-out points of all divisions; None where nothing was held out."""
    pairs = [(fold, curve) for fold in folds for curve in fold.held]
    if not pairs:
        return None
    made = [(curve, fold.predicted(curve)) for fold, curve in pairs]
    error = {key: np.concatenate([relative(c, p[key]) for c, p in made]) for key in LABELS}
    error_pa = {key: np.concatenate([p[key] - c.stress for c, p in made]) for key in LABELS}
    inside = [
        np.abs(p["after"] - c.stress) <= 1.96 * spread(f.found, c) for (f, c), (_, p) in zip(pairs, made, strict=True)
    ]
    pieces, first = [], 0
    for curve, _ in made:
        own = pieces_of(curve)
        pieces += [first + np.flatnonzero(own == k) for k in np.unique(own)]
        first += len(curve)
    value = rms(error["refit_only"]) - rms(error["after"])
    return Gain(
        errors={key: rms(e) for key, e in error.items()}, errors_pa={key: rms(e) for key, e in error_pa.items()},
        gained=(value, *_interval(error, pieces, seed)), coverage=float(np.concatenate(inside).mean()), points=first,
    )  # fmt: skip


def _interval(error: dict[str, np.ndarray], pieces: Sequence[np.ndarray], seed: int) -> tuple[float, float]:
    """The quantiles of the gain over pieces drawn with replacement; no interval where the law has locked."""
    if not np.isfinite(error["after"]).all():
        return -np.inf, np.inf
    before, after = ([float((error[key][p] ** 2).sum()) for p in pieces] for key in ("refit_only", "after"))
    sums = np.array([before, after, [len(p) for p in pieces]])  # (3, pieces)
    drawn = np.random.default_rng(seed).integers(len(pieces), size=(_DRAWS, len(pieces)))
    b, a, n = sums[:, drawn].sum(axis=2)
    low, high = np.quantile(np.sqrt(b / n) - np.sqrt(a / n), [0.025, 0.975])
    return float(low), float(high)


def spread(found: Found, curve: Curve) -> np.ndarray:
    """Standard deviation of a prediction at a curve's stretches, (n,) [Pa].

    From the parameters, from the smooth error that the law leaves, from noise, and from the disagreement of the laws
    that the training data could not tell apart. In a mode, or at a stretch, that taught nothing, a law is taken to be
    off as laws usually are, and the more so the further it is continued.
    """
    fit = found.applied.fit
    shown = fit.stress(curve.mode, curve.stretch)
    J = fit.derivative(curve.mode, curve.stretch)
    variance = np.einsum("ni,ij,nj->n", J, fit.covariance, J)
    left = np.hypot(fit.left, _foreign(found, curve))
    level = np.hypot(np.hypot(shown, 0.1 * np.median(np.abs(shown))) * left, np.median(found.data.level) * shown)
    others = [r.fit.stress(curve.mode, curve.stretch) - shown for r in found.likely]
    with np.errstate(over="ignore"):
        between = np.max(np.square([*others, np.zeros_like(shown)]), axis=0)
    return np.sqrt(variance + level**2 + between)


def _foreign(found: Found, curve: Curve) -> np.ndarray:
    """Relative error of a law where it was not fitted, (n,): zero where the mode was, up to that stretch."""
    taught = {c.mode: float(c.stretch.max()) for c in found.data.curves}
    highest = max(float(first_invariant(principal(c.mode, c.stretch)).max()) for c in found.data.curves)
    further = first_invariant(principal(curve.mode, curve.stretch)) / highest
    return np.where(curve.stretch <= taught.get(curve.mode, 0.0), 0.0, USUAL * np.maximum(further, 1.0))
