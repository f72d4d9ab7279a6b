"""The marker's poses of aruco_path.json, in metres and in the axes of the reconstruction."""

from pathlib import Path

import numpy as np

from recon.files import read_json
from recon.plush.reconstruction import MM, TO_RECONSTRUCTION, read_nozzle
from sim.checks import require


def read_markers(path: str | Path) -> tuple[np.ndarray | None, ...]:
    """T_world_marker (4, 4) [m] by frame, None where the marker was not seen.

    Raises ValueError naming the file when it is missing or damaged, names another marker or holds no rotation.
    """
    path = Path(path)
    require(path.is_file(), path.name, "exist", "no such file")
    read_nozzle(path, 0)  # says what is wrong with it
    return tuple(None if entry is None else _pose(entry) for entry in read_json(path))


def _pose(entry: dict[str, object]) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = TO_RECONSTRUCTION[:, None] * np.reshape(entry["rvecs"], (3, 3))
    T[:3, 3] = MM * TO_RECONSTRUCTION * np.ravel(entry["tvecs"])
    return T
