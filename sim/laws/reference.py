"""Laws of a reference pose that is not free of stress: a strain it would rather have, or a stress that it carries.

`E = (F^T F - 1) / 2` is the Green strain. Both depend on a direction in space and are linear in the stress they add.
"""

import numpy as np
import taichi as ti


@ti.func
def _green(F):
    """E = (F^T F - 1) / 2."""
    return 0.5 * (F.transpose() @ F - ti.Matrix.identity(ti.f64, 3))


@ti.func
def _eigen_strain(m: ti.template(), i):
    """The symmetric A of point i."""
    return ti.Matrix([[m[i, 1], m[i, 6], m[i, 5]], [m[i, 6], m[i, 2], m[i, 4]], [m[i, 5], m[i, 4], m[i, 3]]])


@ti.func
def _initial_stress(m: ti.template(), i):
    """The symmetric S of point i."""
    return ti.Matrix([[m[i, 0], m[i, 5], m[i, 4]], [m[i, 5], m[i, 1], m[i, 3]], [m[i, 4], m[i, 3], m[i, 2]]])


class EigenStrain:
    """`psi = c/2 |E - A|^2 - c/2 |A|^2 = c/2 |E|^2 - c A:E`: c [Pa], null 0, towards a strain A [-], (3, 3) symmetric.

    `P = c F (E - A)`, `dP[W] = c (W (E - A) + F sym(F^T W))`. A is the viscous strain of a Maxwell branch, a permanent
    set, or minus a prestress over c. At rest the stress is -c A, the one of these laws that does not vanish there.
    """

    parameters = ("c", "A00", "A11", "A22", "A12", "A02", "A01")

    @staticmethod
    def pack(c: np.ndarray | float, A: np.ndarray) -> np.ndarray:
        """The parameters m (..., 7) of c (...) [Pa] and A (..., 3, 3)."""
        parts = [A[..., r, s] for r, s in ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))]
        return np.stack([np.broadcast_to(c, A.shape[:-2]), *parts], axis=-1)

    @staticmethod
    @ti.func
    def psi(F, m: ti.template(), i):
        E = _green(F)
        return m[i, 0] * (0.5 * E.norm_sqr() - (E * _eigen_strain(m, i)).sum())

    @staticmethod
    @ti.func
    def piola(F, m: ti.template(), i):
        return m[i, 0] * (F @ (_green(F) - _eigen_strain(m, i)))

    @staticmethod
    @ti.func
    def dpiola(F, W, m: ti.template(), i):
        D = F.transpose() @ W
        return m[i, 0] * (W @ (_green(F) - _eigen_strain(m, i)) + F @ (0.5 * (D + D.transpose())))


class InitialStress:
    """`psi = S:E`: a stress S [Pa] (second Piola-Kirchhoff, symmetric) that the reference pose carries, null 0.

    `P = F S`, `dP[W] = W S`. At rest it does not vanish: it balances what loads the reference pose.
    """

    parameters = ("S00", "S11", "S22", "S12", "S02", "S01")

    @staticmethod
    def pack(S: np.ndarray) -> np.ndarray:
        """The parameters m (..., 6) of S (..., 3, 3) [Pa]."""
        return np.stack([S[..., r, s] for r, s in ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))], axis=-1)

    @staticmethod
    @ti.func
    def psi(F, m: ti.template(), i):
        return (_green(F) * _initial_stress(m, i)).sum()

    @staticmethod
    @ti.func
    def piola(F, m: ti.template(), i):
        return F @ _initial_stress(m, i)

    @staticmethod
    @ti.func
    def dpiola(F, W, m: ti.template(), i):
        return W @ _initial_stress(m, i)
