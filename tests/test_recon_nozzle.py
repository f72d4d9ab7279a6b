"""The nozzle's marker in drawn pictures of three cameras: its true pose, an honest covariance, gaps, liars."""

import json

import numpy as np
import pytest
from flat_pictures import picture
from scipy.spatial.transform import Rotation, Slerp

from recon.cameras import Camera, look_at
from recon.marker import Finder, Marker
from recon.nozzle.choosing import chosen
from recon.nozzle.consensus import Detections, hypotheses
from recon.nozzle.path import MARKER, NozzleTrack, TrackOptions, nozzle_path, stream_covariance, track
from recon.plush.reconstruction import MARKER_ID, TO_RECONSTRUCTION, read_plush
from recon.plush.reconstruction_writer import write_nozzle
from recon.rigid import moved, rigid, turn_of

LENS = np.array([0.08, -0.15, 0.0005, -0.0003, 0.05])
K = np.array([[870.0, 0, 239.5], [0, 870, 159.5], [0, 0, 1]])  # an OAK-D's grey camera, the middle of its picture
FACING = rigid(np.array([0.0, 1.02, 0.0]), np.zeros(3)) @ rigid(np.array([0.0, 0.0, np.pi / 2]), np.zeros(3))
PAPER = MARKER.print(40)
WIDTH = MARKER.side * 10 / 8  # with its margin of a cell [m]


def rig(count: int = 3) -> list[Camera]:
    """Cameras 800 mm from the marker, 34 degrees apart."""
    angles = 0.6 * (np.arange(count) - (count - 1) / 2)
    eyes = 0.8 * np.stack([0.85 * np.cos(angles), 0.85 * np.sin(angles), np.full(count, 0.52)], axis=1)
    T = [look_at(eye, np.zeros(3), np.array([0.0, 0, 1])) for eye in eyes]
    size = (480, 320)
    return [Camera(name=f"cam{k:04d}", K=K, T_camera_world=t, size=size, distortion=LENS) for k, t in enumerate(T)]


def truth(frames: int, rng: np.random.Generator, shift: float = 0.05) -> np.ndarray:
    """Poses (T, 4, 4) of a marker that turns and wanders."""
    return rigid(rng.uniform(-0.4, 0.4, (frames, 3)), rng.uniform(-shift, shift, (frames, 3))) @ FACING


def pictures(cameras: list[Camera], T: np.ndarray, rng: np.random.Generator, print_: np.ndarray = PAPER, **drawn):
    for pose in T:
        yield [picture(camera, pose, print_, WIDTH, noise=3.0, rng=rng, **drawn) for camera in cameras]


def errors(found: NozzleTrack, T: np.ndarray) -> np.ndarray:
    """Turn [rad] and shift [m] (T, 6) from the found to the true poses."""
    turn = turn_of(T[:, :3, :3] @ np.swapaxes(found.T_world_marker[:, :3, :3], 1, 2))
    return np.concatenate([turn, T[:, :3, 3] - found.T_world_marker[:, :3, 3]], axis=1)


@pytest.fixture(scope="module")
def followed() -> tuple[NozzleTrack, np.ndarray]:
    rng = np.random.default_rng(0)
    cameras, T = rig(), truth(24, rng)
    return track(cameras, pictures(cameras, T, rng)), T


def test_three_cameras_find_the_marker(followed):
    found, T = followed
    off = errors(found, T)
    assert found.seen.all() and (found.views == 3).all() and found.sentences == ()
    assert 1e3 * np.linalg.norm(off[:, 3:], axis=1).mean() < 0.03
    assert np.degrees(np.linalg.norm(off[:, :3], axis=1)).mean() < 0.1


def test_covariance_is_honest(followed):
    found, T = followed
    off = errors(found, T)
    square = np.einsum("ti,tij,tj->t", off, np.linalg.inv(found.covariance), off)
    assert 2.5 < square.mean() < 9.0  # six numbers: six; the mean over 24 frames spreads by 0.7, a bias of edges adds
    start, direction = stream_covariance(found)
    path = nozzle_path(found)
    moves = path.position - moved(T, np.tile([0, 0.105, 0], (len(T), 1)))
    square = np.einsum("ti,tij,tj->t", moves, np.linalg.inv(start), moves)
    assert 1.0 < square.mean() < 5.0  # three numbers
    assert np.trace(direction, axis1=1, axis2=2).mean() == pytest.approx(
        ((path.direction - T[:, :3, :3] @ [0, 0, -1]) ** 2).sum(axis=1).mean(), rel=0.6
    )


