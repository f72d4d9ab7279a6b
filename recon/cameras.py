"""A calibrated camera in OpenCV's model: where it stands, and how points and pixels belong together."""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from sim.checks import as_array, require

STREAMS = ("colour", "left", "right")
ROLES = ("train", "test", "nozzle")
_LENGTHS = (0, 4, 5, 8, 12, 14)  # numbers of distortion coefficients that OpenCV knows
_ORTHONORMAL = 1e-4
UP = np.array([0, 1.0, 0])  # of a reconstruction's axes, which are the PLUSH dataset's
_CLOSE = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 60, 1e-12)  # OpenCV's own five steps leave whole pixels


@dataclass(frozen=True, kw_only=True, eq=False)
class Camera:
    """A camera: x right, y down, z forward, `T_camera_world @ p_world = p_camera`; a pixel's index is its centre.

    distortion: OpenCV's k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty, as many as are known. stream: which of a device's
    sensors; role: whether its pictures teach, judge, or only show the nozzle.
    Raises ValueError for anything that is no camera, naming it.
    """

    name: str
    K: np.ndarray  # (3, 3) [px]
    T_camera_world: np.ndarray  # (4, 4) [m]
    size: tuple[int, int]  # width, height [px]
    distortion: np.ndarray = field(default_factory=lambda: np.zeros(0))
    stream: str = "colour"
    role: str = "train"

    def __post_init__(self) -> None:
        K = as_array(f"{self.name} intrinsic", self.K, (3, 3))
        pinhole = K[0, 0] > 0 and K[1, 1] > 0 and not K[1, 0] and not K[2, :2].any() and K[2, 2] == 1
        require(bool(pinhole), f"{self.name} intrinsic", "be [[fx, s, cx], [0, fy, cy], [0, 0, 1]]", K.tolist())
        T = as_array(f"{self.name} extrinsic", self.T_camera_world, (4, 4))
        R = T[:3, :3]
        rigid = np.abs(R @ R.T - np.eye(3)).max() < _ORTHONORMAL and np.linalg.det(R) > 0
        rigid = rigid and np.allclose(T[3], [0, 0, 0, 1])
        require(bool(rigid), f"{self.name} extrinsic", "hold a rotation and a shift", T.tolist())
        d = as_array(f"{self.name} distortion", np.ravel(self.distortion), (None,))
        require(len(d) in _LENGTHS, f"{self.name} distortion", f"have one of {_LENGTHS} numbers", len(d))
        require(len(self.size) == 2 and min(self.size) > 0, f"{self.name} size", "be a width and a height", self.size)
        require(self.stream in STREAMS, f"{self.name} stream", f"be one of {STREAMS}", self.stream)
        require(self.role in ROLES, f"{self.name} role", f"be one of {ROLES}", self.role)
        for name, value in (("K", K), ("T_camera_world", T), ("distortion", d)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "size", (int(self.size[0]), int(self.size[1])))

    @property
    def centre(self) -> np.ndarray:
        """Where it stands, (3,) [m]."""
        return -self.T_camera_world[:3, :3].T @ self.T_camera_world[:3, 3]

    @property
    def axis(self) -> np.ndarray:
        """Where it looks, a unit vector (3,)."""
        return self.T_camera_world[2, :3].copy()

    @property
    def device(self) -> str:
        """The device that it is a sensor of: cam0001 for cam0001.left."""
        return self.name.split(".")[0]

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (..., 2) of points (..., 3) [m], and their depth (...) [m]; NaN pixels for what is not in front."""
        points = np.asarray(points, float)
        local = points.reshape(-1, 3) @ self.T_camera_world[:3, :3].T + self.T_camera_world[:3, 3]
        ahead = local[:, 2] > 0
        pixels = np.full((len(local), 2), np.nan)
        if not self.distortion.any():
            pixels[ahead] = local[ahead, :2] / local[ahead, 2:] * np.diagonal(self.K)[:2] + self.K[:2, 2]
        elif ahead.any():
            zero = np.zeros(3)
            pixels[ahead] = cv2.projectPoints(local[ahead, None], zero, zero, self.K, self._coefficients)[0][:, 0]
        return pixels.reshape(*points.shape[:-1], 2), local[:, 2].reshape(points.shape[:-1])

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Unit directions (..., 3) in the world from the camera's centre through pixels (..., 2)."""
        pixels = np.asarray(pixels, float)
        flat = np.ascontiguousarray(pixels.reshape(-1, 1, 2))
        if len(flat) == 0:
            return np.zeros((*pixels.shape[:-1], 3))
        plane = cv2.undistortPoints(flat, self.K, self._coefficients, criteria=_CLOSE)[:, 0]
        local = np.concatenate([plane, np.ones((len(plane), 1))], axis=1)
        local /= np.linalg.norm(local, axis=1, keepdims=True)
        return (local @ self.T_camera_world[:3, :3]).reshape(*pixels.shape[:-1], 3)

    def grid(self) -> np.ndarray:
        """Every pixel, (height, width, 2) as (column, row)."""
        width, height = self.size
        return np.stack(np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float)), axis=-1)

    def undistorted(self) -> "Camera":
        """The same camera behind a perfect lens."""
        return replace(self, distortion=np.zeros(0))

    def cropped(self, column: float, row: float, size: tuple[int, int]) -> "Camera":
        """The part of the picture that begins at pixel (column, row); it may reach beyond the sensor."""
        shift = np.array([[1, 0, -column], [0, 1, -row], [0, 0, 1.0]])
        return replace(self, K=shift @ self.K, size=size)

    def resized(self, size: tuple[int, int]) -> "Camera":
        """The same picture in another number of pixels; the corners stay where they are, half a pixel outside."""
        sx, sy = size[0] / self.size[0], size[1] / self.size[1]
        scale = np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1.0]])
        return replace(self, K=scale @ self.K, size=size)

    @property
    def _coefficients(self) -> np.ndarray | None:
        return self.distortion if len(self.distortion) else None


