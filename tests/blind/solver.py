"""Equilibrium and motion of a body: modified Newton on the energy, one sparse factorisation kept while it serves."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from typing import Protocol

import numpy as np
from scipy.sparse import csc_matrix, diags_array
from scipy.sparse.linalg import SuperLU, splu

from blind.body import Body, nodal
from blind.laws import AtOnce, Part

TOLERANCE = 1e-6  # residual force relative to the internal and applied ones
FLOOR = 1e-9  # [N], far above rounding and far below any load
STEPS = 40
HALVINGS = 12
SLOW = 0.3  # a step that leaves more of the residual than this asks for a new factorisation
J_FLOOR = 0.05
CUTS = 3  # halvings of a time step that does not converge
FORCE_LOOPS, FORCE_CHANGE = 12, 1e-6  # for loads that depend on the deformation
AT_ONCE, SETTLED = 12, 1e-4  # for materials whose memory does

Response = tuple[float, np.ndarray, np.ndarray]


class Tie(Protocol):
    """Something that acts on every node by itself."""

    def respond(self, u: np.ndarray, t: float) -> Response:
        """Energy [J], its gradient (N, 3) [N] and the blocks of its second derivative (N, 3, 3) [N/m]."""

    def after(self, u: np.ndarray, t: float) -> "Tie":
        """What it is once u was reached at the time t."""


@dataclass(frozen=True, kw_only=True, eq=False)
class System:
    """What one body is made of, held by and loaded with; `march` solves it through time."""

    body: Body
    parts: tuple[Part, ...]
    force: Callable[[np.ndarray, float], np.ndarray]  # u (N, 3), t -> (N, 3) [N]
    ties: tuple[Tie, ...] = ()
    support: Callable[[float], np.ndarray] | None = None  # t -> rigid displacement (N, 3) that the fixed nodes make
    follows: bool = False  # whether the force depends on u
    factor: dict[str, SuperLU] = field(default_factory=dict)  # the last factorisation of this system

    def after(self, u: np.ndarray, t: float) -> "System":
        """The system once u was reached at t."""
        F = self.body.F(u)
        parts, ties = tuple(p.after(F, t) for p in self.parts), tuple(tie.after(u, t) for tie in self.ties)
        return replace(self, parts=parts, ties=ties)

    def at_once(self, u: np.ndarray, t: float) -> "System":
        """The same, but for what remembers that u was reached at once."""
        F = self.body.F(u)
        return replace(self, parts=tuple(p.after(F, t) if isinstance(p, AtOnce) else p for p in self.parts))

    def value(self, u: np.ndarray, t: float) -> tuple[float, np.ndarray]:
        """Energy [J] without the load and its gradient (N, 3) [N]; infinite where a cell is crushed."""
        F = self.body.F(u)
        if np.linalg.det(F).min() < J_FLOOR:
            return np.inf, np.zeros_like(u)
        found = [part.stress(F, t) for part in self.parts]
        P = sum(P for _, P in found) * self.body.weights[..., None, None]
        cells, points, shapes = self.body.gradients.shape[:3]
        G = self.body.gradients.transpose(0, 2, 1, 3).reshape(cells, shapes, points * 3)
        g = nodal(self.body, G @ P.transpose(0, 1, 3, 2).reshape(cells, points * 3, 3))
        tied = [tie.respond(u, t)[:2] for tie in self.ties]
        energy = sum(float((psi * self.body.weights).sum()) for psi, _ in found) + sum(e for e, _ in tied)
        return energy, g + sum(h for _, h in tied)

    def solver(self) -> SuperLU:
        """The kept factorisation; that of the rest shape where there is none yet."""
        if "lu" not in self.factor:
            _refactor(self, np.zeros_like(self.body.nodes), 0.0)
        return self.factor["lu"]

    def stiffness(self, u: np.ndarray, t: float) -> csc_matrix:
        """Second derivative of the energy among the free components."""
        body, F = self.body, self.body.F(u)
        A = sum(part.tangent(F, t) for part in self.parts) * body.weights[(..., *[None] * 4)]
        cells, points, shapes = body.gradients.shape[:3]
        G = body.gradients.transpose(0, 2, 1, 3).reshape(cells, shapes, points * 3)
        # K[a i, b k] = sum_q G_aj A_ijkl G_bl, first over l, then over q and j.
        AG = A.reshape(cells, points, 27, 3) @ body.gradients.transpose(0, 1, 3, 2)
        AG = AG.reshape(cells, points, 3, 3, 3, shapes).transpose(0, 2, 1, 3, 5, 4)  # e i q j b k
        K = G[:, None] @ AG.reshape(cells, 3, points * 3, shapes * 3)
        blocks = K.transpose(0, 2, 1, 3).reshape(-1)
        tied = sum((tie.respond(u, t)[2] for tie in self.ties), np.zeros((body.count, 3, 3)))
        return pattern_of(body).assemble(np.concatenate([blocks, tied.ravel()]))


@dataclass(frozen=True, eq=False)
class Pattern:
    """Where the cells' and the nodes' blocks go in the sparse matrix of the free components."""

    free: np.ndarray  # (n,) components
    slot: np.ndarray  # entry of the matrix that each block entry adds to, or the last, which is dropped
    rows: np.ndarray
    pointers: np.ndarray

    @classmethod
    def of(cls, body: Body) -> "Pattern":
        """Union of the cells' blocks and the nodes' own."""
        free = np.flatnonzero(~np.repeat(body.fixed, 3))
        n, number = len(free), np.full(3 * body.count, -1)
        number[free] = np.arange(n)
        cells = (3 * body.elements[..., None] + np.arange(3)).reshape(len(body.elements), -1)
        sets = (cells, np.arange(3 * body.count).reshape(-1, 3))
        row = np.concatenate([np.repeat(c[:, :, None], c.shape[1], axis=2).ravel() for c in sets])
        column = np.concatenate([np.repeat(c[:, None], c.shape[1], axis=1).ravel() for c in sets])
        row, column = number[row], number[column]
        key = np.where((row < 0) | (column < 0), n * n, column * n + row)
        keys, slot = np.unique(np.append(key, n * n), return_inverse=True)
        keys = keys[:-1]
        return cls(free, slot[:-1], keys % n, np.searchsorted(keys // n, np.arange(n + 1)))

    def assemble(self, values: np.ndarray) -> csc_matrix:
        """The matrix of block entries."""
        data = np.bincount(self.slot, values, minlength=len(self.rows) + 1)[:-1]
        return csc_matrix((data, self.rows, self.pointers), shape=(len(self.free),) * 2)


@lru_cache(maxsize=4)
def pattern_of(body: Body) -> Pattern:
    """The body's pattern, found once."""
    return Pattern.of(body)


