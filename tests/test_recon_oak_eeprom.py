"""A device's own calibration as cameras, against DepthAI's reader of it and OpenCV's projection."""

import json

import cv2
import depthai as dai
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from recon.cameras import Camera
from recon.oak.eeprom import eeprom_cameras
from recon.oak.spec import DeviceSpec, StreamSpec, default_rig
from recon.turned import turned

SOCKETS = {"cam0001": "CAM_A", "cam0001.left": "CAM_B", "cam0001.right": "CAM_C"}
LENS = [0.02, -0.3, 0.001, -0.002, 0.1, 0.01, -0.2, 0.05, 0.001, -0.0005, 0.0007, 0.0003, 0.0, 0.0]
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def socket(name):
    return getattr(dai.CameraBoardSocket, name)


def oak(colour=(3840, 2160), lens=LENS):
    """An OAK-D's EEPROM: left to right to colour, as the factory links them, in centimetres."""
    handler = dai.CalibrationHandler()
    for name, size, focal in (("CAM_A", colour, 3000), ("CAM_B", (1280, 800), 800), ("CAM_C", (1280, 800), 805)):
        K = [[focal, 0, size[0] / 2 + 11], [0, focal + 2, size[1] / 2 - 7], [0, 0, 1]]
        handler.setCameraIntrinsics(socket(name), K, *size)
        handler.setDistortionCoefficients(socket(name), lens)
    for start, end, turn, shift in (
        ("CAM_B", "CAM_C", [0.01, -0.02, 0.03], [-7.5, 0.02, 0.01]),
        ("CAM_C", "CAM_A", [-0.02, 0.01, 0.005], [3.7, 0.1, -0.2]),
    ):
        handler.setCameraExtrinsics(socket(start), socket(end), Rotation.from_rotvec(turn).as_matrix().tolist(), shift)
    return handler


def device(turned_deg=0, **options):
    streams = default_rig(1).devices[0].streams
    return DeviceSpec(**{"name": "cam0001", "streams": streams, "turned_deg": turned_deg, **options})


def test_cameras_stand_to_one_another_as_depthai_says():
    handler = oak()
    cameras = {c.name: c for c in eeprom_cameras(device(), handler.eepromToJson())}
    np.testing.assert_allclose(cameras["cam0001"].T_camera_world, FLIP, atol=1e-12)  # the first camera's frame
    for name, place in SOCKETS.items():
        T = np.array(handler.getCameraExtrinsics(socket("CAM_A"), socket(place)) if place != "CAM_A" else np.eye(4))
        T[:3, 3] *= 0.01  # cm
        np.testing.assert_allclose(cameras[name].T_camera_world, T @ FLIP, atol=1e-6)
    baseline = cameras["cam0001.left"].centre - cameras["cam0001.right"].centre
    assert np.linalg.norm(baseline) == pytest.approx(0.075, abs=1e-4)
    assert [c.stream for c in cameras.values()] == ["colour", "left", "right"]


