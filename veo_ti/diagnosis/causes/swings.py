"""What a large motion does that a small one about the rest shape does not: it swings slower, or takes other shapes."""

import math
from dataclasses import dataclass, replace

import numpy as np

from sim.dynamics import Damping, simulate
from sim.newton import NewtonOptions
from sim.terms.base import Term
from sim.terms.loads import AppliedForce
from sim.vibration import FINER, delay, finer, follow, lag
from veo_ti.diagnosis.scene import Scene

_STEP = 0.3  # [rad] of the slowest vibration that a step covers: its frequency comes out 0.4 % low
_FAST = 30.0  # [rad] between two frames, from which on the slowest vibration is seen by chance only
_FEW = 4  # of the slowest vibrations, over which Rayleigh's two terms keep a damping about the same
_SLOWER = np.exp(0.02 * np.arange(-40, 41))  # times the mass, with which small vibrations may be as slow as large ones
_ROUGH = NewtonOptions(tolerance=1e-5)
_AT_ONCE = 1e-3  # of a frame: how long a body without inertia takes to answer
_CREEPS = 3  # steps from frame to frame


@dataclass(frozen=True, kw_only=True, eq=False)
class Swings:
    """The full simulation against linear vibrations: those of `slower` times the mass come nearest; at the share of the
    mass that it was made with, `beyond` (T, N, 3) [m] is what they miss."""

    slower: float
    beyond: np.ndarray
    share: float

    @classmethod
    def of(cls, scene: Scene, share: float, ratios: np.ndarray, *, smooth: bool) -> "Swings | None":
        """Of the scene's object, starting at rest, with a share of its mass and vibrations of damping ratios (K,); None
        where that swings too fast to be seen, or a solve fails. smooth: how its loads go between frames."""
        modes, u = scene.vibrations, scene.y - scene.cloud.x
        apart = modes.omega[0] * float(np.diff(scene.time).max())
        if share <= (apart / _FAST) ** 2:
            return None
        omega = modes.omega / math.sqrt(share)
        y = _simulated(
            scene, smooth, mass=share * modes.mass, damping=_rayleigh(omega, ratios),
            substeps=math.ceil(apart / math.sqrt(share) / _STEP),
        )  # fmt: skip
        if y is None:
            return None
        p, reached = modes.coordinates(u), modes.coordinates(y - scene.cloud.x)
        linear = follow(omega / np.sqrt(_SLOWER)[:, None], ratios, p[:, None], scene.time, smooth=smooth)
        slower = float(_SLOWER[np.argmin(((linear - reached[:, None]) ** 2).sum(axis=(0, 2)))])
        late = lag(modes.omega, p, scene.time, inertia=slower * share, damping=ratios, smooth=smooth)
        return cls(slower=slower, beyond=y - scene.y - modes.motion(late), share=share)


@dataclass(frozen=True, kw_only=True, eq=False)
class Creep:
    """The full simulation of a drag without inertia: what the linear response misses, `beyond` (T, N, 3) [m], at the
    drag [N s/m4] that it was made with."""

    beyond: np.ndarray
    drag: float

    @classmethod
    def of(cls, scene: Scene, drag: float, *, smooth: bool) -> "Creep | None":
        """Of the scene's object, starting at rest, with loads smooth or linear between frames; None without drag, or
        where a solve fails."""
        if drag <= 0:
            return None
        modes, soon = scene.relaxations, _AT_ONCE * float(np.diff(scene.time).min())
        y = _simulated(scene, smooth, mass=drag * soon * modes.mass, damping=Damping(mass=1 / soon), substeps=_CREEPS)
        if y is None:
            return None
        p = modes.coordinates(scene.y - scene.cloud.x)
        late = delay(modes.omega, p, scene.time, drag=drag, smooth=smooth)
        return cls(beyond=y - scene.y - modes.motion(late), drag=drag)


def _simulated(scene: Scene, smooth: bool, *, mass: np.ndarray, damping: Damping, substeps: int) -> np.ndarray | None:
    """The full motion (T, N, 3) [m] at the frames, whose loads go on linearly or smoothly between them; None where a
    solve fails."""
    energy, time = scene.energy, scene.time
    if smooth:
        substeps, later = math.ceil(substeps / FINER), -(-np.arange(FINER * (len(time) - 1) + 1) // FINER)
        pairs = zip(energy.terms, energy.frames(later).terms, strict=True)
        energy = replace(energy.frames(later), terms=tuple(_read(old, new, time) for old, new in pairs))
        time = finer(time, time)[1]
    found = simulate(energy, time=time, mass=mass, start=scene.y[0], substeps=substeps, damping=damping, options=_ROUGH)
    return found.y[:: FINER if smooth else 1] if found.converged else None


def _read(term: Term, later: Term, time: np.ndarray) -> Term:
    """A load smoothly between frames; any other term is that of the later one."""
    loads = isinstance(term, AppliedForce) and len(term.force) == len(time)
    return replace(term, force=finer(term.force, time)[0]) if loads else later


def _rayleigh(omega: np.ndarray, ratios: np.ndarray) -> Damping:
    """`a + b omega^2 = 2 ratio omega` at the slowest vibration, where all are about as damped also at a faster one."""
    few = min(_FEW, len(omega)) - 1
    if few == 0 or ratios[few] < ratios[0]:
        return Damping(mass=2 * ratios[0] * omega[0])
    if ratios[few] > ratios[0]:
        return Damping(stiffness=2 * ratios[0] / omega[0])
    between = 2 * ratios[0] / (omega[0] + omega[few])
    return Damping(mass=between * omega[0] * omega[few], stiffness=between)
