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


def rig(
    *,
    out: Path,
    shape: str = "plush",
    cameras: int = 19,
    frames: int = 48,
    size: int = 1080,
    greys: bool = True,
    noise: float = 2.0,
    drift: float = 0.02,
    reconstruction: int = 0,
    seed: int = 0,
    fault: list[str] | None = None,
) -> dict[str, object]:
    """Film a soft object that never was: a recording in the PLUSH layout, and the truth beside it.

    Parameters
    ----------
    out
        folder for the recording; an interrupted run goes on when called again.
    shape
        plush, dinosaur, pillow or leaf.
    cameras
        how many devices, 4 to 19; the last three watch the nozzle.
    frames
        how many.
    size
        width of the colour pictures in pixels.
    greys
        also the left and right streams of every device.
    noise
        standard deviation of a grey level, of 255.
    drift
        largest relative change of a camera's exposure.
    reconstruction
        also write reconstruction/, from the truth, with so many points.
    seed
        of lenses, noise and drift.
    fault
        what shall be wrong: nozzle-deg=8, nozzle-mm=5, missing=cam0003, late=cam0002:3, dropped=cam0004:2, scale=1.1
        or inertia.
    """
    from recon.rig.make import make_rig
    from recon.rig.options import RigOptions, parse_faults
    from veo_ti.progress import waiting

    options = RigOptions(
        shape=shape, cameras=cameras, frames=frames, size=size, greys=greys, noise=noise, drift=drift,
        reconstruction=reconstruction, seed=seed, faults=parse_faults(fault or []),
    )  # fmt: skip
    with waiting("rig") as say:
        return {"folder": str(make_rig(out, options, say))}
