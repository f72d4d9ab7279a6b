"""Where observations come from: each source becomes the keys of the observation format, checked in one place."""

from collections.abc import Mapping
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sim.checks import require
from veo_ti.store import Sequence, read_npz, read_sequence

if TYPE_CHECKING:
    from recon.plush.reconstruction import PlushFolder

REQUIRED = ("points", "time", "fixed")
JET_KEYS = ("nozzle_position", "nozzle_direction", "nozzle_force", "nozzle_footprint")
OPTIONAL = (
    "forces", "surface", "volume", "mass", "gravity", "handles", "observed", "sigma", "force_scale_known", *JET_KEYS,
)  # fmt: skip
NATIVE = ("held_out", "name", "up")  # kept by .vtkhdf only

PLUSH_FRAME_RATE = 40.0  # [1/s], the paper's section "PLUSH Dataset"
PLUSH_UP = np.array([0.0, 1.0, 0.0])  # its world is the first camera's, with y upwards in the picture
PLUSH_FOOTPRINT = 0.02  # [m]; the dataset does not tell: about the width of the stream where it meets the object
PLUSH_MOST_FRAMES = 400  # taken from a folder without simInfo.pt, which would choose them
PLUSH_MOST_POINTS = 5000
LED_FRACTION = 0.02  # held points that travel further than this part of the object's size are led by a string


def read_keys(path: str | Path) -> dict[str, object]:
    """The observation-format keys in an .npz, a .vtkhdf, a PLUSH object folder, or the embedded "example".

    Raises ValueError for a missing or unknown file, a missing key, and in an .npz an unknown key.
    """
    if str(path) == "example":
        with as_file(files("veo_ti") / "examples" / "plush.npz") as example:
            return _known(read_npz(example)) | {"name": "example"}
    path = Path(path)
    require(path.exists(), "input", "exist", repr(str(path)))
    if path.is_dir():
        from recon.plush.reconstruction import read_plush  # it needs torch: seconds that other inputs should not cost

        return plush_keys(read_plush(path))
    require(path.suffix in (".npz", ".vtkhdf"), "input", "be .npz, .vtkhdf or a PLUSH object folder", repr(path.name))
    keys = _known(read_npz(path)) if path.suffix == ".npz" else sequence_keys(read_sequence(path))
    return {"name": path.stem} | keys


def _known(keys: Mapping[str, object]) -> dict[str, object]:
    all_keys = (*REQUIRED, *OPTIONAL)
    unknown = sorted(keys.keys() - set(all_keys))
    require(not unknown, "keys", f"be among {', '.join(all_keys)}", ", ".join(unknown))
    missing = [key for key in REQUIRED if key not in keys]
    require(not missing, "keys", f"include {', '.join(missing)}", ", ".join(sorted(keys)))
    absent = [key for key in JET_KEYS if key not in keys]
    require(len(absent) in (0, len(JET_KEYS)), "keys", "give the jet whole or not at all", f"no {', '.join(absent)}")
    return dict(keys)


def sequence_keys(sequence: Sequence) -> dict[str, object]:
    """The keys held by a native file; what else it holds (mu, lam, options) is left out."""
    stored = dict(sequence.attributes) | dict(sequence.arrays) | dict(sequence.static) | dict(sequence.point_data)
    stored |= {"points": sequence.points, "time": sequence.time}
    native = {key: stored[key] for key in NATIVE if key in stored}
    return native | _known({key: stored[key] for key in (*REQUIRED, *OPTIONAL) if key in stored})


def keys_sequence(keys: Mapping[str, object]) -> Sequence:
    """The native form of observation keys: values per frame and point, per point, other arrays, single values."""
    points = np.asarray(keys["points"])
    rest = {name: value for name, value in keys.items() if name not in ("points", "time")}
    changing = {name: value for name, value in rest.items() if np.shape(value)[:2] == points.shape[:2]}
    static = {name: rest[name] for name in ("fixed", "surface", "volume", "handles") if name in rest}
    single = {name: value for name, value in rest.items() if np.ndim(value) == 0}
    others = {name: value for name, value in rest.items() if name not in {*changing, *static, *single}}
    return Sequence(
        time=np.asarray(keys["time"]),
        points=points,
        point_data=changing,
        static=static,
        arrays=others,
        attributes=single,
    )


def plush_keys(folder: "PlushFolder") -> dict[str, object]:
    """A PLUSH object folder as observation keys: the simulation's frames and points, the jet of unit force.

    Frames in which the nozzle's marker was not seen are left out, since nobody knows what pushed then. Held points
    (strings, ground) that stay in place are fixed, those that travel are handles led along their observed path.
    The dataset gives no force magnitudes: the jet is 1 N and force_scale_known is False.
    Raises ValueError naming the missing part when the folder lacks what this needs.
    """
    can = folder.nozzle is not None and len(folder.frame_numbers) > 0
    require(can, "PLUSH folder", "hold the reconstruction and the nozzle's path", " ".join(folder.missing))
    frames, held_out = _plush_frames(folder)
    chosen = _plush_points(folder)
    points = np.stack([folder.points(frame)[chosen] for frame in frames])
    held = folder.fixed[chosen]
    travel = np.linalg.norm(points - points[0], axis=-1).max(axis=0)
    led = held & (travel > LED_FRACTION * np.ptp(points[0], axis=0).max())
    force = np.ones(len(frames))
    force[0] = 0.0
    return {
        "points": points,
        "time": frames / PLUSH_FRAME_RATE,
        "fixed": held & ~led,
        "handles": led,
        "nozzle_position": folder.nozzle.position[frames],
        "nozzle_direction": folder.nozzle.direction[frames],
        "nozzle_force": force,
        "nozzle_footprint": PLUSH_FOOTPRINT,
        "held_out": held_out,
        "force_scale_known": False,
        "up": PLUSH_UP,
        "name": folder.path.name,
    }


def _plush_frames(folder: "PlushFolder") -> tuple[np.ndarray, np.ndarray | None]:
    first, seen = folder.frame_numbers[0], np.flatnonzero(folder.nozzle.seen)
    usable = np.intersect1d(folder.frame_numbers, seen)
    chosen = np.union1d(folder.train_frames, folder.validation_frames)
    if len(chosen) == 0:
        spread = np.linspace(0, len(usable) - 1, min(len(usable), PLUSH_MOST_FRAMES)).astype(int)
        return np.union1d(first, usable[spread]), None
    frames = np.union1d(first, np.intersect1d(usable, chosen))
    return frames, np.isin(frames, folder.validation_frames) & ~np.isin(frames, [first, *folder.train_frames])


def _plush_points(folder: "PlushFolder") -> np.ndarray:
    if len(folder.sampled):
        return folder.sampled
    count = len(folder.object_index)
    if count <= PLUSH_MOST_POINTS:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, PLUSH_MOST_POINTS, replace=False))
