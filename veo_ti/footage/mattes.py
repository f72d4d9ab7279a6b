"""What `veo matte` does: cut the object out of every frame of every camera, and say which frames look wrong."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from recon.cameras import Camera
from recon.mattes.report import MatteFacts, judged
from recon.plush.calibration import camera_of, read_calibration
from recon.plush.capture import CALIBRATION, ENDING, MARKERS
from recon.plush.markers import read_markers
from recon.video import VideoFile
from sim.checks import require
from veo_ti.footage.matte_cut import Cutter, Markers, MatteChoice, file_digest
from veo_ti.footage.matte_files import matted
from veo_ti.footage.matte_report import write_matte_report
from veo_ti.footage.plates import Plate, plates_of
from veo_ti.footage.sources import video_names, video_of, video_place
from veo_ti.kept import key_of
from veo_ti.store import writable_folder, write_json_atomic

SCHEMA = 1


def matte_folder(
    folder: str | Path,
    choice: MatteChoice,
    out: str | Path | None = None,
    *,
    only: Sequence[str] = (),
    say: Callable[[str], None] | None = None,
) -> dict[str, object]:
    """Write capture/mattes/NAME/00000000.png, ... and the plates used; mattes.json, pictures and matte.html into out.

    out: FOLDER/matte when not given. only: cameras; all colour ones when empty. An interrupted call goes on with the
    frames that are missing; other settings make all of them anew. Raises ValueError naming file and camera for a
    camera or plate that is missing or of another size, mattes from elsewhere, and when nothing shows the object.
    """
    say, folder = say or (lambda text: None), Path(folder)
    videos = _videos(folder, only)
    session, options = choice.session, choice.options  # what is wrong with them is said before anything is written
    say("plates")
    plates = plates_of(folder, videos, choice.plate_frame, choice.plates)
    out = writable_folder(folder / "matte" if out is None else out)
    cameras, markers, notes = ({}, (), []) if choice.nozzle else _nozzle(folder, videos)
    network, facts = file_digest(choice.network), {}
    for name, video in videos.items():
        cut = Cutter(
            plate=plates[name].image, options=options, session=session, camera=cameras.get(name), markers=markers
        )
        key = key_of(SCHEMA, video.identity, network, *cut.parts)
        facts[name] = matted(video, video_place(folder) / "mattes" / name, key, cut, say)
    _require_object(folder, facts)
    found = _facts(choice, plates, cameras, facts, notes)
    write_json_atomic(out / "mattes.json", found)
    say("pictures")
    write_matte_report(found, videos, folder, out)
    return found


def _videos(folder: Path, only: Sequence[str]) -> dict[str, VideoFile]:
    names = video_names(folder)
    require(len(names) > 0, "FOLDER", f"hold videos capture/cam0001{ENDING}, ...", repr(str(folder)))
    strange = sorted(set(only) - set(names))
    require(not strange, "--camera", f"be among {', '.join(names)}", ", ".join(strange))
    chosen = [name for name in names if name in only] if only else [name for name in names if "." not in name]
    return {name: video_of(folder, name) for name in chosen or names}


def _nozzle(folder: Path, videos: Mapping[str, VideoFile]) -> tuple[dict[str, Camera], Markers, list[str]]:
    """The cameras whose place is known and the marker's poses, where the recording has both."""
    place = video_place(folder)
    if not (place / CALIBRATION).exists() or not (place / MARKERS).exists():
        return {}, (), ["the nozzle stays in the mattes: that it is cut out takes veo calibrate and veo track first."]
    markers = read_markers(place / MARKERS)
    if not any(m is not None for m in markers):
        return {}, (), [f"the nozzle stays in the mattes: {MARKERS} knows no pose; veo track finds them."]
    entries = read_calibration(place / CALIBRATION)
    cameras = {n: camera_of(n, entries[n], video.size) for n, video in videos.items() if n in entries}
    unknown = [name for name in videos if name not in entries]
    notes = [f"{name}: the nozzle stays in its mattes; {CALIBRATION} lacks the camera." for name in unknown]
    count = next(iter(videos.values())).count
    blind = count - sum(m is not None for m in markers[:count])
    notes += [f"the nozzle stays in the mattes of {blind} frames in which its marker was not seen."] if blind else []
    return cameras, markers, notes


def _require_object(folder: Path, facts: Mapping[str, Sequence[MatteFacts]]) -> None:
    """Raise ValueError when no frame of any camera shows anything."""
    shown = any(fact.area for few in facts.values() for fact in few)
    videos = ", ".join(f"{name}{ENDING}" for name in facts) if len(facts) < 8 else f"{len(facts)} videos"
    got = "an empty matte in every frame: try --threshold, or a plate that does not show it"
    require(shown, f"{videos} of {folder.resolve().name}", "show the object", got)


def _facts(
    choice: MatteChoice,
    plates: Mapping[str, Plate],
    cameras: Mapping[str, Camera],
    facts: Mapping[str, Sequence[MatteFacts]],
    notes: Sequence[str],
) -> dict[str, object]:
    reports = {name: judged(name, few) for name, few in facts.items()}
    frames, bad = sum(map(len, facts.values())), sum(int(report.bad.sum()) for report in reports.values())
    wrong = f"{bad} of them look wrong" if bad else "none of them looks wrong"
    return {
        "sentence": f"{frames} mattes of {len(facts)} cameras, by {_how(choice, plates)}; {wrong}.",
        "cameras": {
            name: {
                "plate": plates[name].source,
                "nozzle_cut_out": name in cameras,
                "frames": len(few),
                "bad_frames": np.flatnonzero(reports[name].bad).tolist(),
                "object_share": float(np.mean([f.area for f in few])),
                "sentences": list(reports[name].sentences),
            }
            for name, few in facts.items()
        },
        "sentences": [*notes, *(said for report in reports.values() for said in report.sentences)],
    }


def _how(choice: MatteChoice, plates: Mapping[str, Plate]) -> str:
    """What decided, in words."""
    if choice.network is not None:
        return f"the network {Path(choice.network).name}"
    bare = [name for name, plate in plates.items() if plate.image is None]
    level = "" if choice.threshold is None else f" above {choice.threshold:g} of 255"
    by_plate = f"the difference from the empty scene{level}"
    by_brightness = f"brightness{level}" if level else "what is brighter than the dark cloth"
    if not bare:
        return by_plate
    if len(bare) == len(plates):
        return f"{by_brightness} (there is no plate)"
    return f"{by_plate}, and for {', '.join(bare)}, without a plate, by {by_brightness}"
