"""Air jets that sweep over a body: where, how hard and when, at any time, and the forces they make."""

from dataclasses import dataclass, replace

import fem
import numpy as np
from skfem import MeshHex

DISTANCE = 0.3  # [m] of the nozzle from its target


@dataclass(frozen=True, kw_only=True, eq=False)
class Shot:
    """The jet at one moment: a Gaussian of pressure around its axis."""

    position: np.ndarray  # (3,) [m] of the nozzle
    direction: np.ndarray  # (3,)
    pressure: float  # [Pa] on the axis
    footprint: float  # [m]

    @property
    def force(self) -> float:
        """On a flat wall, 2 pi sigma^2 p0 [N]."""
        return 2 * np.pi * self.footprint**2 * self.pressure

    def pull(self, x: np.ndarray, area: np.ndarray) -> np.ndarray:
        """Forces p0 exp(-r^2 / 2 sigma^2) max(0, -A.d) d at points (M, 3) with outward area vectors (M, 3), in N."""
        d, arm = self.direction, x - self.position
        r2 = ((arm - (arm @ d)[:, None] * d) ** 2).sum(1)
        size = self.pressure * np.exp(-r2 / (2 * self.footprint**2)) * np.maximum(0, -area @ d)
        return size[:, None] * d


@dataclass(frozen=True, kw_only=True, eq=False)
class Sweep:
    """One pass of the jet from `start` to `end`; pressure (S,) [Pa] at even stations, times what `shape` lets through.

    `hump` rises and falls as sin^2; `held` rises in 30 % of the time, stays, and falls.
    """

    start: np.ndarray  # (3,) [m]
    end: np.ndarray  # (3,) [m]
    direction: np.ndarray  # (3,)
    pressure: np.ndarray
    shape: str
    begin: float  # [s]
    length: float  # [s]

    def target(self, phase: float) -> np.ndarray:
        """Where the axis passes, phase 0 to 1."""
        return self.start + phase * (self.end - self.start)

    def strength(self, phase: float) -> float:
        """Pressure [Pa]."""
        ramp = np.clip(min(phase, 1 - phase) / 0.3, 0, 1)
        envelope = np.sin(np.pi * phase) ** 2 if self.shape == "hump" else np.sin(np.pi / 2 * ramp) ** 2
        return float(envelope * np.interp(phase, np.linspace(0, 1, len(self.pressure)), self.pressure))


@dataclass(frozen=True, kw_only=True, eq=False)
class Program:
    """All sweeps, one after the other."""

    sweeps: tuple[Sweep, ...]
    footprint: float

    def at(self, t: float) -> Shot:
        """The jet at a time [s]; between sweeps it is off."""
        begun = [s for s in self.sweeps if s.begin <= t]
        sweep = begun[-1] if begun else self.sweeps[0]
        phase = float(np.clip((t - sweep.begin) / sweep.length, 0, 1))
        on = 0 < phase < 1
        return Shot(
            position=sweep.target(phase) - DISTANCE * sweep.direction, direction=sweep.direction,
            pressure=sweep.strength(phase) if on else 0.0, footprint=self.footprint,
        )  # fmt: skip

    def scaled(self, factor: float) -> "Program":
        """All pressures times a factor."""
        return replace(self, sweeps=tuple(replace(s, pressure=factor * s.pressure) for s in self.sweeps))

    def most(self, times: np.ndarray) -> float:
        """The largest pressure at the given times [Pa]."""
        return max(self.at(float(t)).pressure for t in times)


def lumped(mesh: MeshHex, shots: list[Shot]) -> np.ndarray:
    """The nominal forces of the shots shared among the vertices of a mesh, (T, vertices, 3) [N]."""
    seen = fem.hats(mesh)
    return np.stack([_lump(seen, shot) for shot in shots])


def _lump(seen: fem.Basis, shot: Shot) -> np.ndarray:
    if shot.pressure == 0:
        return np.zeros((seen.N, 3))
    return fem.surface_load(seen, shot.pull)


def volumes(mesh: MeshHex) -> np.ndarray:
    """The volume of a mesh shared among its vertices, (vertices,) [m3]."""
    return fem.volumes(fem.hats(mesh))
