"""`veo matte` on drawn films and on the rig: the true mattes, what was used, going on, and what cannot be right."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from furry import shot

from recon.cameras import Camera, look_at
from recon.images import read_image, write_image
from recon.mattes.nozzle import nozzle_region, without_nozzle
from recon.plush.capture import read_capture
from recon.plush.markers import read_markers
from recon.rig.make import make_rig
from recon.rig.options import RigOptions
from recon.rig.truth import read_truth
from recon.video import write_video
from veo_ti import cli
from veo_ti.footage import matte_cut
from veo_ti.footage.matte_cut import MatteChoice
from veo_ti.footage.mattes import matte_folder

EMPTY, FRAMES = 3, 6  # the first frames show no object
QUICK = MatteChoice(quick=True)


def film(folder: Path, seed: int, name: str = "cam0001") -> list[np.ndarray]:
    """One camera's film: an empty scene with a lit floor, then the furry thing on it; the true mattes."""
    shots = [shot(np.random.default_rng([seed, k]), lit=30.0, thing=k >= EMPTY) for k in range(FRAMES)]
    write_video(folder / f"capture/{name}.aligned.mp4", [s.image for s in shots], 40.0, turned=True, crf=10)
    return [s.alpha for s in shots]


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A folder of two films, and their true mattes."""
    folder = tmp_path_factory.mktemp("drawn")
    return folder, [film(folder, seed, f"cam000{seed}") for seed in (1, 2)]


@pytest.fixture
def filmed(drawn, tmp_path):
    """A copy of it."""
    return shutil.copytree(drawn[0], tmp_path / "thing"), drawn[1]


def overlap(levels: np.ndarray, true: np.ndarray) -> float:
    a, b = levels > 127, true > 0.5
    return (a & b).sum() / (a | b).sum()


def matte_of(folder: Path, name: str, frame: int) -> np.ndarray:
    return read_image(folder / f"capture/mattes/{name}/{frame:08d}.png", grey=True)


def test_frames_without_the_object_give_the_plate_and_what_differs_is_the_object(filmed):
    folder, true = filmed
    facts = matte_folder(folder, MatteChoice(plate_frame="0-2", quick=True))
    for name, alphas in zip(("cam0001", "cam0002"), true, strict=True):
        assert read_image(folder / f"capture/plates/{name}.png").shape == (240, 320, 3)
        assert min(overlap(matte_of(folder, name, k), alphas[k]) for k in range(EMPTY, FRAMES)) > 0.975
        assert facts["cameras"][name]["bad_frames"] == [0, 1, 2] and facts["cameras"][name]["plate"] == "frames 0-2"
    assert "cam0002 frames 0-2: the matte is empty" in facts["sentences"]
    assert facts["sentence"].startswith("12 mattes of 2 cameras, by the difference from the empty scene; 6 of them")
    assert facts == json.loads((folder / "matte/mattes.json").read_text())
    capture = read_capture(folder)
    assert set(capture.mattes) == set(capture.plates) == {"cam0001", "cam0002"}
    page = (folder / "matte/matte.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 2 and "look wrong" in page
    assert iio.imread(folder / "matte/contact_sheet.png").std() > 8


def test_without_a_plate_brightness_decides_and_is_named(filmed):
    folder, true = filmed
    facts = matte_folder(folder, MatteChoice(threshold=60, quick=True), only=["cam0002"])
    assert "brightness above 60 of 255 (there is no plate)" in facts["sentence"]
    assert overlap(matte_of(folder, "cam0002", 4), true[1][4]) > 0.95
    assert not (folder / "capture/mattes/cam0001").exists() and not (folder / "capture/plates").exists()
    fine = matte_folder(folder, MatteChoice(threshold=60), only=["cam0002"])
    soft = matte_of(folder, "cam0002", 4)
    assert ((soft > 0) & (soft < 255)).sum() > 500 and fine["cameras"]["cam0002"]["plate"] == "no plate"


def test_interrupted_work_goes_on_with_what_is_missing_and_other_settings_begin_anew(filmed, tmp_path, monkeypatch):
    folder, made = filmed[0], []
    cut = matte_cut.matte
    monkeypatch.setattr(matte_cut, "matte", lambda image, *rest, **kw: made.append(image) or cut(image, *rest, **kw))
    choice = MatteChoice(plate_frame="1", quick=True)
    matte_folder(folder, choice, only=["cam0001"])
    place = folder / "capture/mattes/cam0001"
    whole = {path.name: path.read_bytes() for path in place.iterdir()}
    assert len(made) == len(whole) == FRAMES
    for frame in (2, 5):
        (place / f"{frame:08d}.png").unlink()
    (place / ".00000005.partial.png").write_bytes(b"half")
    matte_folder(folder, choice, only=["cam0001"])
    assert len(made) == FRAMES + 2 and {path.name: path.read_bytes() for path in place.iterdir()} == whole
    matte_folder(folder, choice, only=["cam0001"])
    assert len(made) == FRAMES + 2
    matte_folder(folder, MatteChoice(quick=True, threshold=40), only=["cam0001"])
    assert len(made) == 2 * FRAMES + 2
    (folder / "capture/mattes/cam0001.json").unlink()
    with pytest.raises(ValueError, match="mattes/cam0001 must be made by veo matte, or be moved away; got 6 mattes"):
        matte_folder(folder, choice, only=["cam0001"])


@dataclass(frozen=True)
class Tensor:
    name: str
    shape: tuple = (1, 3, "h", "w")
    type: str = "tensor(float)"


class Difference:
    """A network that gives the largest difference between picture and plate, clipped."""

    def get_inputs(self):
        return [Tensor("src"), Tensor("bgr")]

    def get_outputs(self):
        return [Tensor("pha", (1, 1, "h", "w"))]

    def run(self, names, feed):
        return [np.clip(4 * np.abs(feed["src"] - feed["bgr"]).max(axis=1, keepdims=True) - 0.4, 0, 1)]


def test_a_network_of_the_user_decides_where_it_is_given(filmed, tmp_path, monkeypatch):
    folder, true = filmed
    (tmp_path / "mine.onnx").write_bytes(b"weights")
    monkeypatch.setattr(matte_cut, "open_network", lambda path: Difference())
    choice = MatteChoice(plate_frame="0-2", network=tmp_path / "mine.onnx")
    facts = matte_folder(folder, choice, only=["cam0001"])
    assert "by the network mine.onnx" in facts["sentence"]
    assert overlap(matte_of(folder, "cam0001", 4), true[0][4]) > 0.9


def test_bad_input_is_one_sentence_naming_file_and_camera(filmed, tmp_path, capsys):
    folder = filmed[0]
    empty = tmp_path / "plates"
    write_image(empty / "cam0001.png", np.zeros((240, 320, 3), np.uint8))
    with pytest.raises(ValueError, match=r"--plates must hold the empty scene of cam0002: cam0002.png, pictures or"):
        matte_folder(folder, MatteChoice(plates=empty))
    write_image(empty / "cam0002.png", np.zeros((100, 320, 3), np.uint8))
    rule = r"cam0002.png must be 320 x 240 pixels as cam0002.aligned.mp4 \(cam0002\); got 320 x 100"
    with pytest.raises(ValueError, match=rule):
        matte_folder(folder, MatteChoice(plates=empty))
    with pytest.raises(ValueError, match=r"--plate-frame must be among the 6 frames of cam0001.aligned.mp4"):
        matte_folder(folder, MatteChoice(plate_frame="4-6"))
    with pytest.raises(ValueError, match="--plate-frame must be a frame or two with - between"):
        matte_folder(folder, MatteChoice(plate_frame="all"))
    with pytest.raises(ValueError, match="--plate-frame and --plates must not be given together"):
        matte_folder(folder, MatteChoice(plate_frame="0", plates=empty))
    with pytest.raises(ValueError, match="--camera must be among cam0001, cam0002; got cam0009"):
        matte_folder(folder, QUICK, only=["cam0009"])
    with pytest.raises(
        ValueError, match=r"cam0001.aligned.mp4, cam0002.aligned.mp4 of thing must show the object; got an"
    ):
        matte_folder(folder, MatteChoice(plate_frame="0-2", threshold=250, quick=True))
    assert cli.main(["matte", str(tmp_path / "nowhere")]) == 2
    assert cli.main(["matte", str(folder), "--network", "no.onnx"]) == 2
    said = capsys.readouterr().err
    assert "FOLDER must hold videos" in said and "matting network must be an .onnx file" in said


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """The rig at a fifth of its size; the nozzle is in view."""
    options = RigOptions(cameras=4, frames=3, size=216, greys=False)
    folder = make_rig(tmp_path_factory.mktemp("rig") / "plush", options)
    matte_folder(folder, MatteChoice(plates=folder / "truth/plates"), folder / "matte")
    return folder


def test_the_rigs_mattes_are_the_true_ones(rig):
    """Goal 0.975 at full size, where mean and median are 0.988 and 0.994; 0.980 and 0.986 at half of it."""
    found = overlaps(rig)
    assert np.mean(found) > 0.94 and np.median(found) > 0.955  # 0.956 and 0.964


def overlaps(folder: Path) -> list[float]:
    capture, truth = read_capture(folder), read_truth(folder)
    return [overlap(capture.matte(c, f), truth.matte(c, f) / 255) for c in capture.names for f in range(3)]


def test_without_a_plate_neither_the_table_nor_a_lamp_nor_the_nozzle_is_the_object(rig, tmp_path):
    """One camera looks into a lamp with its glow on the cloth; the table is brighter than the cloth."""
    bare = shutil.copytree(rig, tmp_path / "bare")
    shutil.rmtree(bare / "capture/plates")
    facts = matte_folder(bare, MatteChoice())
    assert "what is brighter than the dark cloth (there is no plate)" in facts["sentence"]
    assert np.mean(overlaps(bare)) > 0.94 and min(overlaps(bare)) > 0.85


def test_the_nozzle_is_cut_out(rig, tmp_path):
    capture, truth = read_capture(rig), read_truth(rig)
    kept = shutil.copytree(rig, tmp_path / "kept")
    shutil.rmtree(kept / "capture/mattes")
    matte_folder(kept, MatteChoice(quick=True, nozzle=True), only=["cam0003"])
    with_nozzle = read_image(kept / "capture/mattes/cam0003/00000001.png", grey=True)
    region = nozzle_region(capture.camera("cam0003"), truth.T_world_marker[1])
    own = truth.matte("cam0003", 1) > 127
    assert (with_nozzle > 127)[region & ~own].mean() > 0.5
    assert (capture.matte("cam0003", 1) > 127)[region & ~own].mean() < 0.02
    for read, true in zip(read_markers(rig / "capture/aruco_path.json"), truth.T_world_marker, strict=True):
        np.testing.assert_allclose(read, true, atol=1e-12)


def test_a_nozzle_behind_the_object_cuts_nothing_out_of_it():
    camera = Camera(
        name="cam0001", K=np.array([[300.0, 0, 159.5], [0, 300, 119.5], [0, 0, 1]]), size=(320, 240),
        T_camera_world=look_at(np.array([0, 0, -0.8]), np.zeros(3), np.array([0, -1.0, 0])),
    )  # fmt: skip
    T = np.eye(4)
    T[:3, 3] = [0, -0.1, 0.3]  # blows along -z, towards the camera: it is behind what stands at the origin
    region, object_ = nozzle_region(camera, T), np.zeros((240, 320), np.float32)
    object_[100:200, 60:260] = 1.0
    assert (region & (object_ > 0)).any()
    np.testing.assert_array_equal(without_nozzle(object_, camera, T), object_)
    alone = (region & (object_ == 0)).astype(np.float32)
    assert not without_nozzle(alone, camera, T).any()
