"""Motion capture files: units, lost markers, damage; the beam's C3D originals against their published arrays."""

import os
import warnings
from pathlib import Path

import c3d
import numpy as np
import pytest

from veo_ti.mocap import Markers, read_beam_take, read_c3d

BEAM = Path(os.environ.get("VEO_DATA", Path(__file__).parents[1] / "../shared/data")) / "beam_mocap"
needs_beam = pytest.mark.skipif(not BEAM.is_dir(), reason="the measured beam is not here (set VEO_DATA)")
TAKES = ("beam_gravity_V2_a", "beam_gravity_V2_b", "beam_load52_V2_a", "beam_load52_V2_b")


def c3d_file(path, positions, unit, lost=()):
    writer = c3d.Writer(point_rate=50.0, analog_rate=50.0)
    frames = []
    for t, frame in enumerate(positions):
        points = np.column_stack([frame, np.zeros(len(frame)), np.zeros(len(frame))]).astype(np.float32)
        for m in (m for at, m in lost if at == t):
            points[m, 3] = -1
        frames.append((points, np.empty((0, 0), np.float32)))
    writer.add_frames(frames)
    writer.set_point_labels([f"m{i}" for i in range(positions.shape[1])])
    writer.point_group.add_str("UNITS", "unit of length", unit, len(unit))
    with path.open("wb") as handle, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the writer misses analog channels, which a camera system has not
        writer.write(handle)
    return path


@pytest.mark.parametrize(("unit", "metres"), [("m", 1.0), ("cm", 0.01), ("mm", 0.001)])
def test_lengths_follow_the_files_unit(tmp_path, unit, metres):
    positions = np.random.default_rng(0).random((4, 3, 3)).astype(np.float32)
    markers = read_c3d(c3d_file(tmp_path / "a.c3d", positions, unit))
    np.testing.assert_allclose(markers.positions, metres * positions, rtol=1e-6)
    np.testing.assert_allclose(markers.time, np.arange(4) / 50)
    assert markers.labels == ("m0", "m1", "m2") and markers.observed.all()


def test_lost_markers_are_flagged_and_left_out_of_means(tmp_path):
    positions = np.ones((4, 2, 3))
    positions[1, 1] = 9.0
    markers = read_c3d(c3d_file(tmp_path / "a.c3d", positions, "m", lost=[(1, 1)]))
    assert not markers.observed[1, 1] and markers.observed.sum() == 7
    np.testing.assert_allclose(markers.mean_pose(slice(0, 4)), np.ones((2, 3)))
    with pytest.raises(ValueError, match="frames must show every marker at least once; got none of m1"):
        markers.mean_pose(slice(1, 2))


def test_bad_files_are_one_sentence(tmp_path):
    good = c3d_file(tmp_path / "good.c3d", np.ones((40, 3, 3)), "m").read_bytes()
    for name, data, sentence in (
        ("words.c3d", b"not a mocap file", "file must be a C3D file"),
        ("empty.c3d", b"", "file must be a C3D file"),
        ("cut.c3d", good[:-600], "C3D file|frames it announces"),
        ("head.c3d", good[:300], "file must be a complete C3D file"),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(ValueError, match=sentence):
            read_c3d(tmp_path / name)
    with pytest.raises(ValueError, match="file must exist"):
        read_c3d(tmp_path / "nowhere.c3d")
    furlongs = c3d_file(tmp_path / "furlong.c3d", np.ones((2, 3, 3)), "furlong")
    with pytest.raises(ValueError, match=r"unit must be one of m, cm, mm.*; got 'furlong'"):
        read_c3d(furlongs)
    assert read_c3d(furlongs, unit="cm").positions[0, 0, 0] == pytest.approx(0.01)


def test_moving_to_another_frame_turns_then_shifts():
    still = {"time": np.zeros(1), "residual": np.zeros((1, 1)), "labels": ("a",)}
    markers = Markers(positions=np.array([[[1.0, 0, 0]]]), **still)
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    np.testing.assert_allclose(markers.moved(quarter, np.array([0, 0, 5.0])).positions[0, 0], [0, 1, 5], atol=1e-15)


@needs_beam
@pytest.mark.parametrize("take", TAKES)
def test_beam_originals_agree_with_the_arrays(take):
    original, beam = read_c3d(BEAM / f"{take}.c3d"), read_beam_take(BEAM / f"{take}.npz")
    frame = np.load(BEAM / f"{take}.npz")
    moved = original.moved(frame["R_lab_to_beam"], frame["t_lab_to_beam"])
    np.testing.assert_allclose(moved.positions, beam.markers.positions, atol=1e-9)
    np.testing.assert_allclose(original.time, beam.markers.time, atol=1e-9)
    assert original.labels == beam.markers.labels


@needs_beam
@pytest.mark.parametrize(("take", "drop"), [("beam_gravity_V2_b", -0.0065), ("beam_load52_V2_b", -0.0172)])
def test_beam_tip_drops_as_published(take, drop):
    beam = read_beam_take(BEAM / f"{take}.npz")
    held, settled = beam.markers.mean_pose(slice(0, beam.rest_frames)), beam.markers.mean_pose(slice(-100, None))
    assert np.mean((settled - held)[:3, 2]) == pytest.approx(drop, abs=0.001)  # quoted as "about"
    assert beam.tip_load == pytest.approx(0.052 * 9.81 if "52" in take else 0.0, abs=1e-4)


def test_beam_take_names_missing_keys(tmp_path):
    np.savez(tmp_path / "a.npz", time=np.zeros(2))
    with pytest.raises(ValueError, match="keys must include markers_beam, residual"):
        read_beam_take(tmp_path / "a.npz")
