"""`veo calibrate` on drawn boards: the true rig from films and from pictures, and one sentence for what cannot be."""

import json
import re
import shutil
from dataclasses import replace

import imageio.v3 as iio
import numpy as np
import pytest
from boards import BOARD, MIDDLE, held_close, poses, ring
from flat_pictures import picture

from recon.calibration.charuco import BoardViews
from recon.calibration.shots import best_shots, of_shots
from recon.images import write_image
from recon.plush.calibration import camera_of, read_calibration, write_calibration
from recon.rigid import rigid
from recon.video import write_video
from veo_ti import cli
from veo_ti.footage import boards
from veo_ti.footage.calibrating import board_of, calibrate_folder

SIZE = (480, 300)
PRINTED = rigid(np.array([np.pi, 0, 0]), MIDDLE)  # the print's own frame has y upwards


def cameras_and_boards():
    """Three cameras 45 degrees apart and boards that they see together or alone."""
    rng = np.random.default_rng(0)
    cameras = [camera.resized(SIZE) for camera in ring(8, rng)[:3]]
    middle = cameras[1].centre / np.linalg.norm(cameras[1].centre)
    together = [T for T in poses(80, rng) if -T[:3, 2] @ middle > 0.75][:6]
    return cameras, np.concatenate([together, *(held_close(camera, 2, rng) for camera in cameras)])


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    """A folder of films, one of pictures, and the true cameras."""
    place, rng = tmp_path_factory.mktemp("boards"), np.random.default_rng(1)
    cameras, shown = cameras_and_boards()
    paper, back = BOARD.print(30), np.full((6, 9), 200, np.uint8)
    for camera in cameras:
        front = [-T[:3, 2] @ (camera.centre - T[:3, 3]) > 0 for T in shown]
        images = [
            picture(camera, T @ PRINTED, paper if f else back, 0.54, noise=2.0, rng=rng)
            for T, f in zip(shown, front, strict=True)
        ]
        colour = [np.repeat(image[..., None], 3, axis=2) for image in images]
        write_video(place / f"films/capture/{camera.name}.aligned.mp4", colour, 40.0, turned=True, crf=12)
        for number, image in enumerate(images):
            write_image(place / f"pictures/{camera.name}/shot{number:02d}.png", image)
    return place, cameras


@pytest.fixture(scope="module")
def calibrated(filmed, tmp_path_factory):
    out = tmp_path_factory.mktemp("calibrated")
    said = []
    return out, calibrate_folder(filmed[0] / "films", out, BOARD, say=said.append), said


def apart(cameras, folder):
    """How far (C,) [m] each camera of calibration.json is from its true place once the rigs are laid on each other."""
    entries = read_calibration(folder / "calibration.json")
    found = [camera_of(name, entry, SIZE) for name, entry in entries.items()]
    a, b = (np.array([c.centre for c in rig]) for rig in (cameras, found))
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    U, _, Vt = np.linalg.svd(a.T @ b)
    return np.linalg.norm(b @ (U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt).T - a, axis=1)


def test_films_of_a_board_give_the_rig(filmed, calibrated):
    out, facts, said = calibrated
    assert apart(filmed[1], out).max() < 2e-3 and facts["error_px"] < 0.2
    assert facts == json.loads((out / "calibrate.json").read_text())
    assert list(facts["cameras"]) == ["cam0001", "cam0002", "cam0003"] and facts["moments"] == 12
    for camera in facts["cameras"].values():
        assert camera["views"] >= 3 and camera["error_px"] < 0.2 and camera["corners"] > 60
    assert facts["cameras"]["cam0001"]["place_error_mm"] == 0 < facts["cameras"]["cam0002"]["place_error_mm"]
    assert "3 cameras calibrated from" in facts["sentence"] and any("cam0002, 2 of 3" in line for line in said)


