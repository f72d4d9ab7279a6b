"""One camera's mattes as files: made frame by frame, gone on with after an interruption, anew for other settings."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from recon.files import read_json, write_json
from recon.images import read_image, write_image
from recon.mattes.report import MatteFacts, facts_of
from recon.video import FrameSource
from sim.checks import require

Cut = Callable[[int, np.ndarray], np.ndarray]  # frame and picture -> matte in [0, 1]


def matted(source: FrameSource, place: Path, key: str, cut: Cut, say: Callable[[str], None]) -> list[MatteFacts]:
    """Write place/00000000.png, ... of every frame, 255 on the object; the facts of all of them.

    Beside the folder NAME.json keeps the key of what decides the mattes, and the facts when all are there: with the
    same key frames that are there are kept, with another one they are removed first. Raises ValueError for a folder
    of mattes that were not made here.
    """
    note = place.with_name(f"{place.name}.json")
    held = _claimed(place, note, key)
    if held is not None:
        return held
    facts = []
    for frame, fact in enumerate(_made(source, place, cut)):
        facts.append(fact)
        say(f"{place.name}, frame {frame + 1} of {source.count}")
    write_json(note, {"key": key, "facts": [[f.area, f.border, f.saturated] for f in facts]})
    return facts


def matte_path(place: Path, frame: int) -> Path:
    """Where the matte of a frame is."""
    return place / f"{frame:08d}.png"


def _claimed(place: Path, note: Path, key: str) -> list[MatteFacts] | None:
    """The facts of a folder that is complete; else it is made ready, with the frames that are still good in it."""
    place.mkdir(parents=True, exist_ok=True)
    files = [path for path in place.glob("*.png") if not path.name.startswith(".")]
    held = read_json(note) if note.exists() else {}
    ours = isinstance(held, dict) and "key" in held
    rule = "be made by veo matte, or be moved away"
    require(ours or not files, f"mattes/{place.name}", rule, f"{len(files)} mattes from elsewhere")
    for path in place.glob(".*.partial.png"):
        path.unlink()
    if held.get("key") != key:
        for path in files:
            path.unlink()
        write_json(note, {"key": key})
        return None
    rows = held.get("facts", [])
    whole = 0 < len(rows) == len(files)
    return [MatteFacts(area=a, border=b, saturated=s) for a, b, s in rows] if whole else None


def _made(source: FrameSource, place: Path, cut: Cut) -> Iterator[MatteFacts]:
    for frame, image in enumerate(source.frames()):
        path = matte_path(place, frame)
        if path.exists():
            levels = read_image(path, grey=True, label=f"mattes/{place.name}/{path.name}")
        else:
            levels = np.round(255 * cut(frame, image)).astype(np.uint8)
            write_image(path, levels)
        yield facts_of(levels / np.float32(255), image)
