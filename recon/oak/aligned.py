"""A finished recording in the PLUSH layout: only the pictures that every camera took together."""

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from recon.cameras import Camera
from recon.files import replacing, write_json
from recon.oak.pairing import Clocks, Groups, StreamTimes, clocks, pair
from recon.oak.recording import PLACE, RecordedStream, read_stream
from recon.oak.remux import contained, decodable
from recon.oak.spec import DeviceSpec, RigSpec, StreamSpec, load_rig
from recon.plush.calibration import camera_of, read_calibration
from recon.plush.capture import MARKERS
from recon.plush.capture_writer import write_capture
from recon.plush.markers import read_markers
from recon.video import VideoFile
from sim.checks import require

TURNS = {90: cv2.ROTATE_90_COUNTERCLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_CLOCKWISE}
GROUPS = "groups.csv"
FEW = 0.9  # of the moments that could be groups: below it the report says what would give more
EARLY = 1.0  # [s], by which a camera that was lost ended before the others
UNCALIBRATED = (
    "The cameras' places to one another are not known: calibration.json holds what each device knows of its own "
    "sensors, every device in its own frame; calibrate the rig before its pictures are used together."
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Finished:
    """A recording in the PLUSH layout: its folder, what was paired, the clocks, and sentences about both."""

    folder: Path
    groups: Groups
    clocks: Clocks
    sentences: tuple[str, ...]


def finish_recording(
    folder: str | Path,
    cameras: Sequence[Camera],
    *,
    rig_calibrated: bool,
    without: Sequence[str] = (),
    on_camera: Callable[[str], None] = lambda _: None,
) -> Finished:
    """Pair what was recorded into `folder` and write its `capture/`; works on what a crash has left as well.

    cameras: one for each stream, of its upright pictures; rig_calibrated: whether their places to one another are
    known. without: names of devices or streams to leave out. on_camera gets the name of each stream as its turn comes.
    The recorded packets stay as they are; `recording/groups.csv` keeps the time of every group and each stream's
    picture in it, `recording/groups.json` the counts and the clocks. A track of the nozzle stays when the
    groups are the same as before.
    Raises ValueError when a stream was not recorded or has no camera, when times go backwards, or no group is
    complete; OSError, in one sentence, where the layout cannot be written, as on a full disk.
    """
    folder = Path(folder)
    spec = load_rig(folder / PLACE / "rig.json")
    chosen = _chosen(spec, without)
    known = _known(cameras, [name for name, _, _ in chosen])
    streams = [decodable(read_stream(folder / PLACE, name)) for name, _, _ in chosen]
    times = [StreamTimes(name=s.name, time=s.time) for s in streams]
    groups = pair(times, spec.sync_frames * spec.period)
    advice = _advice(times, groups, spec.period)
    require(len(groups.index) > 0, f"recording of {folder}", "hold pictures that all cameras took together", advice)
    kept = {
        name: _Kept(stream=stream, at=at, degrees=device.turned_deg, grey=sensor.stream != "colour")
        for stream, at, (name, device, sensor) in zip(streams, groups.index.T, chosen, strict=True)
    }
    run = clocks(times, groups)
    with _recording_kept(folder):
        table = _groups_table(streams, groups)
        track, gone = _track(folder, table, len(groups.index))
        write_capture(folder, known, spec.fps, lambda n: kept[n].pictures(on_camera), track)
        for stale in {name for device in spec.devices for name, _ in device.named()} - set(kept):
            (folder / "capture" / f"{stale}.aligned.mp4").unlink(missing_ok=True)
        with replacing(folder / PLACE / GROUPS) as partial:
            partial.write_text(table, encoding="ascii")
        write_json(folder / PLACE / "groups.json", _facts(groups, run, streams, rig_calibrated))
    sentences = (_count(groups), _damage(streams), advice, gone, "" if rig_calibrated else UNCALIBRATED)
    return Finished(folder=folder, groups=groups, clocks=run, sentences=tuple(s for s in sentences if s))


def _known(cameras: Sequence[Camera], names: Sequence[str]) -> list[Camera]:
    """The cameras of these names, in their order."""
    held = {camera.name: camera for camera in cameras}
    lacking = [name for name in names if name not in held]
    require(not lacking, "calibration", "hold a camera for every stream", f"none for {', '.join(lacking)}")
    return [held[name] for name in names]


@contextmanager
def _recording_kept(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        why = error.strerror or str(error)
        raise OSError(f"{folder} cannot be finished ({why}); what was recorded is kept: finish it later.") from None


def rig_cameras(folder: str | Path, path: str | Path) -> tuple[Camera, ...]:
    """The cameras of a recording's streams by a rig's calibration.json, as far as it has them, of upright pictures.

    Raises ValueError naming file and camera when one is damaged or of another size.
    """
    spec, entries = load_rig(Path(folder) / PLACE / "rig.json"), read_calibration(path)
    held = [(name, device, sensor.size) for name, device, sensor in _chosen(spec, ()) if name in entries]
    upright = [(name, size[::-1] if device.turned_deg % 180 else size) for name, device, size in held]
    return tuple(camera_of(name, entries[name], size, Path(path).name) for name, size in upright)


def _chosen(spec: RigSpec, without: Sequence[str]) -> list[tuple[str, DeviceSpec, StreamSpec]]:
    """Every stream that is to be in the layout: its name, device and sensor."""
    every = [(name, device, sensor) for device in spec.devices for name, sensor in device.named()]
    names = {name for name, _, _ in every} | {device.name for device in spec.devices}
    strange = sorted(set(without) - names)
    require(not strange, "without", "name cameras of the recording", ", ".join(strange))
    left = [item for item in every if item[0] not in without and item[1].name not in without]
    require(bool(left), "without", "leave a camera", ", ".join(without))
    return left


@dataclass(frozen=True, kw_only=True, eq=False)
class _Kept:
    """The pictures of one stream that are in groups."""

    stream: RecordedStream
    at: np.ndarray
    degrees: int
    grey: bool

    def pictures(self, on_camera: Callable[[str], None]) -> Iterator[np.ndarray]:
        """Upright, RGB or grey, in the order of the groups."""
        on_camera(self.stream.name)
        first, last, wanted = int(self.at[0]), int(self.at[-1]), set(self.at.tolist())
        with contained(self.stream) as path:
            video = VideoFile(path, grey=self.grey, camera=self.stream.name)
            require(video.count == len(self.stream.time), video.label, f"hold {len(self.stream.time)}", video.count)
            for number, image in enumerate(video.frames(first, last + 1), first):
                if number in wanted:
                    yield cv2.rotate(image, TURNS[self.degrees]) if self.degrees else image


def _advice(times: Sequence[StreamTimes], groups: Groups, period: float) -> str:
    """What would give more groups, or nothing where nearly every picture is in one."""
    most = min(len(s.time) for s in times)
    ends = np.array([s.time[-1] for s in times])
    early = sorted({s.name.split(".")[0] for s, end in zip(times, ends, strict=True) if end < ends.max() - EARLY})
    if early:
        gap = ends.max() - ends.min()
        return f"{', '.join(early)} ended up to {gap:.1f} s before the others: leave it out to pair the rest."
    if len(groups.index) >= FEW * most:
        return ""
    wider = pair(times, period)
    if len(wider.index) <= len(groups.index):
        return f"only {len(groups.index)} of {most} moments were seen by all cameras."
    needed = np.ceil(100 * np.quantile(wider.spread, 0.95) / period - 1e-6) / 100
    return (
        f"only {len(groups.index)} of {most} moments were seen by all cameras within {1e3 * groups.within:.1f} ms: "
        f"with sync_frames {needed:.2f} about {len(wider.index)} would be, with a trigger all."
    )


def _count(groups: Groups) -> str:
    count, streams, widest = len(groups.index), len(groups.names), 1e3 * groups.spread.max()
    left = f"{groups.incomplete} incomplete ones with {groups.dropped.sum()} pictures left out"
    return f"{count} complete groups of {streams} streams, the widest {widest:.2f} ms; {left}."


def _damage(streams: Sequence[RecordedStream]) -> str:
    hurt = [f"{s.damaged} of {s.name}" for s in streams if s.damaged]
    return f"Pictures that cannot be decoded were left out: {', '.join(hurt)}." if hurt else ""


def _track(folder: Path, table: str, frames: int) -> tuple[Sequence[np.ndarray | None], str]:
    """The nozzle's poses of frames that are grouped as before, else none; a sentence where some are lost by that."""
    path, before = folder / "capture" / MARKERS, folder / PLACE / GROUPS
    known = read_markers(path) if path.exists() else ()
    if len(known) == frames and before.exists() and before.read_text(encoding="ascii") == table:
        return known, ""
    lost = any(pose is not None for pose in known)
    return [None] * frames, f"{MARKERS} belonged to other groups and was emptied: veo track." if lost else ""


def _groups_table(streams: Sequence[RecordedStream], groups: Groups) -> str:
    """One line a group: its time from the first group on [s], then each stream's picture and how late it is [ms]."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time_s", *(column for s in streams for column in (f"{s.name}_picture", f"{s.name}_late_ms"))])
    for time, row in zip(groups.time, groups.index, strict=True):
        cells = [(s.number[i], f"{1e3 * (s.time[i] - time):.3f}") for s, i in zip(streams, row, strict=True)]
        writer.writerow([f"{time - groups.time[0]:.6f}", *(cell for pair in cells for cell in pair)])
    return text.getvalue()


def _facts(groups: Groups, run: Clocks, streams: Sequence[RecordedStream], rig_calibrated: bool) -> dict[str, object]:
    """What a person wants to know of a recording, as plain values."""
    return {
        "complete": len(groups.index),
        "incomplete": groups.incomplete,
        "within_ms": 1e3 * groups.within,
        "widest_ms": 1e3 * float(groups.spread.max()),
        "began_s": float(groups.time[0]),
        "rig_calibrated": rig_calibrated,
        "streams": {
            stream.name: {
                "pictures": len(stream.time),
                "left_out": int(groups.dropped[n]),
                "dropped_by_camera": stream.dropped,
                "damaged": stream.damaged,
                "late_ms": 1e3 * float(run.offset[n]),
                "drift_ppm": 1e6 * float(run.drift[n]),
            }
            for n, stream in enumerate(streams)
        },
    }
