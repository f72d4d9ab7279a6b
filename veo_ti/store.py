"""Native result file: one `.vtkhdf` that ParaView, pyvista, h5py and xarray open, and small safe file helpers."""

import dataclasses
import json
import os
import platform
import tempfile
import zipfile
import zlib
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import h5py
import numpy as np

from recon.files import replacing
from sim.checks import as_array, require
from veo_ti.vtkhdf import append_step, drop_unfinished, read_frames, write_frame

SCHEMA = 1
UNITS = {
    "points": "m", "time": "s", "forces": "N", "mu": "Pa", "lam": "Pa", "volume": "m3", "mass": "kg", "gravity": "m/s2",
    "x": "m", "sigma": "m", "error": "m", "nozzle_position": "m", "nozzle_force": "N", "nozzle_footprint": "m",
}  # fmt: skip
PACKAGES = ("veo_ti", "numpy", "scipy", "taichi", "h5py")
DAMAGE = (AttributeError, OSError, EOFError, LookupError, TypeError, ValueError, RuntimeError)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Sequence:
    """Points moving over time with what is known of them.

    time (T,) [s] · points (T, N, 3) [m] · point_data: name -> (T, N) or (T, N, C), changing · static: name -> (N,) or
    (N, C), one value per point for all times (mu, lam, x, fixed) · arrays: name -> any other array · attributes: plain
    values, lists, dataclasses (options, mass) · versions: package -> version that wrote the file.
    """

    time: np.ndarray
    points: np.ndarray
    point_data: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    static: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    arrays: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    attributes: Mapping[str, object] = dataclasses.field(default_factory=dict)
    versions: Mapping[str, str] = dataclasses.field(default_factory=dict)


