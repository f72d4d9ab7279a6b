"""The PLUSH layout, written byte by byte from its description and read back in metres."""

import json
import pickle

import numpy as np
import pytest
import torch

from recon.metrics import distance_table
from recon.plush.reconstruction import NozzlePath, paper_table_row, read_obj_points, read_plush
from recon.plush.reconstruction_writer import write_nozzle, write_reconstruction, write_simulation

RAW, FRAMES = 12, 6
CLEANED = np.array([1, 2, 3, 5, 6, 7, 9, 11])
SAMPLED = np.array([0, 2, 3, 7])


@pytest.fixture
def leaf(tmp_path):
    """A folder made by hand, not by our writer: millimetres, tabs, tensors, null for a marker that was not seen."""
    rng = np.random.default_rng(0)
    vertices = (300 * rng.random((FRAMES, RAW, 3))).astype(np.float32)
    for part in ("capture", "reconstruction", "simulation/val_GT", "simulation/val_simed"):
        (tmp_path / part).mkdir(parents=True)
    for i in range(FRAMES):
        np.savez(tmp_path / f"reconstruction/{i:08d}.npz", vertices=vertices[i])
    np.save(tmp_path / "reconstruction/rgbs.npy", rng.random((RAW, 3)).astype(np.float32))
    torch.save({"objectInd": torch.tensor(CLEANED), "fixed": torch.tensor([0, 4])}, tmp_path / "reconstruction/mask.pt")
    info = {"trainingInd": [0, 2], "valInd": torch.tensor([3, 5]), "sampledVerts": torch.tensor(SAMPLED)}
    torch.save(info, tmp_path / "simulation/simInfo.pt")
    for i, frame in enumerate((3, 5)):
        for name, shift in (("val_GT", 0.0), ("val_simed", 3.0 * (i + 1))):
            rows = vertices[frame][CLEANED[SAMPLED]] + [shift, 0, 0]
            text = "".join(f"v\t{x}\t{y}\t{z}\t\n" for x, y, z in rows)
            (tmp_path / f"simulation/{name}/{i:04d}.obj").write_text(text)
    seen = {"aruco_ids": [164], "rvecs": np.eye(3).tolist(), "tvecs": [10.0, 20.0, 800.0]}
    (tmp_path / "capture/aruco_path.json").write_text(json.dumps([None, seen, None, seen, seen, seen]))
    return tmp_path, vertices


def test_everything_is_read_in_metres(leaf):
    path, vertices = leaf
    folder = read_plush(path)
    np.testing.assert_allclose(folder.points(4), 1e-3 * vertices[4][CLEANED].astype(float), rtol=1e-12)
    np.testing.assert_array_equal(folder.fixed, np.isin(np.arange(8), [0, 4]))
    np.testing.assert_array_equal(folder.sampled, SAMPLED)
    np.testing.assert_array_equal(folder.train_frames, [0, 2])
    np.testing.assert_array_equal(folder.validation_frames, [3, 5])
    assert folder.colors.shape == (8, 3) and folder.missing == () and len(folder.frame_numbers) == FRAMES
    with pytest.raises(ValueError, match="frame must be one of the 6 reconstructed frames; got 9"):
        folder.points(9)


def test_nozzle_sits_above_the_marker_and_blows_along_its_back(leaf):
    nozzle = read_plush(leaf[0]).nozzle
    # by hand: R = 1: (0, 105, 0) + (10, 20, 800) = (10, 125, 800) mm, then y and z change sign; likewise (0, 0, -1)
    np.testing.assert_allclose(nozzle.position[1], [0.010, -0.125, -0.800], rtol=1e-12)
    np.testing.assert_array_equal(nozzle.direction[1], [0, 0, 1])
    np.testing.assert_array_equal(nozzle.seen, [False, True, False, True, True, True])
    assert np.isfinite(nozzle.position).all() and np.isfinite(nozzle.direction).all()


def test_sampled_points_counted_in_the_raw_cloud_are_understood(leaf):
    path, _ = leaf
    info = torch.load(path / "simulation/simInfo.pt", weights_only=True)
    raw = CLEANED[SAMPLED[:3]]  # 1, 3, 5: also possible as indices into the cleaned cloud
    torch.save(info | {"sampledVerts": torch.tensor(raw)}, path / "simulation/simInfo.pt")
    for file in (path / "simulation/val_GT").iterdir():
        file.write_text("".join(file.read_text().splitlines(keepends=True)[:3]))
    np.testing.assert_array_equal(read_plush(path).sampled, SAMPLED[:3])


def test_paper_table_row_is_recomputed(leaf):
    row = paper_table_row(read_plush(leaf[0]))
    # every point is off by 3 mm in one frame and 6 mm in the other: per-point average 4.5
    np.testing.assert_allclose([row.mean_mm, row.p95_mm, row.max_mm], [4.5, 4.5, 6.0], atol=1e-4)


