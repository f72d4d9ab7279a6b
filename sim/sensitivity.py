"""How the equilibrium answers to changes: forward sensitivities, one factorisation per frame, many right sides."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np
from scipy.sparse.linalg import SuperLU

from sim.direct import DirectFactors, Layout, solve_directly
from sim.energy import Energy
from sim.fixed_point import MixingOptions, fixed_point
from sim.multifrontal import Cholesky
from sim.runtime import serial_blas

_HELD = 8  # factors at once
_OWN = 8  # rounds at most in which a frame answers to its own change, until it is as
_CLOSE = 1e-3  # close, of its largest change
_AT_ONCE = 12_000  # points of all frames whose right sides are held together
_ROUNDED = 1e-13  # of mu h^2: forces that come of rounding alone


class Past(Protocol):
    """What frames pass on: how changes of their motion push in those after them. Asked of every frame in order."""

    def force(self, frame: int) -> np.ndarray:
        """Of the frames before on this one, (K, N, 3) [N]."""

    def acts(self, frame: int) -> bool:
        """Whether the frame's own change acts on itself beyond its Hessian."""

    def own(self, frame: int, change: np.ndarray) -> np.ndarray:
        """So much, of a change (K, N, 3) [m], (K, N, 3) [N]; asked where it acts."""

    def keep(self, frame: int, change: np.ndarray) -> None:
        """The frame moves by `change` (K, N, 3) [m]."""


def responses(energy: Energy, y: np.ndarray, forces: Callable[[np.ndarray], np.ndarray]) -> Iterator[np.ndarray]:
    """dy of every frame in turn, (K, N, 3) [m], under K small added forces: `H^-1 f` with the exact Hessian at y, to
    three digits or more (`solve_directly`).

    forces(index) gives (len(index), K, N, 3) [N] for the frames `index`; it is asked for a few frames at a time.
    """
    elastic, layout = energy.elastic, Layout.of(energy.elastic)
    least = _ROUNDED * elastic.m[:, 0].mean() * elastic.cloud.spacing**2
    chunk = max(_AT_ONCE // elastic.cloud.count, 2)
    for first in range(0, len(y), chunk):
        index = np.arange(first, min(first + chunk, len(y)))
        right = forces(index)
        right[:, :, energy.fixed] = 0.0
        pushed = np.abs(right).max(axis=(1, 2, 3)) > least  # a frame at rest tells nothing of a stiffness
        if pushed.any():
            tangent = energy.frames(index[pushed]).tangent(y[index[pushed]])
            right[pushed] = solve_directly(tangent, layout, right[pushed])
        right[~pushed] = 0.0
        yield from right


def responses_in_turn(
    energy: Energy, y: np.ndarray, forces: Callable[[np.ndarray], np.ndarray], pasts: Sequence[Past]
) -> Iterator[np.ndarray]:
    """`responses` where each frame also answers to what those before it pass on."""
    layout = Layout.of(energy.elastic)
    for first in range(0, len(y), _HELD):
        index = np.arange(first, min(first + _HELD, len(y)))
        right, held = forces(index), DirectFactors.of(energy.frames(index).tangent(y[index]), layout)
        yield from answers_in_turn(energy, held, right, pasts, first=first)


def answers_in_turn(
    energy: Energy, factors: DirectFactors, right: np.ndarray, pasts: Sequence[Past], *, first: int = 0
) -> Iterator[np.ndarray]:
    """The same with factors at hand, of frames from `first` on, for the forces right (n, K, N, 3) [N]."""
    for t, (own, factor) in enumerate(zip(right, factors.factors, strict=True), start=first):
        pushed = energy.free(own + sum(past.force(t) for past in pasts))
        moved = _moved(energy, factor, pushed, [partial(past.own, t) for past in pasts if past.acts(t)])
        for past in pasts:
            past.keep(t, moved)
        yield moved


def _moved(
    energy: Energy, factor: Cholesky | SuperLU, pushed: np.ndarray, acting: Sequence[Callable[[np.ndarray], np.ndarray]]
) -> np.ndarray:
    """H^-1 of what pushes (K, N, 3) [N] and of the forces that the answer itself leads to."""
    moved = _solved(factor, pushed)
    if not acting:
        return moved

    size = np.abs(moved).max(axis=(1, 2), keepdims=True) + 1e-300

    def again(x: np.ndarray) -> np.ndarray:
        return _solved(factor, energy.free(pushed + sum(force(size * x) for force in acting))) / size

    return size * fixed_point(again, moved / size, MixingOptions(tolerance=_CLOSE, iterations=_OWN, memory=3)).x


def _solved(factor: Cholesky | SuperLU, right: np.ndarray) -> np.ndarray:
    with serial_blas():
        return factor.solve(np.asfortranarray(right.reshape(len(right), -1).T)).T.reshape(right.shape)


def parameter_forces(
    energy: Energy, y: np.ndarray, directions: np.ndarray, also: Sequence[Sequence[Any]] = ()
) -> Callable[[np.ndarray], np.ndarray]:
    """The forces that parameter changes dm/da = directions (K, N, P) act like at y: `-d(dE/dy)/dm : directions`.

    The law is linear in its parameters, so they are what each stencil pulls with for a unit of a parameter, times the
    change there. also[p]: terms that are in proportion to the parameter p of each point, for a unit of it.
    """
    stencil, units = energy.elastic.stencil, np.eye(directions.shape[2])
    alone = [energy.elastic.with_parameters(np.tile(unit, (energy.elastic.cloud.count, 1))) for unit in units]

    def forces(index: np.ndarray) -> np.ndarray:
        out = np.zeros((len(index), *directions.shape[:2], 3))
        for p, own in enumerate(alone):
            more = (term.frames(index).each(y[index]) for term in (also[p] if also else ()))
            for n, each in enumerate(sum(more, own.each(y[index]))):
                out[n] -= stencil.gathered(each, directions[:, :, p])
        return out

    return forces


def sensitivities(
    energy: Energy, y: np.ndarray, directions: np.ndarray, *, more: np.ndarray | None = None
) -> Iterator[np.ndarray]:
    """dy/da of every frame in turn, (K, N, 3), for parameter changes dm/da = directions (K, N, P).

    more (T, L, N, 3) [N]: forces whose answers follow those, (K + L, N, 3).
    """
    own = parameter_forces(energy, y, directions)
    both = own if more is None else lambda index: np.concatenate([own(index), more[index]], axis=1)
    return responses(energy, y, both)