class SequenceWriter:
    """Write a sequence step by step: `with SequenceWriter(path, static=...) as w: w.append(t, points, {...})`.

    Steps go to `<name>.partial.vtkhdf` beside the goal and are flushed one by one; leaving the block without an
    exception renames it to path. After an exception, or a kill, the partial file stays with every finished step.
    Raises ValueError for a wrong suffix, a folder that cannot be written, or arrays that do not fit the points.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        static: Mapping[str, np.ndarray] | None = None,
        arrays: Mapping[str, np.ndarray] | None = None,
        attributes: Mapping[str, object] | None = None,
    ) -> None:
        self.path = Path(path)
        require(self.path.suffix == ".vtkhdf", "path", "end in .vtkhdf", repr(self.path.name))
        self.partial = self.path.with_suffix(".partial.vtkhdf")
        self._static, self._arrays, self._attributes = dict(static or {}), dict(arrays or {}), dict(attributes or {})
        self._steps, self._count, self._names = 0, 0, frozenset()

    def __enter__(self) -> "SequenceWriter":
        writable_folder(self.path.parent)
        try:
            self._file = h5py.File(self.partial, "w")
        except OSError as error:
            raise ValueError(f"path must not be in use by another run; got {str(self.partial)!r} ({error})") from None
        return self

    def append(self, time: float, points: np.ndarray, point_data: Mapping[str, np.ndarray] | None = None) -> None:
        """Add one step and flush it: time [s], points (N, 3) [m], point_data: name -> (N,) or (N, C)."""
        data = dict(point_data or {})
        if self._steps == 0:
            self._begin(as_array("points", points, (None, 3)), data)
        points = as_array("points", points, (self._count, 3))
        require(data.keys() == self._names, "point_data", f"hold {sorted(self._names)} in each step", sorted(data))
        append_step(self._file, self._steps, float(time), points, data)
        self._steps += 1

    def _begin(self, points: np.ndarray, data: dict[str, np.ndarray]) -> None:
        twice = sorted(data.keys() & self._static.keys())
        require(not twice, "point_data", "not repeat names of static", twice)
        self._count, self._names = len(points), data.keys()
        write_frame(self._file, self._count, self._static, data)
        _write_own(self._file, self._arrays, self._attributes, ["points", "time", *self._static, *data])

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        drop_unfinished(self._file)
        self._file.close()
        if self._steps == 0:
            self.partial.unlink(missing_ok=True)
            require(kind is not None, "sequence", "have at least one step", "none")
        elif kind is None:
            os.replace(self.partial, self.path)


def write_sequence(path: str | Path, sequence: Sequence) -> Path:
    """Write a whole sequence at once; returns the path."""
    extras = (sequence.static, sequence.arrays, sequence.attributes)
    with SequenceWriter(path, static=extras[0], arrays=extras[1], attributes=extras[2]) as writer:
        for i, time in enumerate(sequence.time):
            writer.append(time, sequence.points[i], {name: values[i] for name, values in sequence.point_data.items()})
    return Path(path)


def read_sequence(path: str | Path) -> Sequence:
    """Read a file of `SequenceWriter`, finished or partial; nothing is ever unpickled.

    Raises ValueError when the file is missing, damaged, from elsewhere, of a newer schema, or has no finished step.
    """
    path = Path(path)
    require(path.is_file(), "file", "exist", repr(str(path)))
    try:
        with h5py.File(path, "r") as file:
            return _read_open(file)
    except DAMAGE as error:
        reason = _first_line(error)
        raise ValueError(f"file must be a complete .vtkhdf written by veo_ti; got {str(path)!r} ({reason})") from None


def _read_open(file: h5py.File) -> Sequence:
    require("veo_ti" in file and "VTKHDF" in file, "groups", "include VTKHDF and veo_ti", sorted(file))
    own = file["veo_ti"]
    schema = int(own.attrs["schema"])
    require(schema <= SCHEMA, "schema", f"be {SCHEMA} or older: update veo_ti to read it", schema)
    stored = read_frames(file)
    return Sequence(
        time=stored.time,
        points=stored.points,
        point_data=stored.changing,
        static=stored.static,
        arrays={name: data[()] for name, data in own["arrays"].items()},
        attributes=json.loads(own["attributes"].asstr()[()]),
        versions=json.loads(own["versions"].asstr()[()]),
    )


def _write_own(file: h5py.File, arrays: dict[str, np.ndarray], attributes: dict[str, object], names: list[str]) -> None:
    own = file.create_group("veo_ti")
    own.attrs["schema"] = SCHEMA
    own["attributes"] = _json("attributes", attributes)
    own["units"] = _json("units", {name: UNITS[name] for name in (*names, *arrays, *attributes) if name in UNITS})
    own["versions"] = _json("versions", {"python": platform.python_version()} | {p: _version(p) for p in PACKAGES})
    group = own.create_group("arrays")
    for name, values in arrays.items():
        array = np.asarray(values)
        require(array.dtype.kind in "buif", name, "be an array of numbers", array.dtype)
        group[name] = array


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def _first_line(error: BaseException) -> str:
    return (str(error).strip("'\"") or type(error).__name__).splitlines()[0]


def _plain(value: object) -> object:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} has no JSON form")


def _json(name: str, value: object, indent: int | None = None) -> str:
    try:
        return json.dumps(value, default=_plain, indent=indent, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must hold finite numbers, texts and lists; got {_first_line(error)}") from None


def write_json_atomic(path: str | Path, value: object) -> Path:
    """Write value as JSON so that a reader sees the old file or the new one, never half of it.

    numpy values and dataclasses are understood. Raises ValueError for NaN, infinity or anything without a JSON form.
    """
    path = Path(path)
    text = _json(path.name, value, indent=2) + "\n"
    writable_folder(path.parent)
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")
    return path


def writable_folder(path: str | Path) -> Path:
    """The folder, made if missing; raises ValueError in one sentence when it cannot be written."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            return path
    except OSError as error:
        raise ValueError(f"folder must be writable; got {str(path)!r} ({error.strerror or error})") from None


def read_npz(path: str | Path) -> dict[str, np.ndarray]:
    """All arrays of an .npz, without pickles; raises ValueError when it is missing, truncated or not an .npz."""
    path = Path(path)
    require(path.is_file(), "file", "exist", repr(str(path)))
    try:
        require(zipfile.is_zipfile(path), "archive", "end in a zip directory", "a truncated or other file")
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (*DAMAGE, zipfile.BadZipFile, zlib.error) as error:
        reason = _first_line(error)
        raise ValueError(f"file must be a complete .npz of plain arrays; got {str(path)!r} ({reason})") from None