def test_table_averages_points_over_frames_before_the_percentile():
    off = np.zeros((4, 101, 3))
    off[:, :, 0] = np.arange(101)[None] * np.array([0, 1, 2, 1])[:, None] * 1e-3  # point i: average i mm, largest 2 i
    table = distance_table(off, np.zeros_like(off))
    np.testing.assert_allclose([table.mean_mm, table.p95_mm, table.max_mm], [50, 95, 200], rtol=1e-12)
    observed = np.ones((4, 101), bool)
    observed[:, 96:] = False
    observed[2] = False
    table = distance_table(off, np.zeros_like(off), observed=observed)
    np.testing.assert_allclose([table.mean_mm, table.max_mm], [47.5 * 2 / 3, 95], rtol=1e-12)
    with pytest.raises(ValueError, match="distances must hold at least one observed point"):
        distance_table(off, off, observed=np.zeros((4, 101), bool))


MISSING = {
    "reconstruction/mask.pt": (8, "whole raw cloud"),
    "reconstruction/rgbs.npy": (4, "in grey"),
    "simulation/simInfo.pt": (4, "chosen evenly"),
    "capture/aruco_path.json": (4, "no forces are known"),
}


@pytest.mark.parametrize("part", MISSING)
def test_missing_part_is_said_with_what_can_still_be_done(leaf, part):
    path, _ = leaf
    (path / part).unlink()
    folder = read_plush(path)
    assert len(folder.missing) == 1 and folder.missing[0].startswith(f"{part} is missing: ")
    assert MISSING[part][1] in folder.missing[0]
    assert len(folder.points(0)) == (RAW if part.endswith("mask.pt") else len(CLEANED))
    assert paper_table_row(folder).max_mm == pytest.approx(6.0, abs=1e-4)


def test_table_row_needs_no_reconstruction(leaf):
    path, _ = leaf
    for file in (path / "reconstruction").iterdir():
        file.unlink()
    folder = read_plush(path)
    assert paper_table_row(folder).mean_mm == pytest.approx(4.5, abs=1e-4)
    assert any("paper's own table row can still be recomputed" in sentence for sentence in folder.missing)


def test_foreign_or_damaged_folders_are_one_sentence(leaf, tmp_path_factory):
    path, _ = leaf
    with pytest.raises(ValueError, match="input must be a PLUSH object folder"):
        read_plush(tmp_path_factory.mktemp("empty"))
    (path / "simulation/val_simed/0001.obj").unlink()
    with pytest.raises(ValueError, match="val_GT and val_simed must hold the same frames; got 2 and 1 files"):
        paper_table_row(read_plush(path))
    whole = (path / "reconstruction/00000000.npz").read_bytes()
    (path / "reconstruction/00000000.npz").write_bytes(whole[:200])
    with pytest.raises(ValueError, match=r"00000000\.npz must be a complete file of the PLUSH layout"):
        read_plush(path)


class Evil:
    def __reduce__(self):
        return (print, ("unpickled!",))


def test_pickles_never_run_code(leaf, capsys):
    path, _ = leaf
    torch.save({"objectInd": Evil(), "fixed": []}, path / "reconstruction/mask.pt")
    with pytest.raises(ValueError, match=r"mask\.pt must be a complete file of the PLUSH layout"):
        read_plush(path)
    (path / "reconstruction/mask.pt").write_bytes(pickle.dumps(Evil()))
    with pytest.raises(ValueError, match=r"mask\.pt must be"):
        read_plush(path)
    assert "unpickled" not in capsys.readouterr().out


def test_writer_and_reader_agree(tmp_path):
    rng = np.random.default_rng(1)
    vertices, turn = rng.random((3, 9, 3)), rng.standard_normal((3, 3))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    cleaned, sampled = np.array([0, 3, 4, 8]), np.array([1, 3])
    write_reconstruction(
        tmp_path, vertices=vertices, colors=rng.random((9, 3)), object_index=cleaned, fixed=np.array([2])
    )
    seen = vertices[[2]][:, cleaned[sampled]]
    choice = {"training": np.array([0, 1]), "validation": np.array([2]), "sampled": sampled}
    write_simulation(tmp_path, **choice, seen=seen, simulated=seen + np.array([0, 0.004, 0.003]))
    write_nozzle(tmp_path, NozzlePath(position=vertices[:, 0], direction=turn, seen=np.array([True, False, True])))
    folder = read_plush(tmp_path)
    np.testing.assert_allclose(folder.points(1), vertices[1][cleaned], atol=1e-7)  # single precision in the file
    np.testing.assert_allclose(folder.nozzle.position[[0, 2]], vertices[[0, 2], 0], atol=1e-12)
    np.testing.assert_allclose(folder.nozzle.direction[[0, 2]], turn[[0, 2]], atol=1e-12)
    np.testing.assert_array_equal(folder.nozzle.seen, [True, False, True])
    np.testing.assert_array_equal(np.flatnonzero(folder.fixed), [2])
    assert paper_table_row(folder).mean_mm == pytest.approx(5.0, abs=1e-4) and folder.missing == ()
    first = (tmp_path / "simulation/val_GT/0000.obj").read_text().splitlines()[0]
    assert first.startswith("v\t") and first.endswith("\t") and first.count("\t") == 4


def test_obj_with_faces_or_words_is_refused(tmp_path):
    (tmp_path / "a.obj").write_text("v\t1\t2\t3\t\nv\t1\tx\t3\t\n")
    with pytest.raises(ValueError, match=r"a\.obj must be a complete file"):
        read_obj_points(tmp_path / "a.obj")
