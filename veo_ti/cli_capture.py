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


def capture(
    *,
    out: Path | None = None,
    listed: Annotated[bool, Parameter(name="--list", negative="")] = False,
    spec: Path | None = None,
    seconds: float | None = None,
    calibration: Path | None = None,
    without: list[str] | None = None,
    finish: Annotated[bool, Parameter(negative="")] = False,
) -> dict[str, object]:
    """Record with OAK-D cameras into a PLUSH folder; Ctrl-C ends a recording, and nothing recorded is lost.

    Parameters
    ----------
    out
        folder for the recording.
    listed
        only list the cameras that are free.
    spec
        JSON of the rig: devices, sensors, sizes, exposure; every device that is free, with defaults, when not given.
    seconds
        how long; until Ctrl-C when not given.
    calibration
        calibration.json of the rig, in the PLUSH layout; each camera's own when not given.
    without
        cameras to leave out of the PLUSH folder.
    finish
        do not record: only make the PLUSH folder of what OUT holds, after a fault or once more.
    """
    from veo_ti import recording

    if listed:
        return recording.show_devices()
    if out is None:
        raise ValueError("--out must be given; got nothing")
    if not finish:
        recording.record(spec, out, seconds)
    return recording.finish(out, calibration, without or [])
