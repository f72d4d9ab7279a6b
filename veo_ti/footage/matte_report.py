"""What the mattes look like: every camera's middle frame cut out, what looks wrong, and a page."""

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from recon.images import read_image
from recon.mattes.report import spelled
from recon.video import VideoFile
from veo_ti.footage.matte_files import matte_path
from veo_ti.footage.sources import video_place
from veo_ti.inspect_pictures import contact_sheet
from veo_ti.report import Section, Table, write_report

TILE = 150  # [px], width of a picture
GROUND = (214, 219, 232)  # behind what is cut out: neither dark cloth nor fur
MOST = 12  # bad frames shown


def write_matte_report(facts: dict[str, object], videos: Mapping[str, VideoFile], folder: Path, out: Path) -> None:
    """Write contact_sheet.png, bad_frames.png where there are any, and matte.html."""
    place, cameras = video_place(folder) / "mattes", facts["cameras"]
    middle = {name: _beside(video, place / name, video.count // 2) for name, video in videos.items()}
    sheet = contact_sheet(middle, out / "contact_sheet.png")
    text = "The middle frame of every camera, as filmed and cut out."
    sections = [Section(heading="Mattes", text=text, pictures=[sheet])]
    bad = [(name, frame) for name, camera in cameras.items() for frame in camera["bad_frames"]]
    (out / "bad_frames.png").unlink(missing_ok=True)
    if bad:
        spread = [bad[i] for i in np.unique(np.linspace(0, len(bad) - 1, MOST).round().astype(int))]
        shown = {f"{name} {frame}": _beside(videos[name], place / name, frame) for name, frame in spread}
        text = f"{len(bad)} frames look wrong; {len(spread)} of them are shown."
        picture = contact_sheet(shown, out / "bad_frames.png")
        sections.append(Section(heading="Frames that look wrong", text=text, pictures=[picture]))
    if facts["sentences"]:
        table = Table(columns=["what"], rows=[[said] for said in facts["sentences"]])
        sections.append(Section(heading="What to know", text="Of frames, cameras and files.", table=table))
    rows = [[name, c["plate"], c["frames"], f"{100 * c['object_share']:.2f} %", _spelled(c["bad_frames"])]
            for name, c in cameras.items()]  # fmt: skip
    table = Table(columns=["camera", "empty scene from", "frames", "object fills", "look wrong"], rows=rows)
    text = "A frame looks wrong when its matte is empty, cut off, overexposed, or suddenly of another size."
    sections.append(Section(heading="Cameras", text=text, table=table))
    write_report(out / "matte.html", f"Mattes of {folder.resolve().name}", str(facts["sentence"]), sections)


def _beside(video: VideoFile, place: Path, frame: int) -> np.ndarray:
    """The picture and what the matte cuts out of it, side by side, RGB uint8."""
    image = next(video.frames(frame, frame + 1))
    colour = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
    share = read_image(matte_path(place, frame), grey=True)[..., None] / np.float32(255)
    cut = np.round(share * colour + (1 - share) * GROUND).astype(np.uint8)
    size = TILE, max(1, round(TILE * colour.shape[0] / colour.shape[1]))
    return np.concatenate([cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in (colour, cut)], axis=1)


def _spelled(frames: list[int]) -> str:
    return spelled(np.array(frames)) if frames else "-"