def equilibrium(system: System, u: np.ndarray, t: float) -> np.ndarray:
    """Displacement (N, 3) [m] at which all forces balance at the time t, from a first guess with its fixed nodes set.

    Raises RuntimeError when it is not found.
    """
    for _ in range(FORCE_LOOPS):
        force = system.force(u, t)
        found = _newton(system, u, t, force)
        change, u = np.abs(found - u).max(), found
        if not system.follows or change <= FORCE_CHANGE * np.abs(u).max():
            return u
    raise RuntimeError(f"the load and the deformation it depends on still change by {change:.2g} m")


def _newton(system: System, u: np.ndarray, t: float, force: np.ndarray) -> np.ndarray:
    free, before = pattern_of(system.body).free, np.inf
    energy, g = system.value(u, t)
    for _ in range(STEPS):
        residual = (g - force).ravel()[free]
        size = float(np.linalg.norm(residual))
        if size <= TOLERANCE * (np.linalg.norm(g) + np.linalg.norm(force)) + FLOOR:
            return u
        if size > SLOW * before or "lu" not in system.factor:
            _refactor(system, u, t)
        before = size
        u, energy, g = _step(system, u, t, force, energy, residual)
    raise RuntimeError(f"Newton left a residual of {size:.3g} N")


def _step(
    system: System, u: np.ndarray, t: float, force: np.ndarray, energy: float, residual: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray]:
    """One step along the kept factorisation, halved until the potential energy does not grow."""
    free, step = pattern_of(system.body).free, np.zeros(u.size)
    step[free] = -system.factor["lu"].solve(residual)
    slope, step = float(residual @ step[free]), step.reshape(u.shape)
    rounding = 1e-12 * (abs(energy) + np.abs(force * u).sum()) + 1e-16
    for halving in range(HALVINGS):
        size = 0.5**halving
        trial = u + size * step
        found, g = system.value(trial, t)
        if found - energy - size * (force * step).sum() <= 1e-4 * size * slope + rounding:
            return trial, found, g
    raise RuntimeError("the line search found no step that lowers the energy")


def _refactor(system: System, u: np.ndarray, t: float) -> None:
    """Factorise the stiffness at u, made positive by a share of its diagonal where it is not."""
    K = system.stiffness(u, t)
    probe = np.random.default_rng(0).normal(size=K.shape[0])
    for share in (0.0, 0.05, 0.3, 1.0):
        shifted = (K + diags_array(share * np.abs(K.diagonal()))).tocsc() if share else K
        options = {"SymmetricMode": True}
        lu = splu(shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        # Symmetric elimination without pivoting keeps the signs of the eigenvalues in U's diagonal.
        if (lu.U.diagonal() > 0).all() and np.isfinite(lu.solve(probe)).all():
            system.factor["lu"] = lu
            return
    raise RuntimeError("the stiffness is not positive")


def march(system: System, times: np.ndarray, *, steps: int = 1, start: np.ndarray | None = None) -> np.ndarray:
    """Displacements (T, N, 3) [m] at increasing times (T,) [s] from a state of balance at the first, in so many steps.

    Raises RuntimeError where no equilibrium is found even in short steps.
    """
    u = np.zeros_like(system.body.nodes) if start is None else start
    system, out = system.after(u, float(times[0])), [u]
    for a, b in pairwise(times):
        for t, to in zip(*(np.linspace(a, b, steps + 1)[i : steps + i] for i in (0, 1)), strict=True):
            system, u = _advance(system, u, float(t), float(to), CUTS)
        out.append(u)
    return np.stack(out)


def _advance(system: System, u: np.ndarray, t: float, to: float, cuts: int) -> tuple[System, np.ndarray]:
    guess = u
    if system.support is not None:
        guess = np.where(system.body.fixed[:, None], system.support(to), u + system.support(to) - system.support(t))
    try:
        found = _settled(system, equilibrium(system, guess, to), to)
        return system.after(found, to), found
    except RuntimeError:
        if cuts == 0:
            raise
        system.factor.clear()
    middle, u = _advance(system, u, t, (t + to) / 2, cuts - 1)
    return _advance(middle, u, (t + to) / 2, to, cuts - 1)


def _settled(system: System, u: np.ndarray, t: float) -> np.ndarray:
    """The equilibrium under what its own deformation leaves in the material, from the one under what was left before.

    Where points take turns, the last one found: it is as good as the time step is short.
    """
    if not any(isinstance(part, AtOnce) for part in system.parts):
        return u
    for _ in range(AT_ONCE):
        before, u = u, equilibrium(system.at_once(u, t), u, t)
        if np.abs(u - before).max() <= SETTLED * np.abs(u).max():
            break
    return u
