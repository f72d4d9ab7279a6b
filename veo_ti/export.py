"""Exports of a sequence for other programs: one PLY file a step, or one NPZ."""

from pathlib import Path

import numpy as np

from recon.files import replacing
from sim.checks import require
from veo_ti.store import Sequence, writable_folder


def export_ply(sequence: Sequence, folder: str | Path, *, every: int = 1) -> list[Path]:
    """Write every n-th step as `0000.ply` ...: positions [m] and each scalar point value as a float property.

    A static (N, 3) array `colors` in [0, 1] becomes red, green, blue. Raises ValueError when folder cannot be written.
    """
    require(every >= 1, "every", "be at least 1", every)
    folder = writable_folder(folder)
    paths = []
    for i in range(0, len(sequence.time), every):
        paths.append(folder / f"{i:04d}.ply")
        paths[-1].write_bytes(_ply(sequence, i))
    return paths


def _ply(sequence: Sequence, step: int) -> bytes:
    scalars = dict(sequence.static) | {name: values[step] for name, values in sequence.point_data.items()}
    columns = dict(zip("xyz", sequence.points[step].T, strict=True))
    columns |= {name: values for name, values in scalars.items() if values.ndim == 1 and name not in "xyz"}
    kinds = dict.fromkeys(columns, ("float", "<f4"))
    if "colors" in sequence.static:
        bytes_ = np.clip(np.rint(255 * sequence.static["colors"]), 0, 255).T
        columns |= dict(zip(("red", "green", "blue"), bytes_, strict=True))
        kinds |= dict.fromkeys(("red", "green", "blue"), ("uchar", "u1"))
    rows = np.empty(sequence.points.shape[1], dtype=[(name, kinds[name][1]) for name in columns])
    for name, values in columns.items():
        rows[name] = values
    properties = "".join(f"property {kinds[name][0]} {name.replace(' ', '_')}\n" for name in columns)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{properties}end_header\n"
    return header.encode("ascii") + rows.tobytes()


def export_npz(sequence: Sequence, path: str | Path) -> Path:
    """Write time, points and all arrays of the sequence as one compressed NPZ; names as in the sequence."""
    path = Path(path)
    require(path.suffix == ".npz", "path", "end in .npz", repr(path.name))
    writable_folder(path.parent)
    everything = dict(sequence.static) | dict(sequence.point_data) | dict(sequence.arrays)
    clash = sorted(everything.keys() & {"time", "points"})
    require(not clash, "names", "leave time and points to the sequence", clash)
    with replacing(path) as partial:
        np.savez_compressed(partial, time=sequence.time, points=sequence.points, **everything)
    return path
