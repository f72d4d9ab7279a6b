"""Energy densities [J/m3] of the hidden materials with their first and second derivatives, added up part by part.

Every part answers `stress(F, t)` with psi (E, Q) and P = dpsi/dF (E, Q, 3, 3) at a time [s], `tangent(F, t)` with
A = dP/dF (E, Q, 3, 3, 3, 3), and `after(F, t)` with itself once F was reached at t.
Letters: I1 = tr F^T F, J = det F, H = F^-T.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

Derivatives = tuple[np.ndarray, ...]  # psi, psi_1, psi_J, psi_11, psi_1J, psi_JJ of psi(I1, J)
Stress = tuple[np.ndarray, np.ndarray]


class Part(Protocol):
    """One addend of the energy density."""

    def stress(self, F: np.ndarray, t: float) -> Stress:
        """psi and P at the deformation gradients F (E, Q, 3, 3)."""

    def tangent(self, F: np.ndarray, t: float) -> np.ndarray:
        """A at F."""

    def after(self, F: np.ndarray, t: float) -> "Part":
        """What it is once F was reached at the time t."""


class AtOnce:
    """A part that answers as what was reached just now left it: a step is repeated until it is."""


@dataclass(frozen=True, eq=False)
class Isotropic:
    """psi(I1, J): P = 2 psi_1 F + psi_J J H; A from the second derivatives."""

    density: Callable[[np.ndarray, np.ndarray, float], Derivatives]

    def stress(self, F: np.ndarray, t: float) -> Stress:
        J, H = np.linalg.det(F), np.linalg.inv(F).swapaxes(-1, -2)
        psi, d1, dJ = self.density((F * F).sum((-1, -2)), J, t)[:3]
        return psi, wide(2 * d1, 2) * F + wide(dJ * J, 2) * H

    def tangent(self, F: np.ndarray, t: float) -> np.ndarray:
        J, H = np.linalg.det(F), np.linalg.inv(F).swapaxes(-1, -2)
        d1, dJ, d11, d1J, dJJ = self.density((F * F).sum((-1, -2)), J, t)[1:]
        A = wide(2 * d1, 4) * _IDENTITY - wide(dJ * J, 4) * np.einsum("eqil,eqkj->eqijkl", H, H)
        A += wide(4 * d11, 4) * _outer(F, F) + wide(dJJ * J**2 + dJ * J, 4) * _outer(H, H)
        return A + wide(2 * d1J * J, 4) * (_outer(F, H) + _outer(H, F)) if d1J.any() else A

    def after(self, F: np.ndarray, t: float) -> "Isotropic":
        return self


@dataclass(frozen=True, eq=False)
class Fibre:
    """psi(I4), I4 = |F a|^2 of unit vectors a: P = 2 psi_4 F a (x) a."""

    axis: np.ndarray  # (3,)
    density: Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray, np.ndarray]]  # psi, psi_4, psi_44

    def stress(self, F: np.ndarray, t: float) -> Stress:
        Fa = F @ self.axis
        psi, d4, _ = self.density((Fa * Fa).sum(-1), t)
        return psi, wide(2 * d4, 2) * Fa[..., None] * self.axis

    def tangent(self, F: np.ndarray, t: float) -> np.ndarray:
        a, Fa = self.axis, F @ self.axis
        _, d4, d44 = self.density((Fa * Fa).sum(-1), t)
        W = Fa[..., None] * a
        return np.einsum("eq,ik,j,l->eqijkl", 2 * d4, np.eye(3), a, a) + wide(4 * d44, 4) * _outer(W, W)

    def after(self, F: np.ndarray, t: float) -> "Fibre":
        return self


@dataclass(frozen=True, eq=False)
class Strain:
    """psi = c |E - A|^2 - c |A|^2 with E = (F^T F - 1)/2, c [Pa] and an unstressed strain A: S = 2 c (E - A)."""

    c: np.ndarray  # (E, Q) [Pa]
    A: np.ndarray  # (E, Q, 3, 3)

    def stress(self, F: np.ndarray, t: float) -> Stress:
        E = green(F)
        psi = self.c * ((E - self.A) ** 2 - self.A**2).sum((-1, -2))
        return psi, F @ (wide(2 * self.c, 2) * (E - self.A))

    def tangent(self, F: np.ndarray, t: float) -> np.ndarray:
        S = wide(2 * self.c, 2) * (green(F) - self.A)
        K = np.einsum("eqil,eqkj->eqijkl", F, F) + np.einsum("eqim,eqkm,jl->eqijkl", F, F, np.eye(3))
        return geometric(S) + wide(self.c, 4) * K

    def after(self, F: np.ndarray, t: float) -> "Strain":
        return self


@dataclass(frozen=True, eq=False)
class Scaled:
    """Another part times a factor (E, Q) that may change with time but not with F."""

    part: Part
    factor: Callable[[float], np.ndarray]

    def stress(self, F: np.ndarray, t: float) -> Stress:
        k, (psi, P) = self.factor(t), self.part.stress(F, t)
        return k * psi, wide(k, 2) * P

    def tangent(self, F: np.ndarray, t: float) -> np.ndarray:
        return wide(self.factor(t), 4) * self.part.tangent(F, t)

    def after(self, F: np.ndarray, t: float) -> "Scaled":
        return replace(self, part=self.part.after(F, t))


def neo_hookean(mu: np.ndarray, lam: np.ndarray) -> Isotropic:
    """psi = mu/2 (I1 - 3) - mu log J + lam/2 (J - 1)^2, mu and lam (E, Q) [Pa]."""

    def density(I1: np.ndarray, J: np.ndarray, t: float) -> Derivatives:
        zero = np.zeros_like(J)
        psi = mu / 2 * (I1 - 3) - mu * np.log(J) + lam / 2 * (J - 1) ** 2
        return psi, mu / 2 + zero, lam * (J - 1) - mu / J, zero, zero, lam + mu / J**2

    return Isotropic(density)


def yeoh(c: np.ndarray) -> Isotropic:
    """psi = c (I - 3)^2 of what changes shape alone, I = I1 J^(-2/3), c (E, Q) [Pa] (Yeoh 1990, second term).

    With I1 itself, which a little less volume lowers, a large c would forbid a change of I1 in place of one of J, and
    hardly stiffen anything.
    """

    def density(I1: np.ndarray, J: np.ndarray, t: float) -> Derivatives:
        x = isochoric(I1, J) - 3
        return _of_shape(c * x**2, 2 * c * x, 2 * c, I1, J)

    return Isotropic(density)


def gent(mu: np.ndarray, limit: float) -> Isotropic:
    """What Gent's law adds to mu/2 (I - 3), I = I1 J^(-2/3): psi = -mu/2 (J_m ln(1 - x) + I - 3), x = (I - 3)/J_m
    (Gent 1996).

    Beyond the limit J_m it is continued by its parabola at x = 0.95, so that Newton's steps may try anything.
    """

    def density(I1: np.ndarray, J: np.ndarray, t: float) -> Derivatives:
        full = (isochoric(I1, J) - 3) / limit
        x = np.minimum(full, 0.95)
        over = limit * (full - x)
        d11 = mu / 2 / (limit * (1 - x) ** 2)
        d1 = mu / 2 * (1 / (1 - x) - 1)
        psi = -mu / 2 * limit * (np.log1p(-x) + x) + d1 * over + d11 / 2 * over**2
        return _of_shape(psi, d1 + d11 * over, d11, I1, J)

    return Isotropic(density)


def fung(mu: np.ndarray, b: float) -> Isotropic:
    """What mu/(2b) (exp(b (I - 3)) - 1) adds to mu/2 (I - 3), I = I1 J^(-2/3) (Fung 1967; Demiray 1972).

    Beyond b (I - 3) = 3 it is continued by its parabola, so that Newton's steps may try anything.
    """

    def density(I1: np.ndarray, J: np.ndarray, t: float) -> Derivatives:
        full = isochoric(I1, J) - 3
        x = np.minimum(full, 3 / b)
        over, grown = full - x, np.expm1(b * x)
        d1, d11 = mu / 2 * grown, mu * b / 2 * (1 + grown)
        psi = mu / 2 * (grown / b - x) + d1 * over + d11 / 2 * over**2
        return _of_shape(psi, d1 + d11 * over, d11, I1, J)

    return Isotropic(density)


def isochoric(I1: np.ndarray, J: np.ndarray) -> np.ndarray:
    """I = I1 J^(-2/3): I1 without the change of volume."""
    return I1 * J ** (-2 / 3)


def _of_shape(psi: np.ndarray, d: np.ndarray, dd: np.ndarray, I1: np.ndarray, J: np.ndarray) -> Derivatives:
    """From psi(I) with its derivatives d and dd, I = I1 J^(-2/3)."""
    a = J ** (-2 / 3)
    I_J = -2 / 3 * I1 * a / J
    return psi, d * a, d * I_J, dd * a**2, dd * a * I_J - 2 / 3 * d * a / J, dd * I_J**2 - 5 / 3 * d * I_J / J


def volumetric(k: np.ndarray, form: str) -> Isotropic:
    """What another volume law adds to k/2 (J - 1)^2: of `log` k/2 ln^2 J, of `simo` k/4 (J^2 - 1 - 2 ln J)."""

    def density(I1: np.ndarray, J: np.ndarray, t: float) -> Derivatives:
        zero, ln = np.zeros_like(J), np.log(J)
        new = (ln**2 / 2, ln / J, (1 - ln) / J**2) if form == "log" else (
            (J**2 - 1 - 2 * ln) / 4, (J - 1 / J) / 2, (1 + 1 / J**2) / 2)  # fmt: skip
        old = ((J - 1) ** 2 / 2, J - 1, 1.0)
        psi, dJ, dJJ = (k * (a - b) for a, b in zip(new, old, strict=True))
        return psi, zero, dJ, zero, zero, dJJ

    return Isotropic(density)


def green(F: np.ndarray) -> np.ndarray:
    """E = (F^T F - 1)/2."""
    return (F.swapaxes(-1, -2) @ F - np.eye(3)) / 2


def geometric(S: np.ndarray) -> np.ndarray:
    """The tangent of P = F S at a dead S (E, Q, 3, 3): delta_ik S_lj."""
    return np.einsum("ik,eqlj->eqijkl", np.eye(3), S)


def wide(values: np.ndarray, axes: int) -> np.ndarray:
    """Values (E, Q) with so many axes of length one behind."""
    return np.asarray(values)[(..., *[None] * axes)]


def _outer(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    return A[..., :, :, None, None] * B[..., None, None, :, :]


_IDENTITY = np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))
