"""The `veo` commands for recordings, before anything is reconstructed from them; heavy packages load inside."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

Folder = Annotated[Path, Parameter(name="FOLDER")]


def inspect(folder: Folder, *, out: Path | None = None, frames: int = 240, threshold: int = 32) -> dict[str, object]:
    """Look at a recording: cameras, object, the nozzle's path, what is out of step or missing.

    Parameters
    ----------
    folder
        a PLUSH object folder, or one with a transforms.json.
    out
        folder for the pictures and inspect.html; FOLDER/inspect when not given.
    frames
        how many frames around the middle one are compared between cameras.
    threshold
        of 255; what is brighter counts as the object where the recording has no mattes.
    """
    from veo_ti.inspect import inspect_folder
    from veo_ti.progress import waiting

    with waiting("inspect") as say:
        return inspect_folder(folder, out, frames=frames, threshold=threshold, say=say)
