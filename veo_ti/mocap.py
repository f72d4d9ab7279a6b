"""Motion capture: labelled markers over time from C3D files, and the beam takes of the data set."""

import struct
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import c3d
import numpy as np

from sim.checks import as_array, require
from veo_ti.store import read_npz

# The reader checks little: a damaged header surfaces as any of these.
DAMAGE = (
    *(ArithmeticError, AssertionError, AttributeError, EOFError, LookupError),
    *(NameError, OSError, TypeError, UnicodeError, struct.error),
)
METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
BEAM_KEYS = ("time", "markers_beam", "residual", "labels", "release_frame", "rest_frames", "tip_load_N")


@dataclass(frozen=True, kw_only=True, eq=False)
class Markers:
    """Tracked markers over time; `residual` is negative where a camera system lost the marker."""

    time: np.ndarray  # (T,) [s]
    positions: np.ndarray  # (T, M, 3) [m]
    residual: np.ndarray  # (T, M) [m]
    labels: tuple[str, ...]

    @property
    def observed(self) -> np.ndarray:
        """(T, M) bool: where the position can be trusted."""
        return self.residual >= 0

    def moved(self, rotation: np.ndarray, shift: np.ndarray) -> "Markers":
        """The markers in another frame, R p + t with rotation R (3, 3) and shift t (3,) [m]."""
        return replace(self, positions=self.positions @ np.asarray(rotation).T + shift)

    def mean_pose(self, frames: slice) -> np.ndarray:
        """(M, 3) [m]: each marker's mean over the chosen frames, from where it was observed.

        Raises ValueError when a marker is never observed in them.
        """
        seen = self.observed[frames][..., None]
        count = seen.sum(axis=0)
        lost = [label for label, n in zip(self.labels, count[:, 0], strict=True) if n == 0]
        require(not lost, "frames", "show every marker at least once", f"none of {', '.join(lost)}")
        return np.where(seen, self.positions[frames], 0.0).sum(axis=0) / count


@dataclass(frozen=True, kw_only=True, eq=False)
class BeamTake:
    """One take of the silicone beam: markers in the beam's frame, when it was released and what hung on its tip."""

    markers: Markers
    release_frame: int
    rest_frames: int  # frames before the release in which the beam is held straight
    tip_load: float  # [N], along -z


def read_c3d(path: str | Path, *, unit: str | None = None) -> Markers:
    """Read the markers of a C3D file; lengths are in the file's own POINT:UNITS unless unit ("m", "cm", "mm") is given.

    Raises ValueError when the file is missing, is not C3D, is cut short, or names no known unit.
    """
    path = Path(path)
    require(path.is_file(), "file", "exist", repr(str(path)))
    with path.open("rb") as handle:
        require(handle.read(2)[1:] == b"P", "file", "be a C3D file", repr(str(path)))
        handle.seek(0)
        try:
            return _markers(handle, path, unit)
        except DAMAGE as error:
            reason = str(error) or type(error).__name__
            raise ValueError(f"file must be a complete C3D file; got {str(path)!r} ({reason})") from None


def _markers(handle: object, path: Path, unit: str | None) -> Markers:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "No analog data found": a camera system has none
        reader = c3d.Reader(handle)
        frames = [points for _, points, _ in reader.read_frames(copy=True)]
    expected = reader.last_frame - reader.first_frame + 1
    require(
        len(frames) == expected, "file", f"hold the {expected} frames it announces", f"{len(frames)} in {path.name}"
    )
    scale = _scale(reader, unit)
    table = np.array(frames, dtype=np.float64)  # columns: x, y, z, residual, cameras
    labels = tuple(str(label).strip() for label in reader.point_labels)[: table.shape[1]]
    residual = np.where(table[..., 3] < 0, -1.0, table[..., 3] * scale)
    positions = as_array(
        "positions", np.where(residual[..., None] < 0, 0.0, table[..., :3] * scale), table[..., :3].shape
    )
    time = np.arange(len(frames)) / reader.point_rate
    return Markers(time=time, positions=positions, residual=residual, labels=labels)


def _scale(reader: c3d.Reader, unit: str | None) -> float:
    parameter = reader.get("POINT:UNITS")
    named = unit or ("" if parameter is None else parameter.string_value.strip().lower())
    require(named in METRES, "unit", f"be one of {', '.join(METRES)}, in POINT:UNITS or given", repr(named))
    return METRES[named]


def read_beam_take(path: str | Path) -> BeamTake:
    """Read one .npz of the silicone beam's motion capture, in the beam's frame.

    Raises ValueError when the file is damaged or a key is missing.
    """
    held = read_npz(path)
    missing = [key for key in BEAM_KEYS if key not in held]
    require(not missing, "keys", f"include {', '.join(missing)}", ", ".join(sorted(held)))
    positions = as_array("markers_beam", held["markers_beam"], (None, None, 3))
    markers = Markers(
        time=as_array("time", held["time"], positions.shape[:1]),
        positions=positions,
        residual=as_array("residual", held["residual"], positions.shape[:2]),
        labels=tuple(str(label) for label in held["labels"]),
    )
    release, rest = int(held["release_frame"]), int(held["rest_frames"])
    return BeamTake(markers=markers, release_frame=release, rest_frames=rest, tip_load=float(held["tip_load_N"]))
