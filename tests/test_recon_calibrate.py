"""Calibration against known cameras, with standard errors that hold, and against OpenCV's own multi-view solver."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from boards import BOARD, LENS, MIDDLE, SIZE, held_close, poses, ring, views_of
from flat_pictures import picture

from recon.calibration.bundle import BundleOptions
from recon.calibration.calibrate import FIRST_CAMERA, calibrate_camera, calibrate_rig
from recon.calibration.charuco import Board, BoardViews, find_board
from recon.calibration.sightings import LENS as NUMBERS
from recon.calibration.sightings import Sightings, lenses, projected, residuals
from recon.cameras import Camera
from recon.rigid import inverse, moved, rigid, turn_of

PLAIN = BundleOptions(coefficients=5)
FACTORY = np.array([0.5, -0.3, 0.0005, -0.0003, 0.02, 0.45, -0.2, 0.01, 0.0003, -0.0001, 0.0002, 0.0001])


def off(cameras: list[Camera], found: tuple[Camera, ...]) -> np.ndarray:
    """Turn [rad] and place [m] (C, 6) from the found to the true cameras."""
    T, S = (np.array([c.T_camera_world for c in rig]) for rig in (cameras, found))
    place = np.array([a.centre - b.centre for a, b in zip(cameras, found, strict=True)])
    return np.concatenate([turn_of(T[:, :3, :3] @ np.swapaxes(S[:, :3, :3], 1, 2)), place], axis=1)


def apart(cameras: list[Camera], found: tuple[Camera, ...]) -> np.ndarray:
    """How far (C,) [m] each camera is from its true place once the whole rig is laid on the true one (Kabsch)."""
    a, b = (np.array([c.centre for c in rig]) for rig in (cameras, found))
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    U, _, Vt = np.linalg.svd(a.T @ b)
    turn = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    return np.linalg.norm(b @ turn.T - a, axis=1)


def squares(away: np.ndarray, covariance: np.ndarray) -> float:
    """Mean over cameras but the first of the squared error in standard errors, by its six numbers."""
    return float(np.mean([e @ np.linalg.solve(C, e) / 6 for e, C in zip(away[1:], covariance[1:], strict=True)]))


def test_board_corners_are_found_to_hundredths_of_a_pixel():
    rng = np.random.default_rng(0)
    camera = replace(ring(1, rng)[0], T_camera_world=np.eye(4))
    boards = held_close(camera, 3, rng)
    upright = rigid(np.array([np.pi, 0, 0]), MIDDLE)  # the print's own frame has y upwards
    images = [picture(camera, T @ upright, BOARD.print(50), 0.54, noise=3.0, rng=rng) for T in boards]
    seen = find_board(BOARD, "cam0001", [images[0], None, images[1], np.repeat(images[2][..., None], 3, axis=2)])
    np.testing.assert_array_equal(seen.seen, [0, 2, 3])
    board = boards[np.maximum(seen.shot - 1, 0)]
    true = camera.project(moved(board, BOARD.corners[seen.corner]))[0]
    assert np.sqrt(np.mean((seen.pixel - true) ** 2)) < 0.06  # 0.1 with OpenCV's own window


def test_slopes_agree_with_differences():
    rng = np.random.default_rng(1)
    cameras = ring(3, rng, lens=FACTORY)
    T, bodies, lens = np.array([c.T_camera_world for c in cameras]), poses(2, rng), lenses(cameras)
    points = rng.normal(size=(24, 3)) * 0.1
    s = Sightings(camera=np.arange(24) % 3, body=np.arange(24) % 2, point=points, pixel=np.zeros((24, 2)))
    exact = projected(lens, T, bodies, s)

    def difference(change, h=1e-6):
        ends = [residuals(*change(sign * h), s) for sign in (1, -1)]
        return (ends[0] - ends[1]) / (2 * h)

    def by_camera(h, k):
        turn, place = np.split(np.eye(6)[k] * h, 2)
        turned = rigid(turn, np.zeros(3)) @ T @ rigid(np.zeros(3), -place)
        return lens, turned, bodies

    def by_body(h, k):
        turn, place = np.split(np.eye(6)[k] * h, 2)
        changed = bodies.copy()
        changed[:, :3, :3], changed[:, :3, 3] = rigid(turn, place)[:3, :3] @ bodies[:, :3, :3], bodies[:, :3, 3] + place
        return lens, T, changed

    for k in range(6):
        np.testing.assert_allclose(difference(lambda h, k=k: by_camera(h, k)), exact.by_camera[..., k], atol=2e-4)
        np.testing.assert_allclose(difference(lambda h, k=k: by_body(h, k)), exact.by_body[..., k], atol=2e-4)
    for k in range(NUMBERS):
        slope = difference(lambda h, k=k: (lens + h * np.eye(NUMBERS)[k], T, bodies))
        np.testing.assert_allclose(slope, exact.by_lens[..., k], atol=2e-4)


def test_lens_is_found_within_its_standard_error():
    rng = np.random.default_rng(2)
    camera = ring(1, rng)[0]
    views = views_of([camera], held_close(camera, 15, rng), rng, noise=0.1)[0]
    found, report = calibrate_camera(BOARD, views, options=PLAIN)
    np.testing.assert_array_equal(found.T_camera_world, np.eye(4))
    assert abs(found.K[0, 0] - camera.K[0, 0]) < 3 * report.focal_error_px < 2.0
    assert report.error_px == pytest.approx(0.1 * 2**0.5, rel=0.1) and report.covered > 0.5 and report.strays == 0
    grid = camera.grid()[60:-60:80, 100:-100:80].reshape(-1, 2)  # inside the corners: the same rays, turned as a whole
    there, here = camera.rays(grid) @ camera.T_camera_world[:3, :3].T, found.rays(grid)
    U, _, Vt = np.linalg.svd(there.T @ here)
    assert 870 * np.abs(there @ U @ Vt - here).max() < 0.5  # [px]


@pytest.mark.parametrize(("lens", "coefficients"), [(np.zeros(0), 0), (LENS[:4], 4), (FACTORY[:8], 8), (FACTORY, 12)])
def test_every_length_of_distortion_fits_to_the_noise(lens, coefficients):
    rng = np.random.default_rng(3)
    camera = ring(1, rng, lens=lens)[0]
    views = views_of([camera], held_close(camera, 12, rng), rng, noise=0.1)[0]
    found, report = calibrate_camera(BOARD, views, options=BundleOptions(coefficients=coefficients))
    assert len(found.distortion) == coefficients
    assert report.error_px == pytest.approx(0.1 * 2**0.5, rel=0.1)


def test_six_cameras_are_found_within_their_standard_errors():
    rng = np.random.default_rng(4)
    cameras = ring(6, rng)
    boards = np.concatenate([poses(30, rng), *(held_close(c, 6, rng) for c in cameras)])
    found, report = calibrate_rig(
        BOARD, views_of(cameras, boards, rng, noise=0.1), first=cameras[0].T_camera_world, options=PLAIN
    )
    np.testing.assert_allclose(found[0].T_camera_world, cameras[0].T_camera_world, atol=1e-12)
    assert report.error_px < 0.5 and max(c.error_px for c in report.cameras) < 0.5
    assert apart(cameras, found).mean() < 5e-4 and report.sentences == ()
    assert 0.3 < squares(off(cameras, found), report.covariance) < 2.5  # one: five cameras share the first one's error
    assert not report.covariance[0].any() and report.cameras[0].place_error_mm == 0


def test_nineteen_cameras_with_known_lenses_are_found_to_a_tenth_of_a_millimetre():
    rng = np.random.default_rng(5)
    cameras = ring(19, rng, lens=FACTORY)
    turned = [replace(c, T_camera_world=np.eye(4)) for c in cameras]
    found, report = calibrate_rig(BOARD, views_of(cameras, poses(40, rng), rng, noise=0.1), cameras=turned)
    assert report.error_px < 0.5 and apart(cameras, found).max() < 2e-4
    np.testing.assert_array_equal(found[3].K, cameras[3].K)
    np.testing.assert_array_equal(found[0].T_camera_world, FIRST_CAMERA)


def test_known_lenses_give_what_opencv_gives():
    rng = np.random.default_rng(6)
    cameras = ring(6, rng)
    views = views_of(cameras, poses(30, rng), rng, noise=0.1)
    found, _ = calibrate_rig(
        BOARD, views, cameras=cameras, first=np.eye(4), options=BundleOptions(lenses=False, loose=1e3, stray=1e3)
    )
    pixels = [[np.full((len(BOARD.corners), 2), -1, np.float32) for _ in range(30)] for _ in cameras]
    for row, view in zip(pixels, views, strict=True):
        for shot, corner, pixel in zip(view.shot, view.corner, view.pixel, strict=True):
            row[shot][corner] = pixel
    mask = np.array([np.isin(np.arange(30), v.seen) for v in views], np.uint8)
    fixed = np.full(6, cv2.CALIB_FIX_INTRINSIC, np.int32)
    K, lens = [c.K.copy() for c in cameras], [c.distortion[None].copy() for c in cameras]
    points = [BOARD.corners.astype(np.float32)] * 30
    _, _, _, turns, shifts = cv2.calibrateMultiview(
        points, pixels, [SIZE] * 6, mask, np.zeros(6, np.uint8), K, lens, None, None, fixed,
        cv2.CALIB_USE_INTRINSIC_GUESS, (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 1000, 1e-12)
    )  # fmt: skip
    for camera, turn, shift in zip(found, turns, shifts, strict=True):
        R = cv2.Rodrigues(turn)[0] if np.size(turn) == 3 else turn
        assert np.abs(camera.T_camera_world[:3, :3] - R).max() < 1e-5
        assert np.abs(camera.T_camera_world[:3, 3] - np.ravel(shift)).max() < 1e-5


def test_board_that_moved_between_exposures_is_left_out():
    rng = np.random.default_rng(7)
    cameras = ring(6, rng)
    views = views_of(cameras, poses(40, rng), rng, noise=0.1)
    clean, _ = calibrate_rig(BOARD, views, cameras=cameras)
    shared = [s for s in views[0].seen if s in views[1].seen][:2]
    bad = np.isin(views[0].shot, shared)
    shaken = [replace(views[0], pixel=views[0].pixel + bad[:, None] * [40.0, 25.0]), *views[1:]]
    found, report = calibrate_rig(BOARD, shaken, cameras=cameras)
    assert apart(list(clean), found).max() < 2e-4
    assert sum(c.strays for c in report.cameras) >= 0.9 * bad.sum()
    assert any("corners were left out as wrong" in sentence for sentence in report.sentences)


def nothing(name: str = "cam0009") -> BoardViews:
    none = np.zeros(0, int)
    return BoardViews(name=name, size=SIZE, shots=4, shot=none, corner=none, pixel=np.zeros((0, 2)))


def test_bad_input_is_one_sentence_naming_the_camera():
    rng = np.random.default_rng(8)
    cameras = ring(4, rng)
    views = views_of(
        cameras, np.concatenate([poses(20, rng), *(held_close(c, 4, rng) for c in cameras)]), rng, noise=0.1
    )
    with pytest.raises(ValueError, match="cam0009 board must be seen in a picture; got none of 4"):
        calibrate_rig(BOARD, [*views, nothing()])
    with pytest.raises(ValueError, match="cam0009 board must be seen in 3 pictures; got 0 of 4"):
        calibrate_camera(BOARD, nothing())
    alone = replace(views[3], shot=views[3].shot + 1000)
    with pytest.raises(ValueError, match="cam0004 must see the board together with one that is linked to cam0001"):
        calibrate_rig(BOARD, [*views[:3], alone], cameras=cameras)
    small = replace(views[2], size=(640, 400))
    with pytest.raises(
        ValueError, match=r"cam0003 pictures must be cam0003's of \(1280, 800\) pixels; got \(640, 400\)"
    ):
        calibrate_rig(BOARD, [*views[:2], small, views[3]], cameras=cameras)
    with pytest.raises(ValueError, match="cameras must be as many as views, 4; got 3"):
        calibrate_rig(BOARD, views, cameras=cameras[:3])
    with pytest.raises(ValueError, match="views must name each camera once"):
        calibrate_rig(BOARD, [views[0], views[0]])
    grey = np.zeros((40, 60), np.uint8)
    with pytest.raises(
        ValueError, match=r"cam0001 picture 1 must be 60 x 40 pixels of uint8 like its first; got \(40, 60\)"
    ):
        find_board(BOARD, "cam0001", [grey, grey.T.copy()])
    with pytest.raises(ValueError, match="cam0001 pictures must hold at least one; got 0"):
        find_board(BOARD, "cam0001", [])
    with pytest.raises(ValueError, match="board marker must be smaller than its square"):
        Board(columns=9, rows=6, square=0.03, marker=0.04)
    with pytest.raises(ValueError, match="coefficients must be 0, 4, 5, 8, 12 or 14; got 3"):
        BundleOptions(coefficients=3)


def test_few_corners_in_the_middle_are_said():
    rng = np.random.default_rng(9)
    camera = ring(1, rng)[0]
    far = inverse(camera.T_camera_world) @ rigid(rng.uniform(-0.5, 0.5, (8, 3)), np.tile([0, 0, 1.6], (8, 1)))
    views = views_of([camera], far @ rigid(np.zeros(3), -MIDDLE), rng, noise=0.1)[0]
    _, report = calibrate_camera(BOARD, views)
    assert len(report.sentences) == 1 and "beyond it the lens is a guess" in report.sentences[0]
