"""Frequency and damping of a ring-down: a damped sinusoid on a creeping offset, in least squares."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from sim.checks import as_array, require

RATES = (0.5, 2.0)  # [1/s] starts for the offset's decay
FEWEST = 12


@dataclass(frozen=True, kw_only=True)
class RingDown:
    """`z = A exp(-s t) cos(w t + phase) + B exp(-k t) + C`: frequency w / 2 pi, damping ratio s / sqrt(s^2 + w^2)."""

    frequency: float  # [Hz]
    ratio: float
    frequency_sd: float  # residuals that are alike counted once
    ratio_sd: float
    residual: float  # [m] root mean square

    @property
    def decrement(self) -> float:
        """Logarithmic decrement, of one period to the next."""
        return 2 * np.pi * self.ratio / np.sqrt(1 - self.ratio**2)


def ring_down(time: np.ndarray, z: np.ndarray) -> RingDown:
    """Fit heights z (T,) [m] at evenly spaced times (T,) [s]. Raises ValueError for fewer than 12 frames.

    For each pair of rates the rest is linear, so the starts are a scan over frequency alone.
    """
    time = as_array("time", time, (None,))
    z = as_array("z", z, time.shape)
    require(len(time) >= FEWEST, "time", f"hold at least {FEWEST} frames", len(time))
    t = time - time[0]

    def columns(p: np.ndarray) -> np.ndarray:
        wave = np.exp((-p[0] + 1j * p[1]) * t)
        return np.stack([wave.real, wave.imag, np.exp(-p[2] * t), np.ones_like(t)], axis=1)

    def left(p: np.ndarray) -> np.ndarray:
        C = columns(p)
        return z - C @ np.linalg.lstsq(C, z, rcond=None)[0]

    step, span = t[1] - t[0], t[-1]
    scan = np.arange(1.0, 0.4 * span / step) / span
    starts = [np.array([2.5, 2 * np.pi * f, k]) for f in scan for k in RATES]
    starts.sort(key=lambda p: float((left(p) ** 2).sum()))
    low, high = [-5.0, 2 * np.pi * 0.5 / span, 0.05], [50.0, np.pi / step, 20.0]
    fits = [least_squares(left, np.clip(p, low, high), bounds=(low, high), x_scale=[1, 10, 1]) for p in starts[:3]]
    best = min(fits, key=lambda f: f.cost)
    s, w, _ = best.x
    J, r = best.jac, best.fun
    alike = max(1.0, float(2 * (_rho(r) ** 2).sum() - 1))
    spread = alike * (r @ r) / max(len(r) - 7, 1) * np.linalg.pinv(J.T @ J)
    size = np.hypot(s, w)
    slope = np.array([w**2, -s * w, 0]) / size**3
    return RingDown(
        frequency=float(w / (2 * np.pi)), ratio=float(s / size), frequency_sd=float(np.sqrt(spread[1, 1]) / 2 / np.pi),
        ratio_sd=float(np.sqrt(slope @ spread @ slope)), residual=float(np.sqrt(np.mean(r**2))),
    )  # fmt: skip


def _rho(r: np.ndarray) -> np.ndarray:
    """Autocorrelation over all lags, (T,)."""
    c = np.correlate(r, r, mode="full")[len(r) - 1 :]
    return c / max(c[0], 1e-300)
