"""The nozzle's track in numbers, a plot, a table of gaps, and a page."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from recon.marker import Marker
from recon.nozzle.path import NozzleTrack, nozzle_path, stream_covariance
from recon.plush.reconstruction import NozzlePath
from veo_ti.inspect_pictures import nozzle_plot
from veo_ti.report import Section, Table, write_report

KEPT = "capture/aruco_path.json was there and is kept (--replace writes over it)"


def track_facts(
    track: NozzleTrack,
    times: np.ndarray,
    marker: Marker,
    *,
    blind: Sequence[str],
    notes: Sequence[str],
    before: NozzlePath | None,
    written: bool,
) -> dict[str, object]:
    """The facts of track.json; blind: cameras that do not show the marker; before: the path the folder had."""
    place, turn = (np.sqrt(np.trace(c, axis1=1, axis2=2)) for c in stream_covariance(track))
    seen = track.seen
    count, place_mm, turn_deg = int(seen.sum()), float(1e3 * place[seen].mean()), float(np.degrees(turn[seen].mean()))
    gaps = _gaps(track, times, place, turn)
    apart = None if before is None else _apart(nozzle_path(track), before)
    missing = f"{len(seen) - count} frames in {len(gaps)} gaps know no pose" if gaps else "every frame has a pose"
    sentence = (
        f"The nozzle was found in {count} of {len(seen)} frames by {len(track.cameras)} cameras, where the stream "
        f"starts to {place_mm:.2g} mm and its direction to {turn_deg:.2g} degrees as far as the pictures' noise goes; "
        f"{missing}."
    )
    return {
        "sentence": sentence,
        "marker": {"id": marker.id, "side_mm": 1e3 * marker.side, "dictionary": marker.dictionary},
        "frames": len(seen),
        "frames_seen": count,
        "frames_guided": int(track.guided.sum()),
        "stream_start_error_mm": place_mm,
        "stream_direction_error_deg": turn_deg,
        "noise_px": track.noise_px,
        "cameras": {
            name: {"frames_rejected": int(rejected), "error_px": None if np.isnan(error) else float(error)}
            for name, rejected, error in zip(track.cameras, track.rejected, track.error_px, strict=True)
        },
        "cameras_without_marker": list(blind),
        "gaps": gaps,
        "from_the_path_before": apart,
        "written": written,
        "sentences": [*notes, *track.sentences, *([] if written else [_kept(apart)])],
    }


def write_track_report(facts: dict[str, object], times: np.ndarray, path: NozzlePath, folder: Path, out: Path) -> None:
    """Write track.png and track.html."""
    plot = nozzle_plot(times, path, out / "track.png")
    text = "Shaded: no camera saw the marker; nothing is written for these frames, and no force is known there."
    sections = [Section(heading="The path", text=text, pictures=[plot]), _gap_section(facts), _camera_section(facts)]
    if facts["sentences"]:
        table = Table(columns=["what"], rows=[[said] for said in facts["sentences"]])
        sections.append(Section(heading="What to know", text="Of frames, cameras and files.", table=table))
    write_report(out / "track.html", f"The nozzle of {folder.resolve().name}", str(facts["sentence"]), sections)


def _gap_section(facts: dict[str, object]) -> Section:
    text = "Runs of frames without a pose, and how far the stream's start may be from where the path was joined up."
    if not facts["gaps"]:
        return Section(heading="Gaps", text="None: the marker was found in every frame.")
    columns = ["first frame", "last frame", "frames", "seconds", "may be off by [mm]", "and [deg]"]
    rows = [[_shown(value) for value in gap.values()] for gap in facts["gaps"]]
    return Section(heading="Gaps", text=text, table=Table(columns=columns, rows=rows))


def _camera_section(facts: dict[str, object]) -> Section:
    rows = [[name, _shown(c["error_px"]), c["frames_rejected"]] for name, c in facts["cameras"].items()]
    rows += [[name, "-", "does not show the marker"] for name in facts["cameras_without_marker"]]
    text = "How far the marker's corners lie from where the joint pose puts them, and finds that agree with no pose."
    return Section(heading="Cameras", text=text, table=Table(columns=["camera", "error [px]", "left out"], rows=rows))


def _gaps(track: NozzleTrack, times: np.ndarray, place: np.ndarray, turn: np.ndarray) -> list[dict[str, object]]:
    """Every run of frames without a pose, with the largest standard error in it, None where it has no bound."""
    period = float(np.diff(times).mean()) if len(times) > 1 else 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], ~track.seen, [False]]).astype(int))).reshape(-1, 2)
    rows = []
    for first, last in edges.tolist():
        off = (1e3 * place[first:last].max(), np.degrees(turn[first:last].max()))
        known = [float(value) if np.isfinite(value) else None for value in off]
        rows.append({
            "first": first, "last": last - 1, "frames": last - first, "seconds": (last - first) * period,
            "error_mm": known[0], "error_deg": known[1],
        })  # fmt: skip
    return rows


def _apart(path: NozzlePath, before: NozzlePath) -> dict[str, object] | None:
    """Mean distance of the stream's start [mm] and of its direction [deg] where both paths know them."""
    both = path.seen & before.seen[: len(path.seen)]
    if not both.any():
        return None
    shift = np.linalg.norm(path.position[both] - before.position[: len(both)][both], axis=1)
    cosine = (path.direction[both] * before.direction[: len(both)][both]).sum(axis=1)
    turn = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return {"frames": int(both.sum()), "mean_mm": 1e3 * float(shift.mean()), "mean_deg": float(turn.mean())}


def _kept(apart: dict[str, object] | None) -> str:
    if apart is None:
        return f"{KEPT}."
    return f"{KEPT}; this track is {apart['mean_mm']:.2g} mm and {apart['mean_deg']:.2g} degrees from it on average."


def _shown(value: object) -> object:
    return "not known" if value is None else value