@dataclass(frozen=True, kw_only=True, eq=False)
class Resampling:
    """The same view seen by another sensor at the same place: pictures of `source` become pictures of `goal`.

    Where the goal has fewer pixels, each of its pixels is the mean over the `fineness^2` places it covers.
    """

    source: Camera
    goal: Camera
    fineness: int
    columns: np.ndarray
    rows: np.ndarray

    @classmethod
    def of(cls, source: Camera, goal: Camera) -> "Resampling":
        """The map, made once for all frames; goal must have no distortion and stand where the source does."""
        require(len(goal.distortion) == 0, f"{goal.name} goal", "have no distortion", goal.distortion.tolist())
        same = np.allclose(source.T_camera_world, goal.T_camera_world)
        require(same, f"{goal.name} goal", "stand where the source stands", "another pose")
        fineness = max(1, round(source.K[0, 0] / goal.K[0, 0]))
        fine = goal.resized((goal.size[0] * fineness, goal.size[1] * fineness))
        columns, rows = cv2.initUndistortRectifyMap(
            source.K, source._coefficients, None, fine.K, fine.size, cv2.CV_32FC1
        )
        return cls(source=source, goal=goal, fineness=fineness, columns=columns, rows=rows)

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """The picture (height, width[, C]) of the goal, zero outside the source's sensor, of the same dtype."""
        width, height = self.source.size
        fits = image.shape[:2] == (height, width)
        require(fits, f"{self.source.name} image", f"be {width} x {height} pixels", f"{image.shape[1::-1]}")
        fine = cv2.remap(image, self.columns, self.rows, cv2.INTER_LINEAR)
        return fine if self.fineness == 1 else cv2.resize(fine, self.goal.size, interpolation=cv2.INTER_AREA)


def look_at(eye: np.ndarray, target: np.ndarray, up: np.ndarray) -> np.ndarray:
    """T_camera_world (4, 4) of a camera at `eye` that looks at `target`, with `up` upwards in the picture."""
    forward = np.asarray(target, float) - eye
    right = np.cross(forward, up)
    rows = np.stack([right, np.cross(forward, right), forward])
    R = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, -R @ eye
    return T
