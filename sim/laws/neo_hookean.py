"""The paper's Neo-Hookean law (Eq. neoHookean), its first two derivatives, and its positive-definite projection."""

import numpy as np
import taichi as ti


@ti.func
def cofactor(F):
    """dJ/dF = J F^-T, (3, 3)."""
    f0, f1, f2 = F[0, :], F[1, :], F[2, :]
    return ti.Matrix.rows([f1.cross(f2), f2.cross(f0), f0.cross(f1)])


@ti.func
def cross(F, W):
    """d cofactor(F)[W], (3, 3): the cofactor is quadratic in F, so this is its symmetric bilinear form."""
    f0, f1, f2 = F[0, :], F[1, :], F[2, :]
    w0, w1, w2 = W[0, :], W[1, :], W[2, :]
    return ti.Matrix.rows([f1.cross(w2) + w1.cross(f2), f2.cross(w0) + w2.cross(f0), f0.cross(w1) + w0.cross(f1)])


@ti.func
def psi(F, mu, lam):
    """mu/2 (I_c - 3) - mu log J + lam/2 (J - 1)^2  [J/m3]; infinite where J <= 0."""
    J = F.determinant()
    value = ti.math.inf
    if J > 0:
        value = 0.5 * mu * (F.norm_sqr() - 3.0) - mu * ti.log(J) + 0.5 * lam * (J - 1.0) ** 2
    return value


@ti.func
def piola(F, mu, lam):
    """P = dpsi/dF = mu F + (lam (J - 1) - mu / J) cof F  [Pa]."""
    J = F.determinant()
    return mu * F + (lam * (J - 1.0) - mu / J) * cofactor(F)


@ti.func
def dpiola(F, W, mu, lam):
    """dP[W] = mu W + (lam + mu / J^2) (cof F : W) cof F + (lam (J - 1) - mu / J) cross(F, W)  [Pa]."""
    J = F.determinant()
    C = cofactor(F)
    CW = (C * W).sum()
    return mu * W + ((lam + mu / (J * J)) * CW) * C + (lam * (J - 1.0) - mu / J) * cross(F, W)


class NeoHookean:
    """The law as the elastic term takes it: parameters m (N, 2) hold mu, lam [Pa]; linear in both."""

    parameters = ("mu", "lam")

    @staticmethod
    @ti.func
    def psi(F, m: ti.template(), i):
        return psi(F, m[i, 0], m[i, 1])

    @staticmethod
    @ti.func
    def piola(F, m: ti.template(), i):
        return piola(F, m[i, 0], m[i, 1])

    @staticmethod
    @ti.func
    def dpiola(F, W, m: ti.template(), i):
        return dpiola(F, W, m[i, 0], m[i, 1])

    @staticmethod
    def projected(F: np.ndarray, m: np.ndarray) -> np.ndarray:
        """d2psi/dF2 with its negative eigenvalues set to zero, (M, 9, 9) for F (M, 3, 3), m (M, 2).

        Analytic eigensystem in the singular frame F = U diag(s) V^T: three twists with mu + p s_k, three flips with
        mu - p s_k, and three scalings from a 3 x 3 matrix (p = lam (J - 1) - mu / J). The paper clamps the same
        eigenvalues after a numerical decomposition.
        """
        U, s, Vt = _signed_svd(F)
        values, vectors = _eigensystem(s, m[:, 0], m[:, 1])
        turned = np.einsum("mia,mkab,mbj->mkij", U, vectors, Vt).reshape(len(F), 9, 9)
        return np.einsum("mk,mki,mkj->mij", np.maximum(values, 0.0), turned, turned)


def _signed_svd(F: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """F = U diag(s) V^T with U and V rotations, so that an inverted F shows as a negative last s."""
    U, s, Vt = np.linalg.svd(F)
    flip_u, flip_v = np.linalg.det(U) < 0, np.linalg.det(Vt) < 0
    U[flip_u, :, 2] *= -1
    Vt[flip_v, 2, :] *= -1
    s[flip_u ^ flip_v, 2] *= -1
    return U, s, Vt


def _eigensystem(s: np.ndarray, mu: np.ndarray, lam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (M, 9) and unit eigenmatrices (M, 9, 3, 3) of d2psi/dF2 at F = diag(s)."""
    J = s.prod(axis=1)
    p, pp = lam * (J - 1) - mu / J, lam + mu / J**2
    a = np.stack([s[:, 1] * s[:, 2], s[:, 0] * s[:, 2], s[:, 0] * s[:, 1]], axis=1)
    A = pp[:, None, None] * a[:, :, None] * a[:, None, :] + mu[:, None, None] * np.eye(3)
    values, vectors = np.zeros((len(s), 9)), np.zeros((len(s), 9, 3, 3))
    for n, (i, j, k) in enumerate(((0, 1, 2), (0, 2, 1), (1, 2, 0))):
        A[:, i, j] += p * s[:, k]
        A[:, j, i] += p * s[:, k]
        values[:, n], values[:, 3 + n] = mu + p * s[:, k], mu - p * s[:, k]
        vectors[:, n, i, j], vectors[:, n, j, i] = 0.5**0.5, -(0.5**0.5)
        vectors[:, 3 + n, i, j] = vectors[:, 3 + n, j, i] = 0.5**0.5
    values[:, 6:], Q = np.linalg.eigh(A)
    vectors[:, 6:, range(3), range(3)] = np.swapaxes(Q, 1, 2)
    return values, vectors
