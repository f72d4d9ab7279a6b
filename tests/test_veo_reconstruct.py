"""The way from a small rig recording to a page: files that other tools read, stages that are not done twice."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from recon.images import read_image
from recon.plush.reconstruction import read_plush
from recon.radiance.extraction import Cloud4D, ExtractOptions
from recon.radiance.fields import FieldOptions
from recon.radiance.hashgrid import HashGrid
from recon.radiance.options import TrainOptions
from recon.rig.make import make_rig
from recon.rig.options import RigOptions
from recon.rig.truth import lend_mattes, read_truth
from recon.video import VideoFile
from veo_ti import cli_reconstruct
from veo_ti.observation import Observation
from veo_ti.reconstruction.driven import driven_frames
from veo_ti.reconstruction.loop import run_recording
from veo_ti.reconstruction.orbit import render_reconstruction
from veo_ti.reconstruction.run import ReconstructChoice, capture_of, fixed_points, reconstruct_folder
from veo_ti.store import read_sequence

FIELD = FieldOptions(grid=HashGrid(levels=5, coarsest=8, finest=64, log2_table=13))
TRAIN = TrainOptions(canonical_steps=120, motion_steps=120, samples=4096, field=FIELD, pulling=3)
CHOICE = ReconstructChoice(resolution=48, test=("cam0003",), train=TRAIN, extract=ExtractOptions(points=700))


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Six cameras, four frames, and the true mattes where `veo matte` would have put its own."""
    folder = tmp_path_factory.mktemp("rig") / "plush"
    make_rig(folder, RigOptions(cameras=6, frames=4, size=96, greys=False), lambda text: None)
    lend_mattes(folder)
    return folder


@pytest.fixture(scope="module")
def out(recording, tmp_path_factory):
    """`veo run` with few steps and small films."""
    place = tmp_path_factory.mktemp("run")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("veo_ti.reconstruction.novel.STEPS", 2)
        patch.setattr("veo_ti.reconstruction.novel._SIDE", 64)
        run_recording(recording, place, CHOICE, modes=6, every=2)
    return place


def test_a_recording_becomes_a_page_with_both_tables_of_the_paper(out):
    found = json.loads((out / "run.json").read_text(encoding="utf-8"))
    page = (out / "index.html").read_text(encoding="utf-8")
    assert found["sentence"] in page and "data:video/mp4" in page
    table = found["table_2"]
    assert table["reconstructed"]["masked"]["psnr"] > 18
    assert abs(table["reconstructed"]["masked"]["psnr"] - table["simulated"]["masked"]["psnr"]) < 6
    error = found["material"]["error_mm"]
    assert (error["held_out"] or error["training"])["mean"] > 0
    assert found["material"]["force_scale_known"] is False
    assert all(found["novel"][name]["largest_displacement_mm"] > 1 for name in ("push", "ball"))


def test_training_shows_a_held_out_camera_on_its_way(out):
    """Rendered and filmed side by side; the rendered half is not empty."""
    picture = read_image(out / "reconstruction/training/000240.png")
    rendered, filmed = np.split(picture.astype(float), 2, axis=1)
    assert np.abs(rendered - filmed).mean() < 0.5 * filmed.mean()


def test_the_cloud_is_a_plush_folder_and_a_sequence(out, recording):
    """Read by the dataset's own reader and as .vtkhdf; near the true body, as far as so few steps allow."""
    folder = read_plush(out / "reconstruction")
    stored = read_sequence(out / "reconstruction/cloud.vtkhdf")
    points = folder.points(0)
    assert points == pytest.approx(stored.points[0], abs=1e-6) and len(folder.frame_numbers) == 4
    assert folder.fixed.any() and stored.static["surface"].any()
    body = read_truth(recording).rest
    low, high = body.min(axis=0), body.max(axis=0)
    assert (np.abs((points - low) / (high - low) - 0.5) < 0.75).mean() > 0.95
    observation = Observation.load(str(out / "reconstruction"))
    assert observation.force_scale_known is False and observation.jet is not None


def test_what_is_there_is_not_made_again(out, recording, monkeypatch):
    def never(*_, **__):
        raise AssertionError("trained again")

    monkeypatch.setattr("veo_ti.reconstruction.run.train", never)
    again = reconstruct_folder(recording, out / "reconstruction", CHOICE)
    assert again["points"] == len(read_plush(out / "reconstruction").object_index)
    with pytest.raises(AssertionError, match="trained again"):
        reconstruct_folder(recording, out / "reconstruction", replace(CHOICE, train=replace(TRAIN, seed=5)))