def test_the_page_shows_rig_and_coverage(calibrated):
    page = (calibrated[0] / "calibrate.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 2 and not re.search(r"https?://|@import|<script", page)
    assert all(f"<td>cam{i:04d}</td>" in page for i in (1, 2, 3)) and "measure the print" in page
    for name in ("rig.png", "coverage.png"):
        assert iio.imread(calibrated[0] / name)[..., :3].std() > 8, name


def test_pictures_of_the_same_moments_give_the_rig_and_lenses_that_are_given_stay(filmed, tmp_path):
    place, cameras = filmed
    shutil.copytree(place / "pictures", tmp_path / "in/pictures")
    (tmp_path / "in/pictures/cam0002/shot00.png").unlink()
    write_image(tmp_path / "in/pictures/earlier/rig.png", np.zeros((9, 9, 3), np.uint8))
    (tmp_path / "in/pictures/earlier/calibrate.json").write_text("{}")  # no camera, an earlier calibration
    write_calibration(tmp_path / "lenses.json", cameras)
    facts = calibrate_folder(tmp_path / "in/pictures", tmp_path / "out", BOARD, lenses=tmp_path / "lenses.json")
    assert apart(cameras, tmp_path / "out").max() < 1e-3 and facts["lenses_given"]
    for name, entry in read_calibration(tmp_path / "out/calibration.json").items():
        true = next(camera for camera in cameras if camera.name == name)
        np.testing.assert_allclose(entry["intrinsic"], true.K, rtol=1e-12)
        np.testing.assert_allclose(entry["distortion"][:5], true.distortion, rtol=1e-12)


def test_interrupted_calibration_goes_on_without_looking_again(filmed, calibrated, tmp_path, monkeypatch):
    shutil.copytree(calibrated[0] / "views", tmp_path / "views")
    (tmp_path / "views/cam0003.npz").unlink()
    found, looked = boards.find_board, []
    monkeypatch.setattr(boards, "find_board", lambda *given: looked.append(given[1]) or found(*given))
    calibrate_folder(filmed[0] / "films", tmp_path, BOARD)
    assert looked == ["cam0003.aligned.mp4 (cam0003)"]
    one, other = (read_calibration(place / "calibration.json") for place in (tmp_path, calibrated[0]))
    for name, entry in one.items():
        np.testing.assert_allclose(entry["extrinsic"], other[name]["extrinsic"], atol=1e-3)  # [mm], threads add


@pytest.mark.parametrize(
    ("board", "words"),
    [
        (replace(BOARD, columns=7), "got markers up to id 26 where that board has 0 to 20"),
        (replace(BOARD, columns=6, rows=9), "got its markers in another order: columns and rows may be swapped"),
        (replace(BOARD, dictionary="DICT_4X4_100"), "got none of its markers in any of 12 pictures"),
    ],
)
def test_another_board_is_named_with_what_was_seen_instead(filmed, tmp_path, board, words):
    with pytest.raises(ValueError, match="cam0001 pictures must show the board of ") as error:
        calibrate_folder(filmed[0] / "pictures", tmp_path, board)
    assert words in str(error.value)


def test_bad_input_is_one_sentence_naming_file_and_camera(filmed, tmp_path):
    films, pictures = filmed[0] / "films", filmed[0] / "pictures"
    shutil.copytree(pictures, tmp_path / "a")
    write_image(tmp_path / "a/cam0002/shot05.png", np.zeros((60, 80), np.uint8))
    with pytest.raises(ValueError, match=r"shot05.png \(cam0002\) must be 480 x 300 pixels as the first"):
        calibrate_folder(tmp_path / "a", tmp_path / "out", BOARD)
    for number in range(12):
        write_image(tmp_path / f"b/cam0009/shot{number:02d}.png", np.zeros((60, 80), np.uint8))
    with pytest.raises(ValueError, match=r"cam0009 pictures must show the board of 9 x 6 squares of 60 mm .* none of"):
        calibrate_folder(tmp_path / "b", tmp_path / "out", BOARD)
    shutil.copytree(films, tmp_path / "c")
    frames = np.zeros((3, 100, 64, 3), np.uint8)
    write_video(tmp_path / "c/capture/cam0003.aligned.mp4", frames, 40.0, turned=True)
    with pytest.raises(ValueError, match=r"cam0003.aligned.mp4 \(cam0003\) must have 12 frames as cam0001.aligned.mp4"):
        calibrate_folder(tmp_path / "c", tmp_path / "out", BOARD)
    (tmp_path / "d/recording").mkdir(parents=True)
    with pytest.raises(ValueError, match="a recording that is not finished: veo capture --out"):
        calibrate_folder(tmp_path / "d", tmp_path / "out", BOARD)
    with pytest.raises(ValueError, match="--without must name cameras among cam0001, cam0002, cam0003; got cam0007"):
        calibrate_folder(films, tmp_path / "out", BOARD, without=["cam0007"])
    with pytest.raises(ValueError, match="--coefficients must be 0, 4, 5, 8 or 12"):
        calibrate_folder(films, tmp_path / "out", BOARD, coefficients=14)
    write_calibration(tmp_path / "lenses.json", filmed[1][:2])
    with pytest.raises(ValueError, match=r"lenses.json must hold the lens of every camera; got none of cam0003"):
        calibrate_folder(films, tmp_path / "out", BOARD, lenses=tmp_path / "lenses.json")
    with pytest.raises(ValueError, match="--squares must be columns x rows, like 9x6; got '9by6'"):
        board_of("9by6", 40, 30, "DICT_5X5_1000", False)


def test_the_command_says_what_is_wrong_in_one_line(tmp_path, capsys):
    assert cli.main(["calibrate", str(tmp_path / "nowhere"), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "FOLDER must be a folder with videos or pictures" in said and "Traceback" not in said


def seen_at(name, shots):
    shot = np.array(sorted(shots), int)
    return BoardViews(
        name=name, size=SIZE, shots=1000, shot=shot, corner=np.zeros(len(shot), int), pixel=np.zeros((len(shot), 2))
    )


def test_moments_are_spread_and_serve_the_camera_that_is_known_least():
    every, rare = seen_at("cam0001", range(1000)), seen_at("cam0002", range(500, 512))
    shots = best_shots([every, rare], 60)
    assert len(shots) == 60 and np.isin(shots, rare.shot).sum() >= 6 and (np.diff(shots) > 0).all()
    alone = best_shots([every], 60)
    assert np.diff(alone).max() < 4 * 1000 / 60 and np.diff(alone).min() > 1000 / 60 / 4
    np.testing.assert_array_equal(best_shots([rare], 60), rare.shot)
    assert len(of_shots(every, shots).shot) == 60
