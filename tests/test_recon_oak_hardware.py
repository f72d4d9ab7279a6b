"""On real cameras: pytest -m hardware, with at least one OAK-D plugged in. Not run where there is none."""

from dataclasses import replace

import numpy as np
import pytest

from recon.oak.aligned import finish_recording
from recon.oak.devices import list_devices
from recon.oak.eeprom import recorded_cameras
from recon.oak.rig import record_rig
from recon.oak.spec import default_rig
from recon.video import VideoFile

SECONDS = 3.0


@pytest.mark.hardware
def test_all_connected_devices_give_a_recording_in_the_plush_layout(tmp_path):
    devices = list_devices()
    assert devices, "plug an OAK-D in"
    spec = replace(default_rig([d.id for d in devices]), sync_frames=1.0)  # devices without a trigger
    done = record_rig(spec, tmp_path, seconds=SECONDS)
    assert done.faults == () and len(done.streams) == 3 * len(devices)
    for stream in done.streams:
        assert abs(stream.frames - SECONDS * spec.fps) < 0.2 * SECONDS * spec.fps
        assert stream.fps == pytest.approx(spec.fps, rel=0.05)
    cameras = recorded_cameras(tmp_path)
    finished = finish_recording(tmp_path, cameras, rig_calibrated=False)
    assert len(finished.groups.index) > 0.5 * SECONDS * spec.fps
    assert np.abs(finished.clocks.drift).max() < 1e-3
    for camera in cameras:
        path = tmp_path / "capture" / f"{camera.name}.aligned.mp4"
        video = VideoFile(path, turned=True, grey=camera.stream != "colour")
        assert video.count == len(finished.groups.index) and video.size == camera.size
        assert next(video.frames()).std() > 0  # not one flat colour
