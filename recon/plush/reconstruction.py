"""The PLUSH dataset's folders, read as they are: millimetres become metres here and nowhere else."""

import json
import pickle
import warnings
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from recon.metrics import DistanceTable, table_of
from sim.checks import as_array, require

MM = 1e-3  # [m]
MARKER_ID = 164  # the ArUco marker on the nozzle
NOZZLE_IN_MARKER = np.array([0.0, 105.0, 0.0])  # [mm], where the stream starts in the marker's frame
STREAM_IN_MARKER = np.array([0.0, 0.0, -1.0])
TO_RECONSTRUCTION = np.array([1.0, -1.0, -1.0])  # the marker's world has y and z the other way round
DAMAGE = (
    OSError,
    EOFError,
    LookupError,
    TypeError,
    ValueError,
    RuntimeError,
    pickle.UnpicklingError,
    zipfile.BadZipFile,
)
CAN_STILL = {
    "reconstruction/00000000.npz": "no points to identify from; the paper's own table row can still be recomputed",
    "reconstruction/mask.pt": "the whole raw cloud is used and no point is known to be held",
    "reconstruction/rgbs.npy": "everything still works, in grey",
    "simulation/simInfo.pt": "frames and points are chosen evenly instead of as in the paper",
    "simulation/val_GT": "the paper's own table row cannot be recomputed, the rest can be done",
    "simulation/val_simed": "the paper's own table row cannot be recomputed, the rest can be done",
    "capture/aruco_path.json": "no forces are known; points can be viewed but no material identified",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class NozzlePath:
    """Where the air stream starts and blows: position (F, 3) [m], direction (F, 3), seen (F,) bool, by video frame.

    A frame in which no camera saw the marker has seen False and the pose of the nearest frame that did.
    """

    position: np.ndarray
    direction: np.ndarray
    seen: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class PlushFolder:
    """One object's folder, its points read frame by frame; a part that is missing leaves empty arrays or None."""

    path: Path
    frame_numbers: np.ndarray  # (F,), the reconstructed frames
    object_index: np.ndarray  # (C,), the cleaned cloud within the raw one
    colors: np.ndarray | None  # (C, 3), in [0, 1]
    fixed: np.ndarray  # (C,) bool, held by strings or taped to the ground
    train_frames: np.ndarray
    validation_frames: np.ndarray
    sampled: np.ndarray  # (S,), the points of the paper's simulation within the cleaned cloud
    nozzle: NozzlePath | None
    missing: tuple[str, ...]  # sentences: what is missing and what can still be done

    def points(self, frame: int) -> np.ndarray:
        """Positions (C, 3) [m] of the cleaned cloud in one frame; raises ValueError when it was not reconstructed."""
        count = len(self.frame_numbers)
        require(frame in self.frame_numbers, "frame", f"be one of the {count} reconstructed frames", frame)
        return _vertices(self.path, frame)[self.object_index]


def read_plush(folder: str | Path) -> PlushFolder:
    """Open one object's folder of the dataset, unmodified, with whatever parts it has.

    Raises ValueError when it holds no part at all, or a part that is damaged.
    """
    path = Path(folder)
    missing = [part for part in CAN_STILL if not (path / part).exists()]
    require(len(missing) < len(CAN_STILL), "input", "be a PLUSH object folder (reconstruction/, ...)", repr(str(path)))
    frames = np.array(sorted(int(p.stem) for p in path.glob("reconstruction/*.npz") if p.stem.isdigit()), dtype=int)
    raw = len(_vertices(path, frames[0])) if len(frames) else 0
    mask, info = (_tensors(path / part) for part in ("reconstruction/mask.pt", "simulation/simInfo.pt"))
    index = _index(mask, "objectInd", raw) if mask else np.arange(raw)
    fixed = np.zeros(len(index), bool)
    fixed[_index(mask, "fixed", len(index))] = True
    validation = _index(info, "valInd")
    return PlushFolder(
        path=path,
        frame_numbers=frames,
        object_index=index,
        colors=_colors(path / "reconstruction/rgbs.npy", index, raw),
        fixed=fixed,
        train_frames=_index(info, "trainingInd"),
        validation_frames=validation,
        sampled=_sampled(path, _index(info, "sampledVerts", raw or None), index, validation),
        nozzle=read_nozzle(path / "capture/aruco_path.json", int(frames.max(initial=-1)) + 1),
        missing=tuple(f"{part} is missing: {CAN_STILL[part]}." for part in missing),
    )


def paper_table_row(folder: PlushFolder) -> DistanceTable:
    """The paper's Table 1 row of this object from the paper's own results: val_simed against val_GT.

    Raises ValueError when one is missing or their frames or points do not match.
    """
    return table_of(
        np.stack([np.linalg.norm(simulated - seen, axis=1) for seen, simulated in validation_pairs(folder)])
    )


def validation_pairs(folder: PlushFolder) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """For each validation frame the reconstructed and the paper's simulated points, (S, 3) [m] each."""
    seen, simulated = ({p.name: p for p in folder.path.glob(f"simulation/{n}/*.obj")} for n in ("val_GT", "val_simed"))
    same = len(seen) > 0 and seen.keys() == simulated.keys()
    require(same, "val_GT and val_simed", "hold the same frames", f"{len(seen)} and {len(simulated)} files")
    for name in sorted(seen):
        expected = read_obj_points(seen[name])
        yield expected, as_array(f"val_simed/{name}", read_obj_points(simulated[name]), expected.shape)


def read_obj_points(path: Path) -> np.ndarray:
    """The points (N, 3) [m] of an .obj file in millimetres with lines `v x y z` and nothing else."""
    table = _read(path, lambda p: np.loadtxt(p, usecols=(1, 2, 3), ndmin=2))
    return MM * as_array(path.name, table, (None, 3))


def _read(path: Path, reader: Callable[[Path], object]) -> object:
    """The reader's result; every way in which a foreign file can be damaged becomes one ValueError."""
    try:
        return reader(path)
    except DAMAGE as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ValueError(f"{path.name} must be a complete file of the PLUSH layout; got {reason}") from None


def _vertices(path: Path, frame: int) -> np.ndarray:
    file = _vertex_file(path, frame)
    return MM * as_array(f"{file.name} vertices", _read(file, _npz_vertices), (None, 3))


def _vertex_file(path: Path, frame: int) -> Path:
    return path / "reconstruction" / f"{frame:08d}.npz"


def _npz_vertices(path: Path) -> np.ndarray:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        return archive["vertices"]


def _colors(path: Path, index: np.ndarray, raw: int) -> np.ndarray | None:
    if not path.exists() or not raw:
        return None
    return as_array("rgbs.npy", _read(path, lambda p: np.load(p, allow_pickle=False)), (raw, 3))[index]


def _tensors(path: Path) -> dict[str, object]:
    if not path.exists():
        return {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch remarks on pickle versions before it refuses or accepts
        held = _read(path, lambda p: torch.load(p, map_location="cpu", weights_only=True))
    require(isinstance(held, dict), path.name, "hold a dictionary", type(held).__name__)
    return held


def _index(held: dict[str, object], key: str, size: int | None = None) -> np.ndarray:
    """The indices under key; none when the whole file is missing."""
    require(not held or key in held, "keys", f"include {key}", ", ".join(sorted(map(str, held))))
    array = np.asarray(held.get(key, ())).reshape(-1)
    array = np.flatnonzero(array) if array.dtype == bool else array.astype(int)
    low, high = (int(array.min()), int(array.max())) if len(array) else (0, 0)
    fits = low >= 0 and (size is None or high < max(size, 1))
    require(fits, key, f"hold indices of at most {size} points" if size else "hold frame numbers", f"{low} to {high}")
    return array


def _sampled(path: Path, given: np.ndarray, index: np.ndarray, validation: np.ndarray) -> np.ndarray:
    """sampledVerts as indices into the cleaned cloud.

    The layout does not say whether they count in the cleaned or in the raw cloud. Where both are possible the points
    of the first val_GT file decide; without them the cleaned cloud does, as for `fixed`.
    """
    if len(given) == 0 or len(index) == 0:
        return np.empty(0, int)
    order = np.argsort(index)
    place = order[np.searchsorted(index, given, sorter=order).clip(max=len(index) - 1)]
    readings = [given] if given.max() < len(index) else []
    readings += [place] if (index[place] == given).all() else []
    require(len(readings) > 0, "sampledVerts", "be indices into the cleaned cloud", f"up to {given.max()}")
    files = sorted(path.glob("simulation/val_GT/*.obj"))
    frame = int(validation[0]) if len(validation) else -1
    if len(readings) == 1 or not files or not _vertex_file(path, frame).exists():
        return readings[0]
    seen, cloud = read_obj_points(files[0]), _vertices(path, frame)[index]
    away = [np.abs(cloud[r] - seen).max() if len(r) == len(seen) else np.inf for r in readings]
    return readings[int(np.argmin(away))]


def read_nozzle(path: Path, frames: int) -> NozzlePath | None:
    """The nozzle's path over at least `frames` video frames, None when no file or no frame shows the marker.

    Raises ValueError for a damaged file, another marker than the nozzle's, or a pose that holds no rotation.
    """
    entries = _read(path, lambda p: json.loads(p.read_text())) if path.exists() else []
    poses = {i: _read(path, lambda _, e=entry: _pose(e)) for i, entry in enumerate(entries) if entry is not None}
    if not poses:
        return None
    count, at = max(frames, len(entries)), np.array(list(poses))
    nearest = at[np.abs(np.arange(count)[:, None] - at).argmin(axis=1)]
    position, direction = (np.array([poses[i][part] for i in nearest]) for part in (0, 1))
    return NozzlePath(position=position, direction=direction, seen=np.isin(np.arange(count), at))


def _pose(entry: dict) -> tuple[np.ndarray, np.ndarray]:
    """p = R (0, 105, 0) + t and d = R (0, 0, -1), then y and z of both change sign; R, t: marker to world."""
    ids = np.ravel(entry["aruco_ids"]).tolist()
    require(ids == [MARKER_ID], "aruco_ids", f"be [{MARKER_ID}], the nozzle's marker", ids)
    rotation = as_array("rvecs", np.reshape(entry["rvecs"], (3, 3)), (3, 3))
    orthonormal = np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-2 and np.linalg.det(rotation) > 0
    require(bool(orthonormal), "rvecs", "be a rotation matrix", rotation.tolist())
    shift = as_array("tvecs", np.ravel(entry["tvecs"]), (3,))
    position = MM * TO_RECONSTRUCTION * (rotation @ NOZZLE_IN_MARKER + shift)
    return position, TO_RECONSTRUCTION * (rotation @ STREAM_IN_MARKER)