@pytest.mark.parametrize("blur", [0.5, 1.0])
def test_corners_are_where_the_edges_meet_however_the_lens_blurs(blur):
    rng = np.random.default_rng(1)
    camera, T = rig(1)[0], truth(8, rng)
    drawn = [p for (p,) in pictures([camera], T, rng, blur=blur)]
    true = np.array([camera.project(moved(pose, MARKER.corners))[0] for pose in T])
    found = np.array([Finder(MARKER, camera)(image, 0).corners[0] for image in drawn])
    assert np.sqrt(np.mean((found - true) ** 2)) < 0.05  # OpenCV's own are off by 0.36 and 0.55


def test_gap_is_interpolated_and_marked():
    rng = np.random.default_rng(2)
    cameras = rig()
    T = (
        rigid(np.outer(np.linspace(0, 0.5, 9), [0.3, 0.5, 1.0]), np.outer(np.linspace(0, 0.08, 9), [0, 1, 0.5]))
        @ FACING
    )
    frames = [p if k not in (0, 3, 4, 8) else [None] * 3 for k, p in enumerate(pictures(cameras, T, rng))]
    found = track(cameras, frames)
    np.testing.assert_array_equal(found.seen, ~np.isin(np.arange(9), (0, 3, 4, 8)))
    assert found.sentences == ("marker: in 4 of 9 frames no pose could be found; it is interpolated",)
    R = Rotation.from_matrix(found.T_world_marker[:, :3, :3])
    between = Slerp([2, 5], R[[2, 5]])([3, 4])
    np.testing.assert_allclose(R[[3, 4]].as_matrix(), between.as_matrix(), atol=1e-12)
    shift = found.T_world_marker[:, :3, 3]
    np.testing.assert_allclose(shift[3], (2 * shift[2] + shift[5]) / 3, atol=1e-12)
    np.testing.assert_array_equal(found.T_world_marker[[0, 8]], found.T_world_marker[[1, 7]])
    spread = np.trace(found.covariance[:, 3:, 3:], axis1=1, axis2=2)
    assert spread[[0, 3, 4, 8]].min() > 100 * spread[found.seen].max()
    assert not nozzle_path(found).seen[3]


def test_single_sight_says_nothing_of_other_frames():
    rng = np.random.default_rng(10)
    cameras, T = rig(), truth(1, rng)
    found = track(cameras, [[None] * 3, *pictures(cameras, T, rng), [None] * 3])
    np.testing.assert_array_equal(found.seen, [False, True, False])
    assert np.isfinite(found.covariance[1]).all() and np.isinf(np.diagonal(found.covariance[0])).all()


def test_liar_among_three_cameras_is_left_out_and_counted():
    rng = np.random.default_rng(3)
    cameras, T = rig(), truth(3, rng, shift=0.02)
    frames = list(pictures(cameras, T, rng))
    elsewhere = rigid(np.zeros(3), np.array([0.0, 0.12, 0.0])) @ T[1]  # a second print, or a reflection
    frames[1][2] = picture(cameras[2], elsewhere, PAPER, WIDTH, noise=3.0, rng=rng)
    found = track(cameras, frames)
    np.testing.assert_array_equal(found.views, [3, 2, 3])
    np.testing.assert_array_equal(found.rejected, [0, 0, 1])
    assert found.sentences == ("cam0002: finds of the marker that agree with no pose and were left out: 1",)
    assert np.linalg.norm(errors(found, T)[:, 3:], axis=1).max() < 1e-4


def test_two_cameras_that_contradict_are_settled_by_the_neighbours_only():
    rng = np.random.default_rng(4)
    cameras, T = rig(2), np.tile(FACING, (3, 1, 1))
    frames = list(pictures(cameras, T, rng))
    elsewhere = rigid(np.zeros(3), np.array([0.0, 0.1, 0.0])) @ FACING
    frames[1][0] = picture(cameras[0], elsewhere, PAPER, WIDTH, noise=3.0, rng=rng)
    found = track(cameras, frames)
    np.testing.assert_array_equal(found.guided, [False, True, False])
    np.testing.assert_array_equal(found.rejected, [1, 0])
    assert np.linalg.norm(errors(found, T)[1, 3:]) < 3e-3
    with pytest.raises(ValueError, match="marker 164 must have one pose in at least one frame; got none"):
        track(cameras, frames[1:2])


