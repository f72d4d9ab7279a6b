"""Causes in the measurement: the object did as simulated, tracking shows something else."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from veo_ti.diagnosis.causes.base import Carried, Cause, Change, Parameter
from veo_ti.diagnosis.causes.courses import Course, turned
from veo_ti.diagnosis.causes.loads import Growing
from veo_ti.diagnosis.causes.ways import ALL_AROUND, Way, in_words
from veo_ti.diagnosis.scene import Scene

_KNOCKS = 12  # moments that are scanned for one at which a camera was knocked at;
_UNKNOCKED = 1 / 8  # of all frames, that are before and after it: what is there all the time is another thing
_TURN = np.deg2rad(25)  # of the way in which slip grows, half a step on


class CameraScale(Growing):
    """y_seen = c + (1 + s w)(y - c) about any point c, `y + w (s (y - middle) + d)`, w one after the reference frame or
    t / T, as of a lens that warms up."""

    name = "camera_scale"
    sentence = "The cameras' scale changed after the reference frame."
    exact = True
    parameters = (
        Parameter(name="scale", unit="-", sd=0.01),
        *(Parameter(name=f"shift_{a}", unit="m", sd=1e-3) for a in "xyz"),
    )

    def widths(self, scene: Scene) -> np.ndarray:
        """A hundredth; of a scale about a point as far from the middle as the object is long."""
        return 0.01 * np.array([1.0, *[scene.extent] * 3])

    def change(self, scene: Scene, theta: np.ndarray, place: str) -> Change:
        """Everything grows about the middle of the rest shape, and shifts: nobody knows about which point it grew."""
        middle, w = scene.cloud.x.mean(axis=0), self.grown(scene, place)
        return Change(observe=lambda y, frames: y + w[frames] * (theta[0] * (y - middle) + theta[1:]))


class CameraPose(Cause):
    """y_seen = y + R(w) (y - c) - (y - c) + d from a frame on, c the middle of the rest shape."""

    name = "camera_pose"
    sentence = "From some moment on the cameras stand otherwise: everything is seen turned and shifted."
    exact = True
    over_time = "since when"
    parameters = (
        *(Parameter(name=f"turn_{a}", unit="rad", sd=0.02) for a in "xyz"),
        *(Parameter(name=f"shift_{a}", unit="m", sd=3e-3) for a in "xyz"),
    )

    def places(self, scene: Scene) -> Sequence[int]:
        """Frames, evenly."""
        every = self._every(scene)
        return [every[i] for i in np.unique(np.linspace(0, len(every) - 1, _KNOCKS).astype(int))]

    def near(self, scene: Scene, place: int) -> Sequence[int]:
        """Frames in between."""
        return [t for t in self._every(scene) if 0 < abs(t - place) <= len(scene.time) // _KNOCKS]

    @staticmethod
    def _every(scene: Scene) -> range:
        least = 1 + int(_UNKNOCKED * len(scene.time))
        return range(least, max(least, len(scene.time) - least) + 1)

    def change(self, scene: Scene, theta: np.ndarray, place: int) -> Change:
        """Rigidly."""
        middle, turn = scene.cloud.x.mean(axis=0), Rotation.from_rotvec(theta[:3]).as_matrix() - np.eye(3)
        late = (np.arange(len(scene.time)) >= place)[:, None, None]
        return Change(observe=lambda y, frames: y + late[frames] * ((y - middle) @ turn.T + theta[3:]))

    def describe(self, scene: Scene, place: int) -> str:
        """Since when."""
        return f"from frame {place} on"


class CorrespondenceSlip(Cause):
    """y_seen = y - c s (I - n n^T)(y - x), s one everywhere, or from 0 to 2 along some way through the object."""

    name = "correspondence_slip"
    sentence = "Tracked points slide back along the surface: motion across the view is under-reported."
    parameters = (Parameter(name="share", unit="-", sd=0.1),)

    def places(self, scene: Scene) -> Sequence[Way | None]:
        """Everywhere alike, or more and more along a way, as where one side shows less texture."""
        return (None, *ALL_AROUND)

    def courses(self, scene: Scene, place: Way | None) -> Sequence[Course]:
        """Of ways."""
        return () if place is None else turned(place, _TURN)

    def change(self, scene: Scene, theta: np.ndarray, place: Way | None) -> Change:
        """The tangential part of the displacement is reported too small."""
        normals, share = _unit(_turned(scene)), theta[0] * self._where(scene, place)

        def observe(y: np.ndarray, frames: np.ndarray) -> np.ndarray:
            return y - share * _along(y - scene.cloud.x, normals[frames])

        return Change(observe=observe)

    def carried(self, scene: Scene, theta: np.ndarray, place: Way | None) -> Carried:
        """Of a change of motion, too, the tangential part is reported too small; and with it the surface turns."""
        a, share = _turned(scene), theta[0] * self._where(scene, place)
        size = np.maximum(np.linalg.norm(a, axis=2, keepdims=True), 1e-300)
        normals, inverse, u = _unit(a), np.linalg.inv(scene.F), scene.y - scene.cloud.x

        def further(motion: np.ndarray, frames: np.ndarray, change: np.ndarray) -> np.ndarray:
            n, moved = normals[frames], u[frames]
            moving = -np.einsum(
                "tnba,tncb,tnc->tna", inverse[frames], scene.cloud.deformation_gradient(motion), a[frames],
                optimize=True,
            ) / size[frames]  # fmt: skip
            moving = _along(moving, n) * n.any(axis=2, keepdims=True)
            return -share * (_along(motion, n) - _dot(moved, moving) * n - _dot(moved, n) * moving)

        return further

    @staticmethod
    def _where(scene: Scene, place: Way | None) -> np.ndarray:
        """How much of the share each point slips by, (N, 1)."""
        along = scene.cloud.x @ (np.zeros(3) if place is None else np.array(place))
        return np.ones((len(along), 1)) if place is None else 2 * (along - along.min())[:, None] / np.ptp(along)

    def describe(self, scene: Scene, place: Way | None) -> str:
        """Where."""
        return "" if place is None else f"more and more towards {in_words(place)}"


class TemporalSmoothing(Cause):
    """y_seen = exp(v / 2 d2/dt2) y, or y + v / 2 y'' to first order: through a Gaussian window of the variance v."""

    name = "temporal_smoothing"
    sentence = "Tracking smooths over time: it shows fast motion slower and smaller than it was, before it happens too."
    parameters = (Parameter(name="variance", unit="s2", sd=1e-3, positive=True),)
    over_time = "a motion"

    def widths(self, scene: Scene) -> np.ndarray:
        """A window as wide as a frame."""
        return np.array([scene.interval**2])

    def change(self, scene: Scene, theta: np.ndarray, place: Any) -> Change:
        """By frames; what is seen starts from the reference pose, as it is seen."""
        added = self._added(scene, theta, scene.y - scene.cloud.x)
        return Change(observe=lambda y, frames: y + added[frames])

    def carried(self, scene: Scene, theta: np.ndarray, place: Any) -> Carried:
        """A change of motion is smoothed, too."""
        return lambda motion, frames, change: self._added(scene, theta, motion)

    def _added(self, scene: Scene, theta: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """What smoothing adds to a motion (n, N, 3) of the first n frames; nothing flows over its ends."""
        n, window = len(motion), theta[0] / self.widths(scene)[0]
        apart = np.diff(np.eye(n), axis=0)
        added = np.tensordot(expm(-window / 2 * apart.T @ apart) - np.eye(n), motion, axes=1)
        return added - added[:1]


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(axis=2, keepdims=True)


def _along(v: np.ndarray, n: np.ndarray) -> np.ndarray:
    """The part of v along the surface with unit normals n."""
    return v - _dot(v, n) * n


def _turned(scene: Scene) -> np.ndarray:
    """The rest shape's normals as the simulated surface turns them, not of unit length (T, N, 3): `F^-T n`."""
    return np.einsum("tnba,nb->tna", np.linalg.inv(scene.F), scene.cloud.normals)


def _unit(v: np.ndarray) -> np.ndarray:
    """Unit vectors along v (T, N, 3), zero where it is."""
    size = np.linalg.norm(v, axis=2, keepdims=True)
    return np.divide(v, size, out=np.zeros_like(v), where=size > 0)
