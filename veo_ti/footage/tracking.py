"""What `veo track` does: follow the nozzle's marker through all cameras that see it, and say where it was not seen."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from recon.cameras import Camera
from recon.capture import Capture
from recon.crop import spread_images
from recon.files import replacing
from recon.marker import Marker
from recon.nozzle.finds import Finds, detections, finds_in
from recon.nozzle.path import NozzleTrack, nozzle_path, track_of
from recon.plush.capture import MARKERS, read_capture
from recon.plush.capture_writer import write_markers
from recon.plush.reconstruction import MARKER_ID, NozzlePath, read_nozzle
from sim.checks import require
from veo_ti.footage.sources import video_place
from veo_ti.footage.track_report import track_facts, write_track_report
from veo_ti.kept import kept, key_of
from veo_ti.store import writable_folder, write_json_atomic

PROBED = 48  # pictures of each camera, evenly spread, in which the marker is looked for before it is followed
SCHEMA = 1


def track_folder(
    folder: str | Path,
    out: str | Path | None = None,
    *,
    marker: Marker,
    replace: bool = False,
    only: Sequence[str] = (),
    say: Callable[[str], None] | None = None,
) -> dict[str, object]:
    """Follow the marker; write aruco_path.json, track.npz, track.json, track.png and track.html into out.

    out: FOLDER/track when not given. capture/aruco_path.json is written too, unless there is one that knows a pose
    and `replace` is not given. only: cameras to follow the marker with; all that show it when empty. What was found
    is kept in out/finds, so that an interrupted call goes on from there.
    Raises ValueError naming cameras when none is calibrated, none shows the marker, or no frame gives a pose.
    """
    say, folder = say or (lambda text: None), Path(folder)
    say("which parts are there")
    capture = read_capture(folder, strict=False)
    notes, cameras = _own_notes(capture), _chosen(capture, only)
    out = writable_folder(folder / "track" if out is None else out)
    finds = {camera.name: _finds(capture, camera, marker, bool(only), out / "finds", say) for camera in cameras}
    blind = [name for name, found in finds.items() if not len(found.frame)]
    followed = [camera for camera in cameras if camera.name not in blind]
    _require_marker(marker, finds, followed)
    found = detections([finds[camera.name] for camera in followed])
    say("poses")
    track = track_of(followed, found, len(capture.times), marker=marker)
    _write_track(out / "track.npz", track)
    poses = [T if seen else None for T, seen in zip(track.T_world_marker, track.seen, strict=True)]
    write_markers(out / MARKERS, poses)
    goal = video_place(folder) / MARKERS
    before = _before(goal, len(poses), notes)
    written = replace or before is None
    if written:
        write_markers(goal, poses)
    if marker.id != MARKER_ID:
        notes.append(f"{MARKERS} names marker {marker.id} as {MARKER_ID}, the id that the layout gives the nozzle's.")
    facts = track_facts(track, capture.times, marker, blind=blind, notes=notes, before=before, written=written)
    write_json_atomic(out / "track.json", facts)
    say("pictures")
    write_track_report(facts, capture.times, nozzle_path(track), folder, out)
    return facts


def _own_notes(capture: Capture) -> list[str]:
    """What is missing, but for the markers, which are being looked for, and what only others need."""
    return [note for note in capture.missing if MARKERS not in note and "left and right" not in note]


def _chosen(capture: Capture, only: Sequence[str]) -> list[Camera]:
    require(len(capture.cameras) > 0, "FOLDER", "hold calibrated cameras: veo calibrate", " ".join(capture.missing))
    strange = sorted(set(only) - {camera.name for camera in capture.cameras})
    require(not strange, "--camera", f"be among the {len(capture.cameras)} calibrated ones", ", ".join(strange))
    return [camera for camera in capture.cameras if not only or camera.name in only]


def _finds(
    capture: Capture, camera: Camera, marker: Marker, surely: bool, folder: Path, say: Callable[[str], None]
) -> Finds:
    """The marker in one camera's film, all of it where a sample shows the marker, or surely."""
    source = capture.sources[camera.name]

    def find() -> dict[str, np.ndarray]:
        say(f"{camera.name}, is the marker there")
        found = finds_in(camera, spread_images(source, PROBED), marker)
        if (surely or len(found.frame)) and source.count > PROBED:
            say(f"{camera.name}, {source.count} frames")
            found = finds_in(camera, source.frames(), marker)
        return {name: getattr(found, name) for name in ("frame", "corners", "others")}

    lens = (camera.K, camera.distortion)
    key = key_of(SCHEMA, source.identity, PROBED, surely, *lens, marker)
    return Finds(**kept(folder / f"{camera.name}.npz", key, find))


def _require_marker(marker: Marker, finds: dict[str, Finds], followed: Sequence[Camera]) -> None:
    """Raise ValueError unless some camera shows the marker, naming the ids that are shown instead."""
    others = {int(i) for found in finds.values() for i in found.others}
    got = f"ids {', '.join(map(str, sorted(others)))}" if others else "no marker at all"
    names = f"one of {', '.join(finds)}" if len(finds) < 8 else f"one of {len(finds)} cameras"
    require(len(followed) > 0, f"marker {marker.id} of {marker.dictionary}", f"be seen by {names}", got)


def _write_track(path: Path, track: NozzleTrack) -> None:
    names = ("T_world_marker", "covariance", "seen", "views", "guided")
    with replacing(path) as partial:
        np.savez_compressed(partial, **{name: getattr(track, name) for name in names})


def _before(path: Path, frames: int, notes: list[str]) -> NozzlePath | None:
    """The path that the folder had, None when it knows no pose; one that cannot be read is not overwritten."""
    try:
        path_before = read_nozzle(path, frames)
    except ValueError as error:
        notes.append(f"{error}.")
        nothing = np.zeros((frames, 3))
        return NozzlePath(position=nothing, direction=nothing, seen=np.zeros(frames, bool))
    return path_before