def test_two_tilts_that_one_camera_allows_are_settled_by_the_neighbours():
    """Corners half a pixel off leave one camera both tilts of the square; three cameras before and after know."""
    cameras, right, T = rig(), 0, rigid(np.array([0.0, 0.5, 0.0]), np.zeros(3)) @ FACING
    for seed in range(20):
        rng = np.random.default_rng(seed)
        frame, camera = np.array([[0, 0], [0, 1], [0, 2], [1, 1], [2, 0], [2, 1], [2, 2]]).T
        corners = np.array([cameras[c].project(moved(T, MARKER.corners))[0] for c in camera])
        noisy = Detections(frame=frame, camera=camera, corners=corners + rng.normal(0, 0.5, corners.shape))
        poses = hypotheses(MARKER, cameras, noisy, agreement=1.5)
        pick, guided = chosen(poses, 3, MARKER.side)
        assert (pick[[0, 2]] >= 0).all() and not guided[[0, 2]].any()
        if guided[1]:
            turn = np.linalg.norm(turn_of(np.linalg.inv(poses.T_world_marker[pick[1]]) @ T))
            rivals = poses.T_world_marker[(poses.frame == 1) & (poses.views == 1)]
            right += turn == np.linalg.norm(turn_of(np.linalg.inv(rivals) @ T), axis=1).min()
            assert turn < 0.6
    assert right >= 10


def test_stream_starts_and_blows_where_the_plush_reader_says(followed, tmp_path):
    found, _ = followed
    flip = np.diag([*TO_RECONSTRUCTION, 1.0])
    in_file = flip @ found.T_world_marker  # the first camera's own frame
    in_file[:, :3, 3] *= 1e3
    entries = [{"aruco_ids": [MARKER_ID], "rvecs": T[:3, :3].tolist(), "tvecs": T[:3, 3].tolist()} for T in in_file]
    (tmp_path / "capture").mkdir()
    (tmp_path / "capture/aruco_path.json").write_text(json.dumps(entries))
    path = nozzle_path(found)
    for _ in range(2):  # as the dataset has it, then through our own writer
        read = read_plush(tmp_path).nozzle
        np.testing.assert_allclose(read.position, path.position, atol=1e-12)
        np.testing.assert_allclose(read.direction, path.direction, atol=1e-12)
        np.testing.assert_array_equal(read.seen, path.seen)
        write_nozzle(tmp_path, path)


def test_bad_input_is_one_sentence():
    rng = np.random.default_rng(6)
    cameras, T = rig(2), truth(1, rng)
    other = Marker(id=7, side=0.04).print(40)
    with pytest.raises(ValueError, match="marker 164 must be seen by cam0000, cam0001; got ids 7"):
        track(cameras, pictures(cameras, T, rng, other))
    with pytest.raises(ValueError, match="marker 164 must be seen by cam0000, cam0001; got no marker at all"):
        track(cameras, [[None, None]])
    with pytest.raises(ValueError, match=r"cam0001 frame 0 must be 480 x 320 pixels of uint8; got \(32, 32\) uint8"):
        track(cameras, [[np.zeros((320, 480), np.uint8), np.zeros((32, 32), np.uint8)]])
    with pytest.raises(ValueError, match="frame 0 must hold 2 pictures; got 1"):
        track(cameras, [[None]])
    with pytest.raises(ValueError, match="marker id must be one of DICT_4X4_50's 50; got 164"):
        Marker(id=164, side=0.04, dictionary="DICT_4X4_50")
    with pytest.raises(ValueError, match="dictionary must be one of OpenCV's, like DICT_5X5_100; got 'DICT_ODD'"):
        Marker(id=164, side=0.04, dictionary="DICT_ODD")
    with pytest.raises(ValueError, match="agreement must be positive"):
        TrackOptions(agreement=0.0)
