"""The figures of the capture side: what is measured is what was planted, and the table is whole."""

import numpy as np
import pytest

from benchmarks.capture import sections
from benchmarks.capture_boards import BOARD, pictures
from benchmarks.capture_reading import reading_rows
from benchmarks.capture_rows import file_rows, hull_rows, interior, matte_rows, nozzle_rows, overlap
from benchmarks.table import markdown
from recon.calibration.charuco import find_board
from recon.cameras import Camera
from recon.rig.make import make_rig
from recon.rig.options import RigFaults, RigOptions
from recon.rig.truth import read_truth
from recon.rigid import rigid

OPTIONS = RigOptions(shape="pillow", cameras=7, frames=3, size=240, greys=False, reconstruction=100)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return make_rig(tmp_path_factory.mktemp("rig") / "pillow", OPTIONS)


def test_overlap_is_the_share_in_common():
    first, second = np.zeros((2, 4, 4), bool)
    first[:2], second[1:3] = True, True
    assert overlap(first, second) == pytest.approx(1 / 3) and overlap(first & False, second & False) == 0


def test_interior_points_fill_the_body(recording):
    """Their mean and spread are the body's own, from its tetrahedra in closed form."""
    truth = read_truth(recording)
    corner = truth.points[1][truth.tetrahedra]
    volume = np.linalg.det(corner[:, 1:] - corner[:, :1])
    middle = (volume[:, None] * corner.mean(axis=1)).sum(axis=0) / volume.sum()
    points = interior(truth, 1)
    np.testing.assert_allclose(points.mean(axis=0), middle, atol=2e-3)
    assert (points.min(axis=0) > truth.points[1].min(axis=0) - 1e-4).all()


def test_files_give_back_what_was_true_and_a_wrong_scale_is_seen(recording, tmp_path):
    rows = file_rows(recording, "pillow")
    assert len(rows) == 6 and all(row.reached for row in rows)
    faulty = RigOptions(**{**vars(OPTIONS), "faults": RigFaults(scale=1.02), "cameras": 4, "size": 88})
    wrong = file_rows(make_rig(tmp_path / "wrong", faulty), "wrong")
    assert [row.reached for row in wrong][:4] == [False, True, True, False]


def test_every_figure_has_its_row(recording):
    rows = [*nozzle_rows(recording, "a"), *matte_rows(recording, "b", 4), *hull_rows(recording, "c")]
    assert [row.target != "" for row in rows] == [True] * 6
    assert all(row.reached for row in rows[4:]) and markdown(rows).count("\n") == 7
    assert list(sections(recording, None)) == list(sections(recording, OPTIONS))[:7]
    memory, seconds = reading_rows(recording, 4)
    assert memory.reached and "7 cameras x 4 frames of 240 x 426 pixels" in seconds.what


def test_drawn_boards_are_where_the_camera_projects_them():
    K = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
    camera = Camera(
        name="cam0001", K=K, T_camera_world=np.eye(4), size=(640, 480), distortion=np.array([0.1, -0.2, 0, 0])
    )
    board = rigid(np.array([0.2, -0.3, 0.1]), np.array([-0.2, -0.15, 0.7]))
    away = rigid(np.array([np.pi, 0, 0]), np.array([-0.2, 0.15, 0.7]))
    views = find_board(BOARD, "cam0001", pictures(camera, [board, away], np.random.default_rng(0)))
    assert views.seen.tolist() == [0] and len(views.shot) > 30
    true, _ = camera.project(BOARD.corners[views.corner] @ board[:3, :3].T + board[:3, 3])
    assert np.sqrt(np.mean((views.pixel - true) ** 2)) < 0.15
