"""`python -m benchmarks.capture`: measure the capture side on rig recordings, against the truth beside them."""

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from benchmarks.capture_boards import calibration_rows
from benchmarks.capture_reading import made, reading_rows
from benchmarks.capture_rows import file_rows, hull_rows, matte_rows, nozzle_rows
from benchmarks.table import Row, publish, report
from recon.rig.options import RigOptions

_WORDS = (
    "What the capture side finds in synthetic recordings, whose truth is known, and what that costs; the times are "
    "those of this machine as busy as it was."
)
_SMALL = "This was `--quick`: pictures too small for most targets, which are meant for the full run."
SMOKE = RigOptions(cameras=6, frames=6, size=96, reconstruction=400)
MIDDLE = RigOptions(cameras=8, frames=20, size=240)
LONG = 40  # frames read for training


def sections(place: Path, full: RigOptions | None) -> dict[str, Callable[[], list[Row]]]:
    """What is measured in which order; full: the recording in full size, None for none."""
    smoke, middle, large = place / "smoke", place / "middle", place / "full"
    out = {
        "smoke recording": lambda: made(smoke, SMOKE, "smoke"),
        "files": lambda: file_rows(smoke, "smoke"),
        "small calibration": lambda: calibration_rows(11, 360, 16),
        "middle recording": lambda: made(middle, MIDDLE, "middle"),
        "middle nozzle": lambda: _untargeted(nozzle_rows(middle, "240 pixels")),
        "middle mattes": lambda: _untargeted(matte_rows(middle, "240 pixels", 40)),
        "middle hull": lambda: hull_rows(middle, "240 pixels"),
    }
    if full is not None:
        pixels = f"{full.size} pixels"
        out |= {
            "full recording": lambda: made(large, full, "full size"),
            "nozzle": lambda: nozzle_rows(large, pixels),
            "mattes": lambda: matte_rows(large, pixels, 12),
            "hull": lambda: hull_rows(large, pixels),
            "calibration": lambda: calibration_rows(full.cameras, full.size // 3, 32),
            "reading": lambda: reading_rows(large, LONG),
        }
    return out


def _untargeted(rows: list[Row]) -> list[Row]:
    """The rows without targets, which are meant for pictures of full size."""
    return [replace(row, target="", reached=None) for row in rows]


def main() -> None:
    """Measure, print and, on request, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.capture", description="The capture side, as markdown.")
    parser.add_argument("--quick", action="store_true", help="small recordings only")
    parser.add_argument("--frames", type=int, default=48, help="of the recording in full size")
    parser.add_argument("--folder", type=Path, help="keep the recordings here, and go on with those that are there")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the markdown here too")
    given = parser.parse_args()
    full = None if given.quick else RigOptions(frames=given.frames)
    with tempfile.TemporaryDirectory() as place:
        measured = sections(given.folder or Path(place), full)
        publish(report(_WORDS, measured, note=_SMALL if given.quick else ""), given.out)


if __name__ == "__main__":
    main()
