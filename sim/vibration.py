"""Free vibrations about the rest shape, and how they follow a slow motion that excites them."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import LinearOperator, eigsh

from sim.checks import as_array, require
from sim.direct import Layout
from sim.elastic import Elastic
from sim.energy import Energy
from sim.runtime import serial_blas

FINER = 4  # stretches between frames, in which a smooth course is followed
_SLIGHT = 1e-4  # of the spacing, by which a mode bends the rest shape


@dataclass(frozen=True, kw_only=True, eq=False)
class Vibrations:
    """The lowest modes of `K phi = omega^2 M phi`, with `phi^T M phi = 1`."""

    omega: np.ndarray  # (K,) [rad/s], ascending
    shapes: np.ndarray  # (K, N, 3) [kg^-1/2]
    mass: np.ndarray  # (N,) [kg]
    answers: Callable[[np.ndarray], np.ndarray]  # static ones (M, N, 3) [m] to forces (M, N, 3) [N]

    @classmethod
    def of(cls, energy: Energy, mass: np.ndarray, count: int = 24) -> "Vibrations":
        """The `count` lowest modes of the elastic energy's Hessian at rest, with lumped masses (N,) [kg]."""
        elastic = energy.elastic
        mass = as_array("mass", mass, (elastic.cloud.count,))
        require(bool((mass > 0).all()), "mass", "be positive at every point", mass.min())
        free = np.flatnonzero(np.repeat(~energy.fixed, 3))
        count = min(count, len(free) - 1)
        bare = Energy(elastic=elastic, terms=(), fixed=energy.fixed)
        blocks = bare.tangent(elastic.cloud.x[None]).assembled(slice(0, 1))[0]
        layout = Layout.of(elastic)
        weights = np.repeat(mass, 3)
        with serial_blas():
            factor = layout.factor(blocks)

            def solve(right: np.ndarray) -> np.ndarray:
                full = np.zeros((len(weights), *right.shape[1:]))
                full[free] = right
                return factor.solve(full)[free]

            def answers(forces: np.ndarray) -> np.ndarray:
                u = np.zeros_like(forces).reshape(len(forces), -1)
                u[:, free] = solve(forces.reshape(u.shape).T[free]).T
                return u.reshape(forces.shape)

            size = (len(free), len(free))
            stiffness = layout.matrix(blocks)[free][:, free]
            values, vectors = eigsh(
                stiffness, k=count, M=sp.diags(weights[free]), sigma=0.0, v0=np.ones(len(free)),
                OPinv=LinearOperator(size, matvec=solve, dtype=float),
            )  # fmt: skip
        shapes = np.zeros((count, len(weights)))
        shapes[:, free] = vectors.T
        return cls(omega=np.sqrt(values), shapes=shapes.reshape(count, -1, 3), mass=mass, answers=answers)

    def coordinates(self, displacement: np.ndarray) -> np.ndarray:
        """`phi^T M u` of a motion u (T, N, 3) [m], (T, K)."""
        return np.einsum("kna,n,tna->tk", self.shapes, self.mass, displacement, optimize=True)

    def motion(self, coordinates: np.ndarray) -> np.ndarray:
        """The motion (T, N, 3) [m] of modal coordinates (T, K)."""
        return np.einsum("tk,kna->tna", coordinates, self.shapes, optimize=True)

    def changed(self, elastic: Elastic, change: np.ndarray, some: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`phi_k^T dK phi_l` (n, K) [s^-2] of some modes k (n,) under a small change of the elastic parameters (N, P),
        and `-K^-1 dK phi_k` but for what lies among the modes, (n, N, 3) [kg^-1/2], both to first order.

        dK phi is the gradient's slope along phi at rest. On the diagonal the first is `2 omega d omega`; the others say
        how much of each mode joins another one. The second is what joins it of the modes that are not among them, as if
        those were far faster.
        """
        shapes = self.shapes[some]
        step = _SLIGHT * elastic.cloud.spacing / np.abs(shapes).max()
        softer = elastic.with_parameters(change)
        ahead, behind = (softer.gradient(elastic.cloud.x + s * step * shapes) for s in (1, -1))
        pushed = (ahead - behind) / (2 * step)
        outward = -self.answers(pushed)
        outward -= self.motion(self.coordinates(outward))
        return np.einsum("kna,lna->kl", pushed, self.shapes, optimize=True), outward


def finer(p: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A course p (T, ...) at times (T,) read smoothly at `FINER` times as many, the first of each with a frame.

    By a cubic spline, which is linear in p.
    """
    at = np.interp(np.arange(FINER * (len(time) - 1) + 1) / FINER, np.arange(len(time)), time)
    return CubicSpline(time, p, axis=0)(at), at


def lag(
    omega: np.ndarray, p: np.ndarray, time: np.ndarray, *, inertia: float, damping: float | np.ndarray,
    smooth: bool = False,
) -> np.ndarray:  # fmt: skip
    """What inertia adds to the coordinates p (T, K) of a quasi-static motion that starts at rest, (T, K).

    Every mode obeys `s x'' + 2 zeta sqrt(s) omega x' + omega^2 (x - p) = 0` with the share s = `inertia` of the mass,
    the damping ratio zeta, one for all or one a mode, and p linear or `smooth` between frames (see `finer`); x - p is
    returned. Exact in time, linear about the rest shape and in p. No mass, no lag. Other shapes as in `follow`.
    """
    if not inertia > 0:
        return np.zeros_like(omega * p)
    return follow(omega / np.sqrt(inertia), damping, p, time, smooth=smooth) - p


def delay(omega: np.ndarray, p: np.ndarray, time: np.ndarray, *, drag: float, smooth: bool = False) -> np.ndarray:
    """What a drag `-drag m_i v_i` adds to the coordinates p (T, K) of a quasi-static motion, (T, K).

    drag [N s/m per unit of `mass`]: every mode relaxes, `drag x' + omega^2 (x - p) = 0`, without inertia.
    """
    if not drag > 0:
        return np.zeros_like(omega * p)
    return relax(omega**2 / drag, p, time, smooth=smooth) - p


def relax(rate: np.ndarray, p: np.ndarray, time: np.ndarray, *, smooth: bool = False) -> np.ndarray:
    """`x' = rate (p - x)`, rate [1/s], at rest at the first frame, (T, K); p (T, K) linear between times (T,) [s].

    smooth: p is read by `finer` in between.
    """
    if smooth and len(time) > 1:
        return relax(rate, *finer(p, time))[::FINER]
    x = np.empty_like(rate * p)
    x[0] = p[0]
    for t, h in enumerate(np.diff(time)):
        behind = (p[t + 1] - p[t]) / h / rate
        x[t + 1] = p[t + 1] - behind + np.exp(-rate * h) * (x[t] - p[t] + behind)
    return x


def follow(
    omega: np.ndarray, zeta: float | np.ndarray, p: np.ndarray, time: np.ndarray, *, smooth: bool = False
) -> np.ndarray:
    """Damped oscillators `x'' + 2 zeta omega x' + omega^2 (x - p) = 0`, at rest at the first frame, (T, K).

    p (T, K) is linear between the times (T,) [s], so each stretch has the closed form `x = p - 2 zeta/omega p' + e`
    with e a free vibration. With frequencies (C, K) and p (T, 1, K) all C are followed at once, (T, C, K). smooth: p
    is read by `finer` in between.
    """
    if smooth and len(time) > 1:
        return follow(omega, zeta, *finer(p, time))[::FINER]
    # The double root of critical damping has another form.
    zeta = np.where(np.abs(np.subtract(zeta, 1)) < 1e-6, 1 + 1e-6, zeta)
    root = np.sqrt((zeta**2 - 1).astype(complex))
    fast, slow = omega * (-zeta - root), omega * (-zeta + root)
    x, v = np.zeros((len(p), *np.broadcast_shapes(p.shape[1:], np.shape(omega)))), np.zeros_like(omega)
    x[0] = p[0]
    for t, h in enumerate(np.diff(time)):
        slope = (p[t + 1] - p[t]) / h
        e, de = x[t] - p[t] + 2 * zeta / omega * slope, v - slope
        grow, decay = np.exp(slow * h), np.exp(fast * h)
        gap = slow - fast
        end = (slow * decay - fast * grow) / gap * e + (grow - decay) / gap * de
        speed = slow * fast * (decay - grow) / gap * e + (slow * grow - fast * decay) / gap * de
        x[t + 1] = p[t + 1] - 2 * zeta / omega * slope + end.real
        v = slope + speed.real
    return x
