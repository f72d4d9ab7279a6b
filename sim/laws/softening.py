"""Mullins softening: by damage that stays, or below the largest load so far only.

`I = I_c - 3 - 2 ln J` is the invariant of `sim.laws.extra`, the load.
"""

import numpy as np
import taichi as ti

from sim.checks import require
from sim.laws.neo_hookean import dpiola, piola, psi


def load(F: np.ndarray) -> np.ndarray:
    """I of F (..., 3, 3), (...); ValueError where an F is inside out."""
    J = np.linalg.det(F)
    require(bool((J > 0).all()), "F", "have J > 0 everywhere", J.min())
    return np.maximum((F**2).sum(axis=(-2, -1)) - 3 - 2 * np.log(J), 0.0)


def largest_load(F: np.ndarray) -> np.ndarray:
    """The largest I up to each frame of a trajectory F (T, ..., 3, 3), (T, ...); raises what `load` does."""
    return np.maximum.accumulate(load(F), axis=0)


def damage(F: np.ndarray, scale: float, *, soon: bool = False) -> np.ndarray:
    """Mullins variable `D_t = I / (I + scale)`, I the largest up to t, of a trajectory F (T, ..., 3, 3), (T, ...).

    soon: the usual `1 - exp(-I / scale)` (Miehe 1995), which ends sooner. At I = scale half the damage is done, or
    63 %. A stress (1 - d D) of the elastic one, I in proportion to the square of the strain, never falls while the
    strain grows as long as d < 8/9, and a loaded body keeps an equilibrium (d < 0.69 if soon). Raises ValueError when
    scale is not positive or an F is inside out.
    """
    require(scale > 0, "scale", "be positive", scale)
    most = largest_load(F)
    return -np.expm1(-most / scale) if soon else most / (most + scale)


def damage_slope(D: np.ndarray, scale: float, *, soon: bool = False) -> np.ndarray:
    """dD/dI of `damage` where a frame does it itself, `(1 - D)^2 / scale`, or `(1 - D) / scale`."""
    return (1 - D) ** (1 if soon else 2) / scale


@ti.func
def _below(F, m: ti.template(), i):
    """How far below the largest load so far, in scales."""
    return ti.max(m[i, 3] - 2.0 * psi(F, 1.0, 0.0), 0.0) / m[i, 2]


@ti.func
def _ln_2_cosh(x):
    """ln(2 cosh x) of x >= 0."""
    return x + ti.log(1.0 + ti.exp(-2.0 * x))


class SoftBelow:
    """`P = -d tanh(<M - I> / s) P_mu`, P_mu the Neo-Hookean stress of mu alone: mu [Pa], d [-], null 0, s [-], M [-]
    the largest I so far (Ogden & Roxburgh 1999, with Dorfmann & Ogden's tanh, 2004).

    With x = <M - I> / s, `psi = -d mu/2 s (ln cosh(M/s) - ln cosh x)` and
    `dP[W] = -d (tanh x dP_mu[W] - 2 / (mu s cosh^2 x) (P_mu:W) P_mu)`, the last where x > 0. Nothing is softer where
    the load is the largest so far, and what is cannot give way: stress rises all the more where strain does.
    """

    parameters = ("mu", "d", "s", "M")

    @staticmethod
    @ti.func
    def psi(F, m: ti.template(), i):
        value = ti.math.inf
        if F.determinant() > 0:
            lost = _ln_2_cosh(m[i, 3] / m[i, 2]) - _ln_2_cosh(_below(F, m, i))
            value = -0.5 * m[i, 0] * m[i, 1] * m[i, 2] * lost
        return value

    @staticmethod
    @ti.func
    def piola(F, m: ti.template(), i):
        return (-m[i, 0] * m[i, 1] * ti.tanh(_below(F, m, i))) * piola(F, 1.0, 0.0)

    @staticmethod
    @ti.func
    def dpiola(F, W, m: ti.template(), i):
        B, x = piola(F, 1.0, 0.0), _below(F, m, i)
        share, along = ti.tanh(x), 0.0
        if x > 0:
            along = 2.0 / m[i, 2] * (1.0 - share**2) * (B * W).sum()
        return (-m[i, 0] * m[i, 1]) * (share * dpiola(F, W, 1.0, 0.0) - along * B)
