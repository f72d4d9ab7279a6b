"""The `veo` command that turns a recording into a field and a cloud; heavy packages load inside."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def reconstruct(
    folder: Annotated[Path, Parameter(name="FOLDER")],
    *,
    out: Path,
    test: list[str] | None = None,
    resolution: int = 128,
    canonical_steps: int = 1200,
    motion_steps: int = 4000,
    points: int = 12_000,
    greys: bool = False,
    paper: bool = False,
    seed: int = 0,
) -> dict[str, object]:
    """Turn a recording with mattes into a field that can be rendered and a point cloud in correspondence over time.

    Parameters
    ----------
    folder
        a PLUSH object folder, or one with a transforms.json.
    out
        folder for the results; an interrupted run goes on when called again.
    test
        cameras that judge and never teach; one in six when not given.
    resolution
        of the training pictures, longer side in pixels.
    canonical_steps
        of training the first frame.
    motion_steps
        of training all frames.
    points
        at most so many in the cloud.
    greys
        the left and right cameras teach too.
    paper
        the paper's positional encoding and large network instead of the hash grid; hours on a CPU.
    seed
        of everything random.
    """
    from recon.radiance.extraction import ExtractOptions
    from recon.radiance.fields import FieldOptions
    from recon.radiance.training import TrainOptions
    from veo_ti.progress import waiting
    from veo_ti.reconstruction.run import ReconstructChoice, reconstruct_folder

    options = FieldOptions.paper() if paper else FieldOptions()
    training = TrainOptions(canonical_steps=canonical_steps, motion_steps=motion_steps, field=options, seed=seed)
    choice = ReconstructChoice(
        resolution=resolution,
        test=tuple(test or ()),
        greys=greys,
        train=training,
        extract=ExtractOptions(points=points),
    )
    with waiting("reconstruct") as say:
        return reconstruct_folder(folder, out, choice, say)


def is_recording(folder: Path) -> bool:
    """Whether a folder holds videos and mattes, and no reconstruction."""
    held = (folder / "capture" / "mattes").is_dir() or (folder / "transforms.json").exists()
    return held and not (folder / "reconstruction").exists()


def run_recording(folder: Path, out: Path, modes: int, every: int) -> dict[str, object]:
    """`veo run` of a recording, everything with its defaults."""
    from veo_ti.reconstruction.loop import run_recording as run
    from veo_ti.reconstruction.run import ReconstructChoice

    return run(folder, out, ReconstructChoice(), modes=modes, every=every)
