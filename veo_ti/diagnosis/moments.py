"""Fingerprints: how the observed positions answer to every nuisance and every cause, accumulated to small matrices."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import compress
from typing import Any

import numpy as np

from sim.basis import Basis
from sim.evidence import Normal
from sim.lame import Lame
from sim.sensitivity import Past, parameter_forces, responses, responses_in_turn
from veo_ti.diagnosis.causes.base import Carried, Cause, Change
from veo_ti.diagnosis.columns import Direction, Known
from veo_ti.diagnosis.scene import Scene

# of one frame: columns (M, 3 n) at the n points seen, residuals (3 n,), spatial modes (n, S), cosines (R,)
_Frame = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, kw_only=True, eq=False)
class Fingerprints:
    """The columns themselves, X (M, 3 n) of the n points seen in each of some frames, and motions, each (M, N, 3): what
    the body does, whatever tracking makes of it; in single precision."""

    frames: np.ndarray
    columns: tuple[np.ndarray, ...]
    motions: tuple[np.ndarray, ...] = ()

    def first(self, rows: int) -> "Fingerprints":
        """The first columns only."""
        columns, motions = (tuple(X[:rows] for X in each) for each in (self.columns, self.motions))
        return Fingerprints(frames=self.frames, columns=columns, motions=motions)

    def normal(self, A: np.ndarray, residual: np.ndarray, seen: np.ndarray, at: np.ndarray) -> Normal:
        """The data linearised with these columns around unknowns `at` (M,) where they leave a residual (T, N, 3)."""
        b, c, count = np.zeros(len(at)), 0.0, 0
        for t, X in zip(self.frames, self.columns, strict=True):
            z = residual[t, seen[t]].ravel() + at @ X
            b += X @ z
            c += float(z @ z)
            count += len(z)
        return Normal(A=A, b=b, c=c, count=count)

    def parts(self, residual: np.ndarray, seen: np.ndarray, at: np.ndarray, blocks: int) -> list[Normal]:
        """The same for runs of frames apart, about equally many in each."""
        parts = []
        for some in np.array_split(np.arange(len(self.frames)), min(blocks, len(self.frames))):
            own = Fingerprints(frames=self.frames[some], columns=tuple(self.columns[i] for i in some))
            parts.append(own.normal(sum(X @ X.T for X in own.columns).astype(float), residual, seen, at))
        return parts


@dataclass(frozen=True, kw_only=True, eq=False)
class Moments:
    """Inner products over the observed coordinates, `normal`, of all columns with each other and with the residual.

    The columns are the nuisances (material coefficients, then discretisation), then all directions, then the smooth
    modes in which misfit is looked for. The residual z = r + sum a_k J_k is what the linearised model has to explain.
    """

    normal: Normal
    nuisances: int
    modes: int
    kept: Fingerprints


@dataclass(frozen=True, kw_only=True, eq=False)
class Along:
    """What goes along with every fingerprint where a cause is part of the model.

    companion: its change in force that is proportional to the material; carried: what tracking shows of a change of
    motion and material beyond that motion; remembered: what frames pass on to later ones.
    """

    companion: Callable[[Scene], Change] | None = None
    carried: Carried | None = None
    remembered: Sequence[Past] = ()

    @classmethod
    def with_cause(cls, cause: Cause | None, scene: Scene, theta: np.ndarray, place: Any) -> "Along":
        """Of a cause at theta (d,) in the scene that it is part of; nothing for none."""
        if cause is None:
            return cls()
        proportional = cause.companion(scene, theta, place) is not None
        return cls(
            companion=partial(cause.companion, theta=theta, place=place) if proportional else None,
            carried=cause.carried(scene, theta, place), remembered=cause.remembered(scene, theta, place),
        )  # fmt: skip


def moments(
    scene: Scene,
    basis: Basis,
    a: np.ndarray,
    extra: Sequence[Known | Direction],
    directions: Sequence[Direction],
    *,
    along: Along = Along(),
    residual: np.ndarray | None = None,
    modes: np.ndarray | None = None,
    keep: bool = False,
) -> Moments:
    """Solve for all fingerprints, frame by frame, and accumulate.

    a (K,): material coefficients; extra: further nuisances; along: what a cause makes of them all; residual (T, N, 3):
    default the scene's; modes (N, S): smooth in space, paired with cosines in time over the training frames; keep: the
    columns and motions too, but for those of the modes.
    """
    frames = np.flatnonzero(scene.train & (scene.target.seen.sum(axis=1) > 0))
    residual = scene.residual if residual is None else residual
    modes = np.zeros((scene.cloud.count, 0)) if modes is None else modes
    cosines, K, pushing = time_modes(len(frames)), len(a), [*extra, *directions]
    kept: list[np.ndarray] = []
    motions: list[np.ndarray] = []
    m = scene.energy.elastic.m
    ways = basis.directions(Lame(mu=m[:, 0], lam=m[:, 1]))
    forces_of = partial(_all_forces, scene, ways, along.companion, pushing)
    solved = answered_as_shown(scene, forces_of, frames, along, ways, motions if keep else None)

    def columns() -> Iterator[_Frame]:
        for n, S in enumerate(solved):
            t, index = frames[n], frames[n : n + 1]
            if pushing:
                S[K:] += np.stack([d.moves(scene, index)[0] for d in pushing])
            seen = scene.target.seen[t]
            X = S[:, seen].reshape(len(S), -1)
            if keep:
                kept.append(X.astype(np.float32))
            yield X, residual[t, seen].ravel() + a @ X[:K], modes[seen], cosines[n]

    normal = _summed(columns())
    prints = Fingerprints(frames=frames[: len(kept)], columns=tuple(kept), motions=tuple(motions))
    return Moments(
        normal=normal, nuisances=K + len(extra), modes=3 * modes.shape[1] * cosines.shape[1], kept=prints,
    )  # fmt: skip


def answered(
    scene: Scene, forces: Callable[[np.ndarray], Callable[[np.ndarray], np.ndarray]], frames: np.ndarray,
    remembered: Sequence[Past],
) -> Iterator[np.ndarray]:  # fmt: skip
    """The motions (M, N, 3) of the chosen frames under added forces: forces(frames) gives those of some of the frames,
    forces(frames)(index) (n, M, N, 3) [N]. What is remembered passes through all frames before them."""
    if not remembered:
        yield from responses(scene.energy.frames(frames), scene.y[frames], forces(frames))
        return
    every = np.arange(frames[-1] + 1)
    energy = scene.energy.frames(every)
    for t, S in enumerate(responses_in_turn(energy, scene.y[every], forces(every), remembered)):
        if t in frames:
            yield S


def answered_as_shown(
    scene: Scene, forces: Callable[[np.ndarray], Callable[[np.ndarray], np.ndarray]], frames: np.ndarray, along: Along,
    ways: np.ndarray, motions: list[np.ndarray] | None = None,
) -> Iterator[np.ndarray]:
    """The same as tracking shows them: what lags goes on through frames that were not chosen as well.

    ways (K, N, 2): changes of the material, to which the first motions belong; motions: a list that takes those of the
    body, whatever tracking makes of them.
    """
    every = frames if along.carried is None else np.arange(frames[-1] + 1)
    solved = answered(scene, forces, every, along.remembered)
    chosen = np.isin(every, frames)
    if motions is not None:
        solved = _noted(solved, motions, chosen)
    if along.carried is not None:
        solved = _carried(solved, ways, along.carried, every)
    yield from compress(solved, chosen)


def _noted(solved: Iterable[np.ndarray], motions: list[np.ndarray], chosen: np.ndarray) -> Iterator[np.ndarray]:
    """Frame by frame the same, copied before anyone adds to it."""
    for S, wanted in zip(solved, chosen, strict=True):
        if wanted:
            motions.append(S.astype(np.float32))
        yield S


def moments_of(
    kept: Fingerprints, a: np.ndarray, extra: int, residual: np.ndarray, seen: np.ndarray, modes: np.ndarray
) -> Moments:
    """The nuisances' first columns and the smooth modes against a residual, with fingerprints at hand.

    a (K,): material coefficients; extra: how many further nuisances follow them.
    """
    rows, cosines = len(a) + extra, time_modes(len(kept.frames))

    def columns() -> Iterator[_Frame]:
        for n, (t, own) in enumerate(zip(kept.frames, kept.columns, strict=True)):
            X = own[:rows].astype(float)
            yield X, residual[t, seen[t]].ravel() + a @ X[: len(a)], modes[seen[t]], cosines[n]

    normal = _summed(columns())
    return Moments(normal=normal, nuisances=rows, modes=3 * modes.shape[1] * cosines.shape[1], kept=kept)


def _summed(columns: Iterable[_Frame]) -> Normal:
    """The normal equations of columns that come frame by frame, and after them of the smooth modes: products of an
    axis, a spatial mode and a cosine, of which no column is made, since their inner products are products too."""
    own, across, smooth, count = 0.0, 0.0, 0.0, 0
    for X, z, modes, cosines in columns:
        every = np.concatenate([X, z[None]])  # the residual is one more column
        own = own + every @ every.T
        with_modes = (every @ np.kron(modes, np.eye(3))).reshape(len(every), -1, 3)
        across = across + np.einsum("msa,k->mask", with_modes, cosines)
        smooth = smooth + np.kron(modes.T @ modes, np.outer(cosines, cosines))
        count += len(z)
    across = across.reshape(len(own), -1)
    A = np.block([[own[:-1, :-1], across[:-1]], [across[:-1].T, np.kron(np.eye(3), smooth)]])
    return Normal(A=A, b=np.concatenate([own[:-1, -1], across[-1]]), c=float(own[-1, -1]), count=count)


def _carried(solved: Iterable[np.ndarray], ways: np.ndarray, on: Carried, frames: np.ndarray) -> Iterator[np.ndarray]:
    """The motions S (M, N, 3) of every frame as tracking shows them; the first are the material's, ways (K, N, 2)."""
    every, same = np.stack(list(solved)), np.zeros(ways.shape[1:])
    for k in np.flatnonzero(every.any(axis=(0, 2, 3))):
        every[:, k] += on(every[:, k], frames, ways[k] if k < len(ways) else same)
    yield from every


def _all_forces(
    scene: Scene,
    ways: np.ndarray,
    companion: Callable[[Scene], Change] | None,
    pushing: Sequence[Direction | Known],
    frames: np.ndarray,
) -> Callable[[np.ndarray], np.ndarray]:
    """What every direction pushes with in chosen training frames, (n, K + directions, N, 3)."""
    units = [np.tile(unit, (scene.cloud.count, 1)) for unit in np.eye(ways.shape[2])]
    alone = map(scene.energy.elastic.with_parameters, units)
    along = [companion(scene.of_material(own)).terms for own in alone] if companion else ()
    soft = parameter_forces(scene.energy, scene.y, ways, along)

    def forces(local: np.ndarray) -> np.ndarray:
        index = frames[local]
        return np.concatenate([soft(index), *(d.forces(scene, index)[:, None] for d in pushing)], axis=1)

    return forces


def time_modes(frames: int, most: int = 12) -> np.ndarray:
    """Cosines over the frames, (T, R), columns of unit mean square: constant, then ever faster."""
    t = (np.arange(frames) + 0.5) / frames
    modes = np.cos(np.pi * t[:, None] * np.arange(min(most, frames))[None])
    return modes / np.sqrt((modes**2).mean(axis=0))
