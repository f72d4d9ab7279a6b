"""How long a recording takes to make and to read, and how much memory reading takes."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import cycle, islice
from pathlib import Path

import numpy as np

from benchmarks.table import Row, peak_memory
from recon.plush.capture import read_capture
from recon.plush.capture_writer import write_capture
from recon.rig.make import make_rig
from recon.rig.options import RigOptions
from recon.views import training_views

FPS = 40.0
MOST = 2.0  # GB


def made(folder: Path, options: RigOptions, what: str) -> list[Row]:
    """Make a recording where it is not there yet, and say how long that took."""
    begin, there = time.perf_counter(), (folder / "capture").exists()
    make_rig(folder, options)
    seconds = time.perf_counter() - begin
    streams = 3 if options.greys else 1
    size = (
        f"{options.cameras} cameras, {streams * options.cameras} videos, {options.frames} frames, {options.size} pixels"
    )
    figure = "it was there already" if there else f"{seconds:.0f} s"
    return [Row(what=f"`veo rig`, {what}: {size}", figure=figure)]


def reading_rows(folder: Path, frames: int) -> list[Row]:
    """A recording of so many frames, made of this one's over and over, read by a process of its own."""
    with tempfile.TemporaryDirectory() as place:
        capture, longer = read_capture(folder), Path(place) / "longer"
        cameras = [camera for camera in capture.cameras if camera.stream == "colour"]

        def pictures(name: str) -> Iterator[np.ndarray]:
            return islice(cycle(capture.sources[name].frames()), frames)

        write_capture(longer, cameras, FPS, pictures, [None] * frames)
        command = [sys.executable, "-m", "benchmarks.capture_reading", str(longer), str(Path(place) / "views")]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    seconds, memory = map(float, said)
    size = " x ".join(map(str, cameras[0].size))
    what = f"Reading {len(cameras)} cameras x {frames} frames of {size} pixels for training"
    return [
        Row(what=f"{what}: peak memory", figure=f"{memory:.2f} GB", target="< 2 GB", reached=memory < MOST),
        Row(what=f"{what}: time", figure=f"{seconds:.0f} s ({1e3 * seconds / len(cameras) / frames:.0f} ms a picture)"),
    ]


def main() -> None:
    """Read FOLDER into VIEWS and print seconds and gigabytes."""
    folder, views = map(Path, sys.argv[1:])
    begin = time.perf_counter()
    training_views(read_capture(folder, strict=False), views)
    print(time.perf_counter() - begin, peak_memory())


if __name__ == "__main__":
    main()
