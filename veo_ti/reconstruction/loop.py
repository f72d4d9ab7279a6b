"""The whole way: a recording with mattes becomes an object, judged, pushed and seen under forces nobody filmed."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from recon.images import shown, write_image
from recon.quality.similarity import QualityRow
from recon.radiance.storage import load_trained
from recon.views import Views
from veo_ti.commands import identified
from veo_ti.identification import Identification
from veo_ti.observation import Observation
from veo_ti.observation_files import PLUSH_FRAME_RATE
from veo_ti.progress import console, waiting
from veo_ti.reconstruction.driven import driven_frames
from veo_ti.reconstruction.novel import film_novel
from veo_ti.reconstruction.rerender import Rerenderer, table_two
from veo_ti.reconstruction.run import (
    CLOUD,
    FIELD,
    ReconstructChoice,
    capture_of,
    judging_views,
    lpips_or_none,
    reconstruct_folder,
)
from veo_ti.report import Section, Table, write_report
from veo_ti.results import gained, sentence, write_identification
from veo_ti.store import read_sequence, writable_folder, write_json_atomic

_MEASURES = ("PSNR", "SSIM", "LPIPS")
_MOST = 6  # held-out frames that are rendered for Table 2


def run_recording(folder: Path, out: Path, choice: ReconstructChoice, *, modes: int, every: int) -> dict[str, object]:
    """Reconstruct, identify, judge, render what was held out, film two novel interactions; index.html tells all of it.

    Every stage is resumed, and skipped when what it was made from is unchanged. Raises what its stages raise.
    """
    out = writable_folder(out)
    cloud, material = out / "reconstruction", out / "material"
    with waiting("reconstruct") as say:
        facts = reconstruct_folder(folder, cloud, choice, say)
    console.print(facts["sentence"])
    observation = _observed(cloud, folder.resolve().name)
    driven = driven_frames(observation)
    left = _numbers(np.delete(observation.time, driven))
    if left:
        console.print(_left_out(left))
    result = identified(observation.frames(driven), material, modes, every, paper=False)
    metrics = write_identification(result, result.observation, material, last=True)
    console.print(sentence(metrics))
    with waiting("re-rendering") as say:
        say("held-out frames")
        renderer = Rerenderer(
            trained=load_trained(cloud / FIELD), rest=result.object.x, spacing=result.object.cloud.spacing
        )
        judges = judging_views(capture_of(folder, choice), cloud, choice)
        tables, picture = _tables(renderer, judges, result)
        say("what nobody filmed")
        novel = film_novel(result.object, renderer, out)
    write_image(out / "simulated.png", picture)
    told = _told(tables, metrics)
    found = {"sentence": told, "left_out_frames": left, "reconstruction": facts, "material": metrics, "novel": novel,
             "table_2": {name: asdict(row) for name, row in tables.items()}}  # fmt: skip
    write_json_atomic(out / "run.json", found)
    write_report(out / "index.html", f"Virtual elastic object {folder.resolve().name}", told, _sections(out, found))
    console.print(told)
    return found


def _observed(cloud: Path, name: str) -> Observation:
    """The 4D cloud as a measurement, perhaps thinned; which points are surface, the PLUSH layout does not hold."""
    observation, stored = Observation.load(str(cloud)), read_sequence(cloud / CLOUD)
    same = cKDTree(stored.points[0]).query(observation.points[0])[1]
    return replace(observation, surface=stored.static["surface"].astype(bool)[same], name=name)


def _tables(
    renderer: Rerenderer, judges: Views, result: Identification
) -> tuple[dict[str, QualityRow], np.ndarray]:  # fmt: skip
    """Both halves of Table 2 on held-out frames and cameras, and pictures: filmed, reconstructed, simulated."""
    held = result.held_out if len(result.held_out) else result.train[1:]
    held = held[np.unique(np.linspace(0, len(held) - 1, _MOST).astype(int))]
    frames = _numbers(result.observation.time[held])
    measure = lpips_or_none()
    rows, views = {}, []
    for name, states in (("reconstructed", result.observation.points[held]), ("simulated", result.model.y[held])):
        rows[name], pictures = table_two(renderer, judges, frames, states, measure)
        views.append(pictures[0])
    row = np.concatenate([judges.images[0][frames[0]] / 255, *views], axis=1)
    return rows, shown(row)


def _numbers(times: np.ndarray) -> list[int]:
    """Of the recording's frames."""
    return np.round(times * PLUSH_FRAME_RATE).astype(int).tolist()


def _left_out(frames: Sequence[int]) -> str:
    those = f"Frames {', '.join(map(str, frames))} move though the nozzle's air does not meet the object: something "
    return those + "else does, with a force that nobody measured. They taught the reconstruction, but not the material."


def _told(tables: Mapping[str, QualityRow], metrics: Mapping[str, object]) -> str:
    gap = tables["reconstructed"].masked.psnr - tables["simulated"].masked.psnr
    held = metrics["error_mm"]["held_out"] or metrics["error_mm"]["training"]
    side = "worse" if gap >= 0 else "better"
    return (
        f"Simulated under held-out forces, the object is {held['mean']:.2f} mm from where it was reconstructed, and "
        f"its pictures are {abs(gap):.2f} dB {side} than those of the reconstruction itself."
    )


def _sections(out: Path, found: Mapping[str, object]) -> list[Section]:
    metrics, errors = found["material"], []
    for name, key in (("learned material", "error_mm"), ("one homogeneous material", "error_mm_homogeneous"),
                      ("no motion", "error_mm_no_change")):  # fmt: skip
        row = metrics[key]["held_out"] or metrics[key]["training"]
        errors.append((name, row["mean"], row["p95"], row["max"]))
    quality = [
        (name, *(row[part][m] if row[part][m] is not None else "not measured" for part in ("not_masked", "masked")
                 for m in ("psnr", "ssim", "lpips")))
        for name, row in found["table_2"].items()
    ]  # fmt: skip
    novel, left = found["novel"], found["left_out_frames"]
    return [
        Section(heading="Reconstruction", text=str(found["reconstruction"]["sentence"]),
                pictures=(out / "reconstruction/held_out.png", out / "reconstruction/cloud.png")),
        Section(heading="Material", pictures=(out / "material/mu.png",),
                text="How stiff each point is (forces are known up to scale, so stiffness is relative), and how far "
                "the simulation is from the reconstruction on held-out frames [mm] (the paper's Table 1)."
                + gained(metrics) + (f" {_left_out(left)}" if left else ""),
                table=Table(columns=("", "average", "95 %", "largest"), rows=errors)),
        Section(heading="Seen again", pictures=(out / "simulated.png",),
                text="A held-out frame: filmed, rendered from the reconstructed cloud, and from the simulated one; "
                "below the paper's Table 2, whole pictures and then the object on black.",
                table=Table(columns=("cloud", *_MEASURES, *(f"{m}, masked" for m in _MEASURES)), rows=quality)),
        Section(heading="What nobody filmed", pictures=(out / "push.mp4", out / "ball.mp4"),
                text=f"A push from the side that moves the object by {novel['push']['largest_displacement_mm']:.0f} mm "
                f"({novel['push']['status']}), and a ball pressed on it ({novel['ball']['status']})."),
    ]  # fmt: skip
