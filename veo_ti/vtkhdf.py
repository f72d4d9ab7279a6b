"""Layout of the native file: temporal PolyData of VTK's HDF format, one point and one vertex cell per body point.

Values that do not change are stored once: every step's offset into them is zero. What VTK does not know (attributes,
versions, other arrays) lies in the group `/veo_ti`.
"""

from collections.abc import Mapping
from typing import NamedTuple

import h5py
import numpy as np

from sim.checks import require

VERSION = (2, 0)
TOPOLOGIES = ("Vertices", "Lines", "Polygons", "Strips")


class Stored(NamedTuple):
    """What a file holds: time (T,), points (T, N, 3), changing and static point data by name."""

    time: np.ndarray
    points: np.ndarray
    changing: dict[str, np.ndarray]
    static: dict[str, np.ndarray]


def write_frame(
    file: h5py.File, count: int, static: Mapping[str, np.ndarray], changing: Mapping[str, np.ndarray]
) -> None:
    """Lay out `/VTKHDF` for `count` points and zero steps; changing gives one step's arrays as a pattern."""
    group = file.create_group("VTKHDF")
    group.attrs["Version"], group.attrs["Type"] = np.array(VERSION), np.bytes_("PolyData")
    group["NumberOfPoints"] = np.array([count])
    _growing(group, "Points", (count, 3), np.float64)
    for topology in TOPOLOGIES:
        cells = count if topology == "Vertices" else 0
        part = group.create_group(topology)
        part["NumberOfCells"], part["NumberOfConnectivityIds"] = np.array([cells]), np.array([cells])
        part["Offsets"], part["Connectivity"] = np.arange(cells + 1), np.arange(cells)
    steps, data = group.create_group("Steps"), group.create_group("PointData")
    steps.attrs["NSteps"] = 0
    _growing(steps, "Values", (256,), np.float64)
    for name in ("PartOffsets", "NumberOfParts", "PointOffsets"):
        _growing(steps, name, (256,), np.int64)
    for name in ("CellOffsets", "ConnectivityIdOffsets"):
        _growing(steps, name, (256, len(TOPOLOGIES)), np.int64)
    for name, values in (*static.items(), *changing.items()):
        array = per_point(name, values, count)
        if name in static:
            data[name] = array
        else:
            _growing(data, name, array.shape, array.dtype)
        data[name].attrs["static"], data[name].attrs["boolean"] = name in static, np.asarray(values).dtype == bool
        _growing(steps.require_group("PointDataOffsets"), name, (256,), np.int64)


def append_step(
    file: h5py.File, step: int, time: float, points: np.ndarray, changing: Mapping[str, np.ndarray]
) -> None:
    """Write step number `step` and flush it; a step counts only once its data are on disk."""
    group, steps, count = file["VTKHDF"], file["VTKHDF/Steps"], len(points)
    _put(group["Points"], points, step)
    for name, values in changing.items():
        _put(group["PointData"][name], per_point(name, values, count), step)
    for name, offsets in steps.get("PointDataOffsets", {}).items():
        _put(offsets, [step * count if name in changing else 0], step)
    for name, value in (("PartOffsets", 0), ("NumberOfParts", 1), ("PointOffsets", step * count)):
        _put(steps[name], [value], step)
    for name in ("CellOffsets", "ConnectivityIdOffsets"):
        _put(steps[name], [[0] * len(TOPOLOGIES)], step)
    file.flush()
    _put(steps["Values"], [time], step)
    steps.attrs.modify("NSteps", step + 1)
    file.flush()


def drop_unfinished(file: h5py.File) -> None:
    """Forget a step that was begun only: VTK's reader crashes where there are more time values than steps."""
    if "VTKHDF/Steps/Values" in file:
        steps = file["VTKHDF/Steps"]
        steps["Values"].resize(int(steps.attrs["NSteps"]), axis=0)


def read_frames(file: h5py.File) -> Stored:
    """All finished steps of an open file; raises KeyError or ValueError where the layout is not ours."""
    group = file["VTKHDF"]
    steps, count = int(group["Steps"].attrs["NSteps"]), int(group["NumberOfPoints"][0])
    require(steps > 0, "file", "hold at least one finished step", "none")
    changing, static = {}, {}
    for name, data in group["PointData"].items():
        once = bool(data.attrs["static"])
        values = data[:count] if once else data[: steps * count].reshape(steps, count, *data.shape[1:])
        (static if once else changing)[name] = values.astype(bool) if data.attrs["boolean"] else values
    points = group["Points"][: steps * count].reshape(steps, count, 3)
    return Stored(group["Steps/Values"][:steps], points, changing, static)


def per_point(name: str, values: object, count: int) -> np.ndarray:
    """The values as VTK stores them: numbers, (count,) or (count, C), truth values as bytes."""
    array = np.asarray(values)
    fits = array.dtype.kind in "buif" and array.ndim in (1, 2) and len(array) == count and "/" not in name
    require(fits, name, f"be numbers of shape ({count},) or ({count}, any)", f"{array.dtype} {array.shape}")
    if array.dtype == bool:
        return array.astype(np.uint8)
    return array.astype(np.float32) if array.dtype == np.float16 else array


def _growing(group: h5py.Group, name: str, chunk: tuple[int, ...], dtype: type) -> None:
    chunk = tuple(max(1, n) for n in chunk)
    group.create_dataset(name, (0, *chunk[1:]), dtype, maxshape=(None, *chunk[1:]), chunks=chunk)


def _put(data: h5py.Dataset, rows: object, step: int) -> None:
    rows = np.asarray(rows)
    data.resize((step + 1) * len(rows), axis=0)
    data[step * len(rows) :] = rows
