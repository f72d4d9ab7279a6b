"""The first seconds after the release of a beam take, as displacements from the pose in which it settled."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim.checks import require
from veo_ti.beam import BASE, GRAVITY, SETTLED, TIP, SettledTake, settled_take
from veo_ti.mocap import BeamTake, read_beam_take

LEAD = 0.05  # [s] shown before the release
WINDOW = 1.5  # [s] after it: by then the slowest take swings by a tenth of its first amplitude
PLANE = (0, 2)  # x and z: the loads and the straight beam lie in this plane


@dataclass(frozen=True, kw_only=True, eq=False)
class Release:
    """One take around its release: `w` is each tip marker's place relative to where it settled.

    Relative places are free of the 0.3 to 2 mm by which a marker's place on the beam is unknown.
    """

    settled: SettledTake
    time: np.ndarray  # (T,) [s], zero at the frame that the data call the release
    w: np.ndarray  # (T, 3, 3) [m], the base plate's motion taken off

    @property
    def name(self) -> str:
        """gravity_V2_a and so on."""
        return self.settled.name

    @property
    def kind(self) -> str:
        """The loading, shared by the repeats."""
        return self.settled.kind

    @property
    def label(self) -> str:
        """The name as it is read: gravity a."""
        return self.name.replace("_V2_", " ").replace("load52", "52 g")

    @property
    def load(self) -> float:
        """Weight at the tip [N]."""
        return self.settled.load

    @property
    def weight(self) -> float:
        """Mass that hangs at the tip [kg]."""
        return self.load / GRAVITY

    @property
    def tip(self) -> np.ndarray:
        """Mean height of the tip markers over the settled one, (T,) [m]."""
        return self.w[:, :, 2].mean(axis=1)


def release_of(name: str, take: BeamTake, *, window: float = WINDOW) -> Release:
    """The take from LEAD before its release to `window` [s] after it. Raises ValueError where it is shorter."""
    p, clock = take.markers.positions, take.markers.time
    time = clock - clock[take.release_frame]
    inside = (time > -LEAD - 1e-9) & (time < window + 1e-9)
    settling = bool(inside[-SETTLED:].any())
    require(not settling, "take", f"last {window + 1:.1f} s after the release", f"{time[-1]:.2f} s in {name}")
    u = p - p[-SETTLED:].mean(axis=0)
    w = u[:, TIP] - np.median(u[:, BASE], axis=1, keepdims=True)
    return Release(settled=settled_take(name, take), time=time[inside], w=w[inside])


def read_releases(folder: str | Path, *, window: float = WINDOW) -> dict[str, Release]:
    """The releases of a folder of beam_*.npz, by name. Raises ValueError where there is none or one is damaged."""
    paths = sorted(Path(folder).glob("beam_*.npz"))
    require(len(paths) > 0, "folder", "hold beam_*.npz takes", repr(str(folder)))
    names = [path.stem.removeprefix("beam_") for path in paths]
    return {n: release_of(n, read_beam_take(p), window=window) for n, p in zip(names, paths, strict=True)}


def split(releases: Mapping[str, Release]) -> tuple[list[Release], list[Release]]:
    """Takes to fit (those that end in _a, or all) and takes to predict."""
    fitted = [r for r in releases.values() if r.name.endswith("_a")] or list(releases.values())
    return fitted, [r for r in releases.values() if all(r is not f for f in fitted)]
