"""What a material remembers of its motion: a Maxwell branch its strain, a damaged one the largest load so far."""

import numpy as np

from sim.checks import as_array, require


def green_strain(F: np.ndarray) -> np.ndarray:
    """`E = (F^T F - 1) / 2` of F (..., 3, 3)."""
    return (np.swapaxes(F, -1, -2) @ F - np.eye(3)) / 2


def viscous_strain(E: np.ndarray, time: np.ndarray, tau: float) -> np.ndarray:
    """E_v (T, ...) of `tau E_v' = E - E_v` with E_v = 0 at the first frame, for strains E (T, ...) at times (T,) [s].

    With x = step / tau and f of `at_once`: `E_v <- e^-x E_v + (1 - f - e^-x) E_before + f E_now`, exact for a
    strain that is linear between the frames, whatever the step. Raises ValueError when time does not increase or
    tau [s] is not positive.
    """
    time = as_array("time", time, (len(E),))
    steps = np.diff(time)
    require(bool((steps > 0).all()), "time", "increase from frame to frame", steps.min(initial=np.inf))
    require(tau > 0, "tau", "be positive", tau)
    out = np.zeros_like(E, dtype=float)
    decay, taken = np.exp(-steps / tau), at_once(time, tau)[1:]
    for t, (d, f) in enumerate(zip(decay, taken, strict=True), start=1):
        out[t] = d * out[t - 1] + (1 - f - d) * E[t - 1] + f * E[t]
    return out


def at_once(time: np.ndarray, tau: float) -> np.ndarray:
    """The share (T,) that a frame's own strain has in its viscous strain, `1 - (1 - e^-x) / x` with x = step / tau."""
    x = np.diff(as_array("time", time, (None,))) / tau
    return np.concatenate([[0.0], 1 + np.expm1(-x) / x])


def damage(F: np.ndarray, scale: float) -> np.ndarray:
    """Mullins variable `D_t = 1 - exp(-max_{s<=t} I_s / scale)` in [0, 1), (T, ...), of a trajectory F (T, ..., 3, 3).

    I = I_c - 3 - 2 ln J is the invariant of `sim.laws.extra`; at I = scale two thirds of the damage are done. Raises
    ValueError when scale is not positive or an F is inside out.
    """
    require(scale > 0, "scale", "be positive", scale)
    J = np.linalg.det(F)
    require(bool((J > 0).all()), "F", "have J > 0 everywhere", J.min())
    invariant = (F**2).sum(axis=(-2, -1)) - 3 - 2 * np.log(J)
    return -np.expm1(-np.maximum.accumulate(np.maximum(invariant, 0.0), axis=0) / scale)
