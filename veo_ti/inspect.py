"""What a recording holds, before anything is computed from it: `veo inspect`."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from recon.cameras import ROLES
from recon.capture import Capture
from recon.crop import FIRST_THRESHOLD
from recon.exchange.nerfstudio import FILE as TRANSFORMS
from recon.exchange.nerfstudio import read_transforms
from recon.hull import Hull
from recon.plush.capture import read_capture
from recon.sync import Sync, estimate_offsets, motion_energy
from sim.checks import require
from veo_ti.inspect_object import nozzle_regions, object_hull, object_matte
from veo_ti.inspect_pictures import contact_sheet, nozzle_plot, rig_picture, sync_plot
from veo_ti.report import Section, Table, write_report
from veo_ti.store import writable_folder, write_json_atomic

THUMBNAIL = 220  # [px], width of a picture on the contact sheet
ALL_THERE = "every part of the layout is there"


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """What was seen of one camera: a small picture, the object in it (height, width) bool, its motion energy (F,)."""

    name: str
    picture: np.ndarray
    matte: np.ndarray
    energy: np.ndarray


def inspect_folder(
    folder: str | Path,
    out: str | Path | None = None,
    *,
    frames: int = 240,
    threshold: int = FIRST_THRESHOLD,
    say: Callable[[str], None] | None = None,
) -> dict[str, object]:
    """Look at a PLUSH folder, or one with a transforms.json; write pictures, inspect.json and inspect.html.

    out: where to, `inspect` in the folder itself when not given; frames: most consecutive frames, round the middle
    one, that are compared between cameras; threshold of 255: what is brighter counts as object where there are no
    mattes; say: told what is being done. Parts that are missing or wrong are named, not raised.
    Raises ValueError for a folder without any video or picture that can be read.
    """
    folder = Path(folder)
    require(folder.is_dir(), "FOLDER", "be a folder with a recording", repr(str(folder)))
    out = writable_folder(folder / "inspect" if out is None else out)
    require(frames >= 2, "frames", "be at least 2", frames)
    say = say or (lambda text: None)
    say("which parts are there")
    capture = _read(folder)
    notes = list(capture.missing)
    nozzle = nozzle_regions(folder, capture, len(capture.times) // 2, notes)
    looks = _looks(capture, frames, threshold, nozzle, say, notes)
    hull = object_hull(capture, {look.name: look.matte for look in looks}, nozzle, notes)
    sync = _sync(looks)
    facts = _facts(capture, looks, hull, sync, notes)
    say("pictures")
    sections = _sections(capture, looks, hull, sync, facts, out)
    write_json_atomic(out / "inspect.json", facts)
    write_report(out / "inspect.html", f"Recording {folder.resolve().name}", str(facts["sentence"]), sections)
    return facts


def _read(folder: Path) -> Capture:
    return read_transforms(folder) if (folder / TRANSFORMS).exists() else read_capture(folder, strict=False)


def _window(capture: Capture, frames: int) -> tuple[int, int]:
    """First and last but one of the frames looked at, with the middle one among them."""
    count = len(capture.times)
    start = max(0, count // 2 - frames // 2)
    return start, min(count, start + frames)


def _looks(
    capture: Capture, frames: int, threshold: int, nozzle: Mapping[str, np.ndarray], say: Callable[[str], None],
    notes: list[str],
) -> list[Look]:  # fmt: skip
    """One pass over each camera's frames; a camera that cannot be decoded becomes a note."""
    looks = []
    for name in capture.names:
        say(f"{name}, {len(looks) + 1} of {len(capture.names)}")
        try:
            looks.append(_look(capture, name, *_window(capture, frames), threshold, nozzle.get(name)))
        except ValueError as error:
            notes.append(f"{error}: that camera is not looked at.")
    require(len(looks) > 0, "FOLDER", "hold a camera whose frames can be read", " ".join(notes))
    return looks


def _look(capture: Capture, name: str, start: int, stop: int, threshold: int, nozzle: np.ndarray | None) -> Look:
    middle, kept = len(capture.times) // 2, []
    energy = motion_energy(_keeping(capture.sources[name].frames(start, stop), middle - start, kept))
    image = kept[0]
    size = THUMBNAIL, max(1, round(THUMBNAIL * image.shape[0] / image.shape[1]))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    matte = object_matte(capture, name, middle, image, threshold, nozzle)
    return Look(name=name, picture=small, matte=matte, energy=energy)


def _keeping(images: Iterable[np.ndarray], place: int, kept: list[np.ndarray]) -> Iterator[np.ndarray]:
    """The images unchanged; the one at that place is also kept."""
    for number, image in enumerate(images):
        if number == place:
            kept.append(image)
        yield image


def _sync(looks: Sequence[Look]) -> Sync | None:
    """Who is out of step; nothing where there is one device only."""
    devices = [look.name.partition(".")[0] for look in looks]
    energy = np.stack([look.energy for look in looks])
    return estimate_offsets(energy, devices=devices) if len(set(devices)) > 1 else None


