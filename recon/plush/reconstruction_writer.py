"""Write a folder in exactly the PLUSH layout, for the synthetic rig and for tests."""

import json
from pathlib import Path

import numpy as np
import torch

from recon.plush.reconstruction import MARKER_ID, MM, NOZZLE_IN_MARKER, TO_RECONSTRUCTION, NozzlePath
from sim.checks import as_array, require


def write_reconstruction(
    folder: str | Path, *, vertices: np.ndarray, colors: np.ndarray, object_index: np.ndarray, fixed: np.ndarray
) -> None:
    """Write `reconstruction/`: vertices (F, R, 3) [m], colors (R, 3), object_index into R, fixed into object_index.

    Raises ValueError for shapes that do not fit.
    """
    vertices = as_array("vertices", vertices, (None, None, 3))
    colors = as_array("colors", colors, (vertices.shape[1], 3))
    place = _made(folder, "reconstruction")
    for frame, points in enumerate(vertices):
        np.savez(place / f"{frame:08d}.npz", vertices=(points / MM).astype(np.float32))
    np.save(place / "rgbs.npy", colors.astype(np.float32))
    mask = {"objectInd": torch.as_tensor(object_index), "fixed": torch.as_tensor(fixed)}
    torch.save(mask, place / "mask.pt")


def write_simulation(
    folder: str | Path,
    *,
    training: np.ndarray,
    validation: np.ndarray,
    sampled: np.ndarray,
    seen: np.ndarray,
    simulated: np.ndarray,
) -> None:
    """Write `simulation/`: frame numbers, sampled point indices, and seen and simulated points (V, S, 3) [m].

    Raises ValueError for shapes that do not fit.
    """
    shape = (len(validation), len(sampled), 3)
    place = _made(folder, "simulation")
    info = {"trainingInd": training, "valInd": validation, "sampledVerts": sampled}
    torch.save({name: torch.as_tensor(value) for name, value in info.items()}, place / "simInfo.pt")
    for name, points in (("val_GT", seen), ("val_simed", simulated)):
        for i, frame in enumerate(as_array(name, points, shape)):
            lines = [f"v\t{x:.6f}\t{y:.6f}\t{z:.6f}\t\n" for x, y, z in frame / MM]
            (_made(folder, f"simulation/{name}") / f"{i:04d}.obj").write_text("".join(lines))


def write_nozzle(folder: str | Path, path: NozzlePath) -> None:
    """Write `capture/aruco_path.json`: the marker poses that give this nozzle path, null where it was not seen."""
    require(len(path.position) == len(path.seen), "seen", f"have length {len(path.position)}", len(path.seen))
    entries = [_marker(p, d) if s else None for p, d, s in zip(path.position, path.direction, path.seen, strict=True)]
    (_made(folder, "capture") / "aruco_path.json").write_text(json.dumps(entries))


def _marker(position: np.ndarray, direction: np.ndarray) -> dict[str, object]:
    """A marker pose whose -z is the stream; its turn about that axis is free and taken arbitrarily."""
    z = -TO_RECONSTRUCTION * direction / np.linalg.norm(direction)
    x = np.cross(np.eye(3)[np.abs(z).argmin()], z)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z], axis=1)
    shift = TO_RECONSTRUCTION * position / MM - rotation @ NOZZLE_IN_MARKER
    return {"aruco_ids": [MARKER_ID], "rvecs": rotation.tolist(), "tvecs": shift.tolist()}


def _made(folder: str | Path, name: str) -> Path:
    path = Path(folder) / name
    path.mkdir(parents=True, exist_ok=True)
    return path
