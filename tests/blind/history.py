"""Materials that remember: what they were strained to, and when, changes what they answer (see `blind.laws.Part`)."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import erf

from blind.laws import AtOnce, Isotropic, Strain, Stress, geometric, green, wide


@dataclass(frozen=True, eq=False)
class Viscous:
    """A Maxwell branch S = 2 c q, q = E - E_v, tau E_v' = q: the standard linear solid beside an elastic part.

    For a strain linear over a step h, x = h/tau: `q <- e^-x q + a (E - E_before)`, a = (1 - e^-x)/x, exactly.
    """

    c: np.ndarray  # (E, Q) [Pa]
    tau: float  # [s]
    t: float = 0.0
    E: np.ndarray | float = 0.0  # at t
    q: np.ndarray | float = 0.0  # at t

    def _branch(self, F: np.ndarray, t: float) -> Strain:
        decay, a = _decay(t - self.t, self.tau)
        return Strain(a * self.c, np.broadcast_to(self.E - decay * np.asarray(self.q) / a, F.shape))

    def stress(self, F: np.ndarray, t: float) -> Stress:
        return self._branch(F, t).stress(F, t)

    def tangent(self, F: np.ndarray, t: float) -> np.ndarray:
        return self._branch(F, t).tangent(F, t)

    def after(self, F: np.ndarray, t: float) -> "Viscous":
        decay, a = _decay(t - self.t, self.tau)
        E = green(F)
        return replace(self, t=t, E=E, q=decay * np.asarray(self.q) + a * (E - self.E))


@dataclass(frozen=True, eq=False)
class Convolved:
    """Simo's branch: the overstress Q' + Q/tau = g S_e' follows the elastic shear stress S_e = mu (1 - C^-1).

    `Q <- e^-x Q + a g (S_e - S_before)` (Simo & Hughes, Computational Inelasticity, 10.3); a dead S in a step is
    the energy S : E.
    """

    elastic: Isotropic  # g times the shear part of the base
    tau: float  # [s]
    t: float = 0.0
    Q: np.ndarray | float = 0.0  # [Pa], at t
    S: np.ndarray | float = 0.0  # [Pa], g S_e at t

    def _dead(self, F: np.ndarray, t: float) -> tuple[float, np.ndarray]:
        decay, a = _decay(t - self.t, self.tau)
        return a, np.broadcast_to(decay * np.asarray(self.Q) - a * np.asarray(self.S), F.shape)

    def stress(self, F: np.ndarray, t: float) -> Stress:
        a, dead = self._dead(F, t)
        psi, P = self.elastic.stress(F, t)
        return a * psi + (dead * green(F)).sum((-1, -2)), a * P + F @ dead

    def tangent(self, F: np.ndarray, t: float) -> np.ndarray:
        a, dead = self._dead(F, t)
        return a * self.elastic.tangent(F, t) + geometric(dead)

    def after(self, F: np.ndarray, t: float) -> "Convolved":
        decay, a = _decay(t - self.t, self.tau)
        S = np.linalg.solve(F, self.elastic.stress(F, t)[1])
        return replace(self, t=t, S=S, Q=decay * np.asarray(self.Q) + a * (S - self.S))


def _decay(step: float, tau: float) -> tuple[float, float]:
    x = max(step / tau, 1e-12)
    return float(np.exp(-x)), float(-np.expm1(-x) / x)


@dataclass(frozen=True, eq=False)
class Damaged(AtOnce):
    """Mullins softening by damage (Simo 1987): the base times 1 - D, D = d w/(w + w0), w the largest psi so far.

    This part is the -D psi that joins the base.
    """

    base: Isotropic
    d: float
    w0: np.ndarray  # (E, Q) [J/m3]
    w: np.ndarray | float = 0.0

    @property
    def D(self) -> np.ndarray | float:
        """The damage done, 0 to d."""
        return self.d * self.w / (self.w + self.w0)

    def stress(self, F: np.ndarray, t: float) -> Stress:
        psi, P = self.base.stress(F, t)
        return -self.D * psi, -wide(self.D, 2) * P

    def tangent(self, F: np.ndarray, t: float) -> np.ndarray:
        return -wide(self.D, 4) * self.base.tangent(F, t)

    def after(self, F: np.ndarray, t: float) -> "Damaged":
        return replace(self, w=np.maximum(self.w, self.base.stress(F, t)[0]))


@dataclass(frozen=True, eq=False)
class SoonDone(Damaged):
    """Damage D = d (1 - exp(-w/w0)) (Miehe 1995)."""

    @property
    def D(self) -> np.ndarray | float:
        """The damage done, 0 to d."""
        return self.d * -np.expm1(-self.w / self.w0)


@dataclass(frozen=True, eq=False)
class Healed(AtOnce):
    """Mullins softening below the largest energy so far, and none at it: the base times 1 - D, D = d erf((w - psi)/m)
    (Ogden & Roxburgh 1999), w the largest psi so far.

    This part is the one that joins the base; its energy is the integral of -D over psi.
    """

    base: Isotropic
    d: float
    m: np.ndarray  # (E, Q) [J/m3]
    w: np.ndarray | float = 0.0

    def _below(self, psi: np.ndarray) -> np.ndarray:
        """How far below, in units of m."""
        return np.maximum(self.w - psi, 0) / self.m

    def stress(self, F: np.ndarray, t: float) -> Stress:
        psi, P = self.base.stress(F, t)
        x, most = self._below(psi), self.w / self.m
        energy = self.d * self.m * (_integrated_erf(x) - _integrated_erf(most))
        return energy, -wide(self.d * erf(x), 2) * P

    def tangent(self, F: np.ndarray, t: float) -> np.ndarray:
        psi, P = self.base.stress(F, t)
        x = self._below(psi)
        slope = self.d * 2 / np.sqrt(np.pi) / self.m * np.exp(-(x**2)) * (x > 0)
        PP = P[..., :, :, None, None] * P[..., None, None, :, :]
        return wide(slope, 4) * PP - wide(self.d * erf(x), 4) * self.base.tangent(F, t)

    def after(self, F: np.ndarray, t: float) -> "Healed":
        return replace(self, w=np.maximum(self.w, self.base.stress(F, t)[0]))


def _integrated_erf(x: np.ndarray) -> np.ndarray:
    return x * erf(x) + (np.exp(-(x**2)) - 1) / np.sqrt(np.pi)


@dataclass(frozen=True, eq=False)
class Set(AtOnce):
    """Permanent set: S -= 2 c s E*, E* the strain (all of it, or its deviator) when it was largest so far, less what
    yields."""

    c: np.ndarray  # (E, Q) [Pa]
    share: float
    deviatoric: bool
    least: float = 0.0  # size of the strain of which nothing stays
    largest: np.ndarray | float = 0.0
    kept: np.ndarray | float = 0.0

    def _dead(self, F: np.ndarray) -> np.ndarray:
        return -2 * wide(self.c, 2) * self.share * np.broadcast_to(self.kept, F.shape)

    def stress(self, F: np.ndarray, t: float) -> Stress:
        S = self._dead(F)
        return (S * green(F)).sum((-1, -2)), F @ S

    def tangent(self, F: np.ndarray, t: float) -> np.ndarray:
        return geometric(self._dead(F))

    def after(self, F: np.ndarray, t: float) -> "Set":
        E = green(F)
        size = np.linalg.norm(E, axis=(-2, -1))
        if self.deviatoric:
            E = E - wide(np.trace(E, axis1=-2, axis2=-1) / 3, 2) * np.eye(3)
        E = E * wide(np.maximum(1 - self.least / np.maximum(size, 1e-300), 0), 2)
        more = size > self.largest
        return replace(
            self, largest=np.maximum(size, self.largest),
            kept=np.where(wide(more, 2), E, np.broadcast_to(self.kept, E.shape)),
        )  # fmt: skip