def _facts(
    capture: Capture, looks: Sequence[Look], hull: Hull | None, sync: Sync | None, notes: Sequence[str]
) -> dict[str, object]:
    told = {look.name: i for i, look in enumerate(looks) if sync is not None and sync.known[i]}
    offsets = {look.name: int(sync.offset[told[look.name]]) if look.name in told else None for look in looks}
    late = [f"{name} by {offset:+d} frames" for name, offset in offsets.items() if offset]
    rate = float(1 / np.diff(capture.times).mean()) if len(capture.times) > 1 else None
    nozzle = capture.nozzle
    size_mm = 1e3 * np.ptp(hull.points, axis=0) + 1e3 * hull.spacing if hull is not None else None
    return {
        "sentence": _sentence(capture, rate, _steps(late, looks, told, sync), len(notes)),
        "cameras": len(capture.names),
        "calibrated": len(capture.cameras),
        "frames": len(capture.times),
        "frames_per_second": rate,
        "offset_frames": offsets,
        "object_share": {look.name: float(look.matte.mean()) for look in looks},
        "hull_size_mm": None if size_mm is None else size_mm.round(1).tolist(),
        "hull_middle_m": None if hull is None else hull.points.mean(axis=0).tolist(),
        "nozzle_frames_seen": None if nozzle is None else int(nozzle.seen.sum()),
        "missing": list(notes),
    }


def _steps(late: Sequence[str], looks: Sequence[Look], told: Mapping[str, int], sync: Sync | None) -> str:
    """Who is out of step, in words; nothing for a camera alone."""
    if sync is None:
        return ""
    if not sync.enough:
        return "too few frames to tell whether the cameras are in step; "
    unknown = [look.name for look in looks if look.name not in told]
    words = [f"out of step: {', '.join(late)}"] if late else [] if unknown else ["all cameras in step"]
    verb = "is" if len(unknown) == 1 else "are"
    words += [f"too little moves to tell whether {', '.join(unknown)} {verb} in step"] if unknown else []
    return "".join(f"{word}; " for word in words)


def _sentence(capture: Capture, rate: float | None, step: str, notes: int) -> str:
    speed = f" at {rate:.4g} frames a second" if rate else ""
    rest = f"{notes} {'thing is' if notes == 1 else 'things are'} missing or wrong" if notes else ALL_THERE
    return f"{len(capture.names)} cameras, {len(capture.times)} frames{speed}; {step}{rest}."


def _sections(
    capture: Capture, looks: Sequence[Look], hull: Hull | None, sync: Sync | None, facts: dict[str, object], out: Path
) -> list[Section]:
    """The page's parts; their pictures are written into `out` as they are made."""
    notes = [[note] for note in facts["missing"]]
    lacking = Section(
        heading="What is missing or wrong",
        text="Each line says what can still be done." if notes else f"Nothing: {ALL_THERE}.",
        table=Table(columns=["part"], rows=notes) if notes else None,
    )
    sheet = contact_sheet({look.name: look.picture for look in looks}, out / "contact_sheet.png")
    sections = [
        lacking,
        Section(heading="Cameras", text="What each camera has.", table=_table(capture, looks, hull, facts)),
        Section(heading="Pictures", text="The middle frame of every camera.", pictures=[sheet]),
    ]
    if colour := capture.chosen(ROLES, ("colour",)):
        text = "Dark: cameras that teach; orange: cameras that judge. "
        text += "The body is what the cameras' bright parts have in common, without what can be the nozzle; "
        text += "the green line is the nozzle's way."
        path = rig_picture(colour, hull, capture.nozzle, out / "rig.png")
        sections.append(Section(heading="The rig", text=text, pictures=[path]))
    if sync is not None:
        text = "What moves, moves in all pictures at once: a curve that is shifted belongs to a camera out of step."
        energy, first = np.stack([look.energy for look in looks]), _window(capture, len(looks[0].energy) + 1)[0]
        path = sync_plot([look.name for look in looks], energy, first, sync, out / "sync.png")
        sections.append(Section(heading="Are all cameras in step?", text=text, pictures=[path]))
    if capture.nozzle is not None:
        text = "Where no camera saw the marker the path is the nearest known pose: no force is known there."
        path = nozzle_plot(capture.times, capture.nozzle, out / "nozzle.png")
        sections.append(Section(heading="The nozzle", text=text, pictures=[path]))
    return sections


def _table(capture: Capture, looks: Sequence[Look], hull: Hull | None, facts: dict[str, object]) -> Table:
    columns = ["camera", "role", "pixels", "frames", "object fills", "away [mm]", "late by", "mattes", "plate"]
    shares = {look.name: f"{100 * look.matte.mean():.1f} %" for look in looks}
    calibrated = {camera.name: camera for camera in capture.cameras}
    rows = []
    for name, source in capture.sources.items():
        camera, late = calibrated.get(name), facts["offset_frames"].get(name)
        away = None if camera is None or hull is None else np.linalg.norm(camera.centre - hull.points.mean(axis=0))
        rows.append([
            name, "not calibrated" if camera is None else camera.role, f"{source.size[0]} x {source.size[1]}",
            source.count, shares.get(name, "not read"), "-" if away is None else f"{1e3 * away:.0f}",
            "cannot be told" if late is None else late, "yes" if name in capture.mattes else "-",
            "yes" if name in capture.plates else "-",
        ])  # fmt: skip
    return Table(columns=columns, rows=rows)