@pytest.mark.parametrize("colour", [(3840, 2160), (1920, 1080), (4056, 3040)])
def test_intrinsics_follow_the_recorded_size_as_depthai_scales_them(colour):
    """The same but for the half pixel by which DepthAI's corners and OpenCV's pixel centres differ."""
    handler = oak(colour)
    cameras = {c.name: c for c in eeprom_cameras(device(), handler.eepromToJson())}
    for name, place in SOCKETS.items():
        theirs = np.array(handler.getCameraIntrinsics(socket(place), *cameras[name].size))
        scale = cameras[name].size[0] / (colour[0] if place == "CAM_A" else 1280)
        theirs[:2, 2] += (scale - 1) / 2
        np.testing.assert_allclose(cameras[name].K, theirs, rtol=2e-6, atol=1e-3)
        np.testing.assert_allclose(cameras[name].distortion, LENS[:12], atol=1e-7)
    tilted = eeprom_cameras(device(), oak(lens=[*LENS[:12], 0.01, 0.0]).eepromToJson())[0]
    assert len(tilted.distortion) == 14


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_upright_pictures_show_points_where_the_turned_sensor_saw_them(degrees):
    rng = np.random.default_rng(4)
    held = oak().eepromToJson()
    lying = {c.name: c for c in eeprom_cameras(device(), held)}
    up = {c.name: c for c in eeprom_cameras(device(degrees), held)}
    # the world is the upright colour camera's frame: the lying one's, turned about the line of sight
    R = Rotation.from_euler("z", -degrees, degrees=True).as_matrix()
    points = np.array([0, 0, 0.8]) + rng.uniform(-0.15, 0.15, (40, 3))  # in the lying colour camera's frame
    for name, camera in lying.items():
        image = np.zeros(camera.size[::-1], np.uint8)
        u, v = np.round(camera.project(points @ FLIP[:3, :3])[0]).astype(int).T
        image[v, u] = np.arange(1, 41)
        upright = np.rot90(image, degrees // 90)
        assert up[name].size == upright.shape[::-1]
        u, v = np.round(up[name].project(points @ R.T @ FLIP[:3, :3])[0]).astype(int).T
        np.testing.assert_array_equal(upright[v, u], image[image > 0][np.argsort(image[image > 0])])


@pytest.mark.parametrize("lens", [LENS[:12], [*LENS[:12], 0.03, 0.0], [*LENS[:12], 0.0, -0.02], LENS[:5], []])
@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_turning_a_camera_turns_its_projection(lens, degrees):
    """OpenCV projects through the lying lens; (u, v) -> (v, width - 1 - u) a quarter turn is done by hand."""
    rng = np.random.default_rng(5)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(random_state=6).as_matrix(), [0.1, -0.2, 0.3]
    K = np.array([[900.0, 0, 700], [0, 910, 350], [0, 0, 1]])
    camera = Camera(name="a", K=K, T_camera_world=T, size=(1280, 720), distortion=np.array(lens))
    points = (np.array([0, 0, 1.0]) + rng.uniform(-0.3, 0.3, (50, 3)) - T[:3, 3]) @ T[:3, :3]
    seen = cv2.projectPoints(points, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], K, np.array(lens) if lens else None)[0][
        :, 0
    ]
    size = camera.size
    for _ in range(degrees // 90):
        seen, size = np.stack([seen[:, 1], size[0] - 1 - seen[:, 0]], axis=1), size[::-1]
    other = turned(camera, degrees)
    np.testing.assert_allclose(other.project(points)[0], seen, atol=1e-8)
    assert other.size == size and len(other.distortion) == len(lens)
    np.testing.assert_allclose(turned(other, 360 - degrees).K, K)


def test_cameras_that_cannot_be_turned_are_refused():
    K = np.array([[900.0, 0, 700], [0, 910, 350], [0, 0, 1]])
    tilted = Camera(name="a", K=K, T_camera_world=np.eye(4), size=(1280, 720), distortion=np.full(14, 0.01))
    with pytest.raises(ValueError, match="a distortion must tilt about one axis where its picture is turned"):
        turned(tilted, 90)
    assert turned(tilted, 0) is tilted
    with pytest.raises(ValueError, match="a turn must be 0, 90, 180 or 270 degrees; got 45"):
        turned(tilted, 45)
    skewed = Camera(name="a", K=K + np.eye(3, k=1) * [0, 1, 0], T_camera_world=np.eye(4), size=(1280, 720))
    with pytest.raises(ValueError, match="a intrinsic must have no skew where its picture is turned"):
        turned(skewed, 180)


def test_file_of_depthai_and_other_units_are_read(tmp_path):
    handler = oak()
    handler.eepromToJsonFile(tmp_path / "eeprom.json")
    held = json.loads((tmp_path / "eeprom.json").read_text())
    wanted = eeprom_cameras(device(), handler.eepromToJson())
    metres, unnamed = json.loads(json.dumps(held)), json.loads(json.dumps(held))
    for _, entry in metres["cameraData"]:
        entry["extrinsics"]["lengthUnit"] = dai.LengthUnit.METER.value
        entry["extrinsics"]["translation"] = {k: 0.01 * v for k, v in entry["extrinsics"]["translation"].items()}
    for _, entry in unnamed["cameraData"]:
        entry["extrinsics"].pop("lengthUnit", None)  # older files: centimetres
    for read in (held, metres, unnamed):
        for camera, other in zip(eeprom_cameras(device(), read), wanted, strict=True):
            np.testing.assert_allclose(camera.T_camera_world, other.T_camera_world, atol=1e-7)
            np.testing.assert_allclose(camera.K, other.K, atol=1e-3)


def test_calibration_that_is_missing_or_damaged_is_one_sentence():
    held = oak().eepromToJson()
    streams = (StreamSpec(stream="colour", socket="CAM_D", size=(1280, 800)),)
    with pytest.raises(ValueError, match="cam0001 EEPROM must hold a calibration of CAM_D"):
        eeprom_cameras(device(streams=streams), held)
    with pytest.raises(ValueError, match=r"cam0001 EEPROM must be as dai\.CalibrationHandler writes it; got KeyError"):
        eeprom_cameras(device(), {})
    fisheye = oak()
    fisheye.setCameraType(socket("CAM_B"), dai.CameraModel.Fisheye)
    with pytest.raises(ValueError, match=r"cam0001 EEPROM must be .* cameraType must be 0, a perspective lens; got 1"):
        eeprom_cameras(device(), fisheye.eepromToJson())
    for _, entry in held["cameraData"]:
        entry["extrinsics"]["toCameraSocket"] = -1
    with pytest.raises(ValueError, match=r"cam0001\.left EEPROM must link CAM_B to CAM_A; got no way between them"):
        eeprom_cameras(device(), held)
