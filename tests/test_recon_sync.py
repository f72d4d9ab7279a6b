"""Who is out of step, told from the motion energy of rig recordings (make_rig_energies.py), and how sure that is."""

import numpy as np
import pytest
from make_rig_energies import STORE

from recon.rig.motion import SHAPES
from recon.sync import FEWEST, estimate_offsets

ENERGIES = {key: curves.astype(float) for key, curves in np.load(STORE).items()}


def late(energy: np.ndarray, camera: int, frames: int) -> np.ndarray:
    """The first picture repeats, and all others come so many frames later."""
    out = energy.copy()
    out[camera] = np.concatenate([np.full(frames, 0.5 * energy[camera].min()), energy[camera, :-frames]])
    return out


@pytest.mark.parametrize("key", ENERGIES)
def test_good_recordings_are_in_step(key):
    sync = estimate_offsets(ENERGIES[key])
    assert sync.enough and sync.known.all() and not sync.offset.any()
    assert (sync.sure > 0.95).all() and (sync.sure[sync.alike > 0.7] > 0.99).all()


@pytest.mark.parametrize("shape", SHAPES)
def test_planted_offsets_are_found_and_nobody_else_is_accused(shape):
    energy, found = ENERGIES[f"{shape}/48"], []
    for camera in range(len(energy)):
        for frames in (2, 3, 5):
            sync = estimate_offsets(late(energy, camera, frames))
            assert not np.delete(sync.offset, camera).any()
            assert sync.offset[camera] == frames or not sync.known[camera]  # never in step, never by another number
            found.append(sync.known[camera])
    assert np.mean(found) >= 0.5  # curves of some views are too much alike at several lags


def test_cameras_of_a_late_device_do_not_speak_for_each_other():
    energy = np.repeat(ENERGIES["plush/48"][:4], 3, axis=0)
    energy = energy * np.random.default_rng(0).uniform(0.95, 1.05, energy.shape)
    for camera in (3, 4, 5):
        energy = late(energy, camera, 3)
    devices = np.repeat(["cam0001", "cam0002", "cam0003", "cam0004"], 3).tolist()
    sync = estimate_offsets(energy, devices=devices)
    assert sync.offset.tolist() == [0, 0, 0, 3, 3, 3] + [0] * 6 and sync.known[3:6].all()


@pytest.mark.parametrize("shape", SHAPES)
def test_too_few_frames_tell_nothing(shape):
    few = estimate_offsets(ENERGIES[f"{shape}/20"][:, : FEWEST - 1])
    assert not few.enough and not few.known.any() and not few.offset.any()
    for camera in range(6):
        sync = estimate_offsets(late(ENERGIES[f"{shape}/20"], camera, 3))
        assert not np.delete(sync.offset, camera).any() and sync.offset[camera] in (0, 3)


def test_noise_is_hardly_ever_out_of_step():
    rng = np.random.default_rng(0)
    syncs = [estimate_offsets(rng.random((6, frames))) for frames in (20, 40, 120) for _ in range(25)]
    accused = np.concatenate([sync.offset != 0 for sync in syncs])
    assert accused.mean() < 0.01  # as 5 % of what is told may be wrong, and little of noise is told
    assert np.mean(np.concatenate([sync.known for sync in syncs])) < 0.15


def test_more_frames_make_surer():
    rng = np.random.default_rng(1)
    motion = rng.random(200) ** 2
    energy = np.stack([motion + 0.2 * rng.random(200) for _ in range(4)])
    sure = [estimate_offsets(late(energy, 2, 3)[:, :count]).sure[2] for count in (20, 40, 80, 200)]
    assert (
        sure[-1] > 0.9999
        and sure[0] < sure[-1]
        and estimate_offsets(late(energy, 2, 3)).offset.tolist() == [0, 0, 3, 0]
    )


def test_wrong_input_is_one_sentence():
    with pytest.raises(ValueError, match="energy must hold at least two cameras; got 1"):
        estimate_offsets(np.ones((1, 40)))
    with pytest.raises(ValueError, match="devices must be at least two; got"):
        estimate_offsets(np.ones((2, 40)), devices=["cam0001", "cam0001"])
    with pytest.raises(ValueError, match=r"energy must not be negative; got -1\.0"):
        estimate_offsets(np.full((2, 40), -1.0))
