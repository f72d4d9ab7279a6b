"""What `veo capture` does: list the cameras, record a rig, and make a PLUSH folder of what was recorded."""

from collections.abc import Sequence
from pathlib import Path

from rich.live import Live
from rich.table import Table

from recon.oak.devices import list_devices, no_device_sentence
from recon.oak.recorder import StreamStatus
from recon.oak.rig import record_rig
from recon.oak.spec import RigSpec, default_rig, load_rig
from veo_ti.progress import console, waiting


def show_devices() -> dict[str, object]:
    """The free devices, or why there may be none."""
    devices = list_devices()
    if not devices:
        console.print(no_device_sentence(), markup=False, highlight=False)
    return {"devices": [{"id": d.id, "name": d.name, "protocol": d.protocol} for d in devices]}


def record(spec: Path | None, out: Path, seconds: float | None) -> None:
    """Record with a table of all cameras; what went wrong is said, what was recorded is kept.

    spec: a rig's JSON file; None: every device that is free. Raises ValueError when there is none.
    """
    with Live(console=console, transient=True, auto_refresh=False) as live:
        done = record_rig(_rig(spec), out, seconds=seconds, on_status=lambda s: live.update(_table(s), refresh=True))
    for sentence in done.faults:
        console.print(sentence, markup=False, highlight=False)


def finish(out: Path, calibration: Path | None, without: Sequence[str]) -> dict[str, object]:
    """Pair what was recorded and write `capture/` in the PLUSH layout; the facts of the result.

    calibration: of the rig; None: each camera's own, with every device in a frame of its own; without: cameras to leave
    out.
    """
    from recon.oak.aligned import finish_recording, rig_cameras  # they need torch: seconds that recording does not cost
    from recon.oak.eeprom import recorded_cameras

    cameras = rig_cameras(out, calibration) if calibration else recorded_cameras(out)
    with waiting("writing") as say:
        done = finish_recording(out, cameras, rig_calibrated=calibration is not None, without=without, on_camera=say)
    for sentence in done.sentences:
        console.print(sentence, markup=False, highlight=False)
    return {"groups": len(done.groups.index), "incomplete": done.groups.incomplete, "folder": str(out)}


def _rig(path: Path | None) -> RigSpec:
    if path is not None:
        return load_rig(path)
    devices = list_devices()
    if not devices:
        raise ValueError(no_device_sentence())
    return default_rig([device.id for device in devices])


def _table(streams: Sequence[StreamStatus]) -> Table:
    table = Table("camera", "pictures", "dropped", "a second", "")
    for s in streams:
        table.add_row(s.name, str(s.frames), str(s.dropped), f"{s.fps:.1f}", s.error)
    return table
