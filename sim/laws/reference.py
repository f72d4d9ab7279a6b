"""The law of a reference pose that is not free of stress, or would rather have another shape.

`E = (F^T F - 1) / 2` is the Green strain.
"""

import numpy as np
import taichi as ti


@ti.func
def _green(F):
    """E = (F^T F - 1) / 2."""
    return 0.5 * (F.transpose() @ F - ti.Matrix.identity(ti.f64, 3))


@ti.func
def _own(m: ti.template(), i):
    """The symmetric S of point i."""
    return ti.Matrix([[m[i, 1], m[i, 6], m[i, 5]], [m[i, 6], m[i, 2], m[i, 4]], [m[i, 5], m[i, 4], m[i, 3]]])


class LinearStress:
    """`psi = mu |E|^2 + S:E`: a stress S [Pa] (second Piola-Kirchhoff, symmetric), and 2 mu E beside it; null 0.

    `P = F (2 mu E + S)`, `dP[W] = W (2 mu E + S) + 2 mu F sym(F^T W)`. With S = -2 mu A the material would rather have
    the strain A: the viscous strain of a Maxwell branch, or a permanent set. A prestress has S alone. It depends on
    how the material lies, and is the one of these laws whose stress does not vanish at rest.
    """

    parameters = ("mu", "S00", "S11", "S22", "S12", "S02", "S01")

    @staticmethod
    def pack(mu: np.ndarray | float, S: np.ndarray) -> np.ndarray:
        """The parameters m (..., 7) of mu (...) [Pa] and S (..., 3, 3) [Pa]."""
        parts = [S[..., r, s] for r, s in ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))]
        return np.stack([np.broadcast_to(mu, S.shape[:-2]), *parts], axis=-1)

    @staticmethod
    @ti.func
    def psi(F, m: ti.template(), i):
        E = _green(F)
        return m[i, 0] * E.norm_sqr() + (E * _own(m, i)).sum()

    @staticmethod
    @ti.func
    def piola(F, m: ti.template(), i):
        return F @ (2 * m[i, 0] * _green(F) + _own(m, i))

    @staticmethod
    @ti.func
    def dpiola(F, W, m: ti.template(), i):
        D = F.transpose() @ W
        return W @ (2 * m[i, 0] * _green(F) + _own(m, i)) + m[i, 0] * (F @ (D + D.transpose()))