def test_a_reconstruction_is_seen_from_a_camera_and_from_all_sides(out, recording, tmp_path):
    folder = out / "reconstruction"
    seen, film = render_reconstruction(folder, tmp_path, view="cam0002", orbit=4, frame=0, size=64)
    matte = read_truth(recording).matte("cam0002", 0) > 127
    shown = read_image(seen).max(axis=2) > 40
    near = cv2.resize(matte.astype(np.uint8), shown.shape[::-1], interpolation=cv2.INTER_AREA) > 0
    assert (shown & near).sum() > 0.6 * (shown | near).sum()
    turned = VideoFile(film)
    assert (turned.count, turned.size) == (4, (64, 64))
    with pytest.raises(ValueError, match=r"--view must be one of cam0001, .*; got cam0077"):
        render_reconstruction(folder, tmp_path, view="cam0077")
    with pytest.raises(ValueError, match=r"--frame must be 0 to 3; got 9"):
        render_reconstruction(folder, tmp_path, orbit=2, frame=9)
    with pytest.raises(ValueError, match="veo render must be given --view or --orbit"):
        render_reconstruction(folder, tmp_path)


def test_frames_that_something_else_moves_teach_no_material():
    """Frame 2 moves without a load, frame 5 with a fiftieth of its points; 3 and 4 rest; 1 moves under its load, and 6
    where the edge of a stream brushes it."""
    rest = np.random.default_rng(0).random((300, 3)) * 0.1
    bend = 0.01 * np.stack([rest[:, 1] / 0.1, *np.zeros((2, 300))], axis=1)
    pulled = 0.01 * (rest[:, :1] > np.quantile(rest[:, 0], 0.98)) * np.array([0.0, 0.0, 1.0])
    points = np.stack([rest, rest + bend, rest + bend, rest + 1e-4, rest - 1.5e-4, rest + pulled, rest + 0.1 * bend])
    forces = np.zeros_like(points)
    forces[1, :20, 0] = 0.1
    forces[6, :20, 0] = 5e-5
    seen = Observation(points=points, forces=forces, time=np.arange(7.0), fixed=rest[:, 1] < 0.01)
    assert driven_frames(seen).tolist() == [0, 1, 3, 4, 6]
    assert driven_frames(replace(seen, forces=0 * forces)).tolist() == [*range(7)]


def test_fixed_points_are_low_and_still():
    rng = np.random.default_rng(0)
    rest = rng.uniform(0, 1, size=(400, 3))
    bend = rest[:, 1:2] ** 2 * np.array([0.3, 0, 0])
    cloud = Cloud4D(points=np.stack([rest, rest + bend]), colours=rest, surface=rest[:, 0] > 0.5, normals=0 * rest,
                    times=np.array([0, 0.1]), spacing=0.1)  # fmt: skip
    fixed = fixed_points(cloud)
    assert fixed.any() and rest[fixed, 1].max() < 0.15


def test_no_sensor_of_a_device_that_judges_teaches(tmp_path):
    """The grey ones see almost what the colour one between them does."""
    folder = make_rig(tmp_path / "rig", RigOptions(cameras=5, frames=2, size=96))
    lend_mattes(folder)
    choice = replace(CHOICE, greys=True)
    capture = capture_of(folder, choice)
    assert {c.name for c in capture.cameras if c.role == "test"} == {"cam0003", "cam0003.left", "cam0003.right"}
    teaching = capture.chosen(("train",), choice.streams)
    assert {c.stream for c in teaching} == {"colour", "left", "right"}
    assert not any(c.device == "cam0003" for c in teaching)


def test_what_is_missing_is_said(recording, tmp_path):
    assert cli_reconstruct.is_recording(recording) and not cli_reconstruct.is_recording(tmp_path)
    with pytest.raises(ValueError, match=r"--test must be among cam0001, .*; got cam0099"):
        reconstruct_folder(recording, tmp_path / "out", replace(CHOICE, test=("cam0099",)))
    bare = tmp_path / "bare"
    shutil.copytree(recording, bare, ignore=shutil.ignore_patterns("mattes", "truth"))
    with pytest.raises(ValueError, match="FOLDER must hold mattes of at least three cameras: veo matte"):
        reconstruct_folder(bare, tmp_path / "out", CHOICE)
