"""The `veo` commands that turn a recording into a field and a cloud, and show results; heavy packages load inside."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

Device = Literal["cpu", "cuda"]


def reconstruct(
    folder: Annotated[Path, Parameter(name="FOLDER")],
    *,
    out: Path,
    test: list[str] | None = None,
    resolution: int = 128,
    canonical_steps: int = 600,
    motion_steps: int = 2000,
    points: int = 12_000,
    greys: bool = False,
    paper: bool = False,
    seed: int = 0,
    device: Device = "cpu",
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
    device
        what trains and renders: cpu, or cuda where torch has it.
    """
    use(device)
    from recon.radiance.extraction import ExtractOptions
    from recon.radiance.fields import FieldOptions
    from recon.radiance.options import TrainOptions
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


def render(
    obj: Annotated[Path, Parameter(name="OBJECT")],
    *,
    out: Path,
    view: str | None = None,
    orbit: int = 0,
    frame: int | None = None,
    size: int = 256,
    device: Device = "cpu",
) -> dict[str, object]:
    """Pictures of an OBJECT: Lame maps, what the data determined, a turntable film, its motion if it has one.

    Parameters
    ----------
    obj
        a folder of `veo identify`, a .vtkhdf, or a folder of `veo reconstruct`.
    out
        folder for the pictures.
    view
        of a reconstruction: the camera of the recording to look through.
    orbit
        of a reconstruction: pictures of a film that goes round it.
    frame
        of a reconstruction: which frame; in a film all of them pass when not given.
    size
        of a reconstruction's pictures, longer side in pixels.
    device
        what renders a reconstruction: cpu, or cuda where torch has it.
    """
    use(device)
    if is_reconstruction(obj):
        from veo_ti.reconstruction.orbit import render_reconstruction

        made = render_reconstruction(obj, out, view=view, orbit=orbit, frame=frame, size=size)
        return {"pictures": [str(path) for path in made]}
    from veo_ti.commands import render_object

    return {"pictures": [str(path) for path in render_object(obj, out)]}


def use(device: Device) -> None:
    """Start everything on the GPU where one is asked for; on the CPU it starts by itself, once needed."""
    if device != "cpu":
        from recon.radiance.device import use

        use(device)


def is_recording(folder: Path) -> bool:
    """Whether a folder holds videos and mattes, and no reconstruction."""
    held = (folder / "capture" / "mattes").is_dir() or (folder / "transforms.json").exists()
    return held and not (folder / "reconstruction").exists()


def is_reconstruction(folder: Path) -> bool:
    """Whether a folder holds a trained field."""
    return (folder / "field.pt").is_file()


def run_recording(folder: Path, out: Path, modes: int, every: int) -> dict[str, object]:
    """`veo run` of a recording, everything with its defaults."""
    from veo_ti.reconstruction.loop import run_recording as run
    from veo_ti.reconstruction.run import ReconstructChoice

    return run(folder, out, ReconstructChoice(), modes=modes, every=every)
