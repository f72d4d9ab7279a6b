"""What was measured: points over time, the forces that moved them, and where the points are held."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from recon.files import replacing
from sim.checks import as_array, require
from sim.terms.jet import Jet
from veo_ti.observation_checks import check_amounts, check_holding, check_loads, check_motion
from veo_ti.observation_files import JET_KEYS, NATIVE, OPTIONAL, REQUIRED, keys_sequence, read_keys
from veo_ti.store import writable_folder, write_sequence

BLOCKS = 4  # most blocks that `split` holds out


@dataclass(frozen=True, kw_only=True, eq=False)
class Observation:
    """A measured sequence; frame 0 is the reference pose under no external load but gravity.

    A point that tracking lost (observed False) may hold NaN: it is put at its frame-0 position and must not count.
    forces may be None where the jet is given. Raises ValueError for a wrong shape or a NaN; `check` tests the rest.
    """

    points: np.ndarray  # (T, N, 3) [m]
    forces: np.ndarray | None = None  # (T, N, 3) [N]
    time: np.ndarray  # (T,) [s]
    fixed: np.ndarray  # (N,) bool, held in place
    surface: np.ndarray | None = None  # (N,) bool, on the surface; default all
    volume: np.ndarray | None = None  # (N,) [m3]
    mass: float | None = None  # [kg]
    gravity: np.ndarray | None = None  # (3,) [m/s2]; default zeros
    up: np.ndarray | None = None  # (3,) in pictures; default against gravity, z where there is none
    handles: np.ndarray | None = None  # (N,) bool, led by strings; default none
    observed: np.ndarray | None = None  # (T, N) bool; default all
    sigma: float | np.ndarray | None = None  # () or (T, N) [m], known noise
    jet: Jet | None = None
    force_scale_known: bool = True
    held_out: np.ndarray | None = None  # (T,) bool, frames the measurement itself keeps for validation
    name: str = ""

    def __post_init__(self) -> None:
        frames, points = _frames_and_points(self.points)
        self._set("time", (frames,))
        self._set("fixed", (points,), bool)
        self._set("surface", (points,), bool, default=np.ones(points, bool))
        self._set("handles", (points,), bool, default=np.zeros(points, bool))
        self._set("observed", (frames, points), bool, default=np.ones((frames, points), bool))
        object.__setattr__(self, "points", _filled(self.points, self.observed))
        self._set("forces", (frames, points, 3))
        self._set("volume", (points,))
        self._set("mass", ())
        self._set("gravity", (3,), default=np.zeros(3))
        self._set("up", (3,), default=-self.gravity if self.gravity.any() else np.array([0.0, 0.0, 1.0]))
        self._set("sigma", (frames, points) if np.ndim(self.sigma) else ())
        self._set("held_out", (frames,), bool)
        known = as_array("force_scale_known", np.ravel(self.force_scale_known), (1,), bool)
        object.__setattr__(self, "force_scale_known", bool(known[0]))
        object.__setattr__(self, "jet", _sound_jet(self.jet, frames))

    def _set(self, name: str, shape: tuple[int, ...], dtype: type = float, default: np.ndarray | None = None) -> None:
        given = getattr(self, name)
        given = default if given is None else given
        if given is not None:
            value = as_array(name, given, shape, dtype) if shape else float(as_array(name, np.ravel(given), (1,))[0])
            object.__setattr__(self, name, value)

    @staticmethod
    def load(path: str | Path) -> "Observation":
        """Read an .npz of the observation format, a .vtkhdf, a PLUSH object folder, or the word "example".

        Raises ValueError in one sentence for anything that is not a sound measurement.
        """
        return _from_keys(read_keys(path)).check()

    def check(self) -> "Observation":
        """This observation, if it can serve as a measurement; else raises ValueError in one sentence.

        Not part of the constructor because a subset of frames need not hold the reference pose.
        """
        check_motion(self.points, self.time)
        pushed = self.forces is None or bool(self.forces.any())
        check_holding(self.fixed, self.handles, self.surface, pushed)
        check_loads(self.forces, None if self.jet is None else self.jet.force, self.gravity, self.handles)
        require(self.up.any(), "up", "have a length", self.up)
        check_amounts(self.volume, self.mass, self.sigma)
        return self

    def save(self, path: str | Path) -> Path:
        """Write .vtkhdf (everything) or .npz (the observation format); raises ValueError for what .npz cannot hold."""
        path = Path(path)
        if path.suffix == ".vtkhdf":
            return write_sequence(path, keys_sequence(_to_keys(self)))
        require(path.suffix == ".npz", "path", "end in .npz or .vtkhdf", repr(path.name))
        require(self.held_out is None, "path", "end in .vtkhdf to keep held-out frames", repr(path.name))
        writable_folder(path.parent)
        with replacing(path) as partial:
            np.savez_compressed(partial, **{n: value for n, value in _to_keys(self).items() if n not in NATIVE})
        return path

    def frames(self, index: object) -> "Observation":
        """The chosen frames (indices, slice or mask), in that order; raises ValueError for a frame there is not."""
        try:
            chosen = np.atleast_1d(np.arange(len(self.time))[index])
        except IndexError as error:
            raise ValueError(f"index must choose among {len(self.time)} frames; got {index!r} ({error})") from None
        changing = ("points", "forces", "time", "observed", "held_out", "sigma")
        names = [name for name in changing if np.ndim(getattr(self, name))]
        jet = None if self.jet is None else self.jet.frames(chosen)
        return replace(self, **{name: getattr(self, name)[chosen] for name in names}, jet=jet)

    def split(self, every: int = 4) -> tuple[np.ndarray, np.ndarray]:
        """Frame indices to train on and to hold out: about 1/every of the frames, in up to 4 contiguous blocks.

        Blocks, since neighbours in time are near copies of each other; frame 0 always trains. Where the measurement
        names its own `held_out` frames, those are held out instead. Raises ValueError for every < 2.
        """
        require(every >= 2, "every", "be at least 2", every)
        held = _blocks(len(self.time), every) if self.held_out is None else self.held_out.copy()
        held[0] = False
        return np.flatnonzero(~held), np.flatnonzero(held)


def _blocks(frames: int, every: int) -> np.ndarray:
    held, loaded = np.zeros(frames, bool), frames - 1
    wanted = max(round(loaded / every), min(1, loaded - 1))
    blocks = min(BLOCKS, wanted)
    for b in range(blocks):
        size = wanted * (b + 1) // blocks - wanted * b // blocks
        start = 1 + round((2 * b + 1) * loaded / (2 * blocks) - size / 2)  # the middle of the b-th part
        held[start : start + size] = True
    return held


def _frames_and_points(points: object) -> tuple[int, int]:
    shape = np.shape(points)
    fits = len(shape) == 3 and shape[2] == 3 and shape[0] > 0 and shape[1] > 0
    require(fits, "points", "have shape (frames, points, 3)", shape)
    return shape[0], shape[1]


def _filled(points: object, observed: np.ndarray) -> np.ndarray:
    try:
        array = np.array(points, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"points must be an array of numbers; got {np.asarray(points).dtype}") from None
    reference = as_array("points[0]", array[0], (None, 3))
    lost = ~np.isfinite(array).all(axis=-1)
    blind = np.argwhere(lost & observed)
    where = f"{len(blind)} NaN or infinite points, the first at frame, point {tuple(blind[:1].ravel().tolist())}"
    require(len(blind) == 0, "points", "be finite wherever `observed` is true", where)
    array[lost] = np.broadcast_to(reference, array.shape)[lost]
    return array


def _sound_jet(jet: Jet | None, frames: int) -> Jet | None:
    if jet is None:
        return None
    force = as_array("nozzle_force", jet.force, (frames,))
    direction = as_array("nozzle_direction", jet.direction, (frames, 3))
    slanted = np.abs(np.linalg.norm(direction, axis=1) - 1) > 0.01
    bad = np.flatnonzero(slanted & (force != 0))
    require(len(bad) == 0, "nozzle_direction", "have length 1", f"other lengths in {len(bad)} frames")
    footprint = float(np.ravel(jet.footprint)[0]) if np.size(jet.footprint) == 1 else np.nan
    require(footprint > 0, "nozzle_footprint", "be one positive number", jet.footprint)
    position = as_array("nozzle_position", jet.position, (frames, 3))
    return replace(jet, position=position, direction=direction, force=force, footprint=footprint)


def _from_keys(keys: Mapping[str, object]) -> Observation:
    plain = {name: value for name, value in keys.items() if name not in JET_KEYS}
    if "nozzle_position" not in keys:
        return Observation(**plain)
    position, direction, force, footprint = (keys[name] for name in JET_KEYS)
    return Observation(**plain, jet=Jet(position=position, direction=direction, force=force, footprint=footprint))


def _to_keys(observation: Observation) -> dict[str, object]:
    names = [name for name in (*REQUIRED, *OPTIONAL, *NATIVE) if name not in JET_KEYS]
    keys = {name: getattr(observation, name) for name in names if getattr(observation, name) is not None}
    if observation.force_scale_known:  # as where nothing is said
        del keys["force_scale_known"]
    if observation.jet is not None:
        jet = observation.jet
        keys |= dict(zip(JET_KEYS, (jet.position, jet.direction, jet.force, jet.footprint), strict=True))
    return keys
