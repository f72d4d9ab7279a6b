"""Pictures of a recording: what each camera sees of the body, the nozzle and the lines, before sensor and noise."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.sparse import csr_matrix

from recon.cameras import Camera
from recon.rig.bake import Baked
from recon.rig.light import irradiance, normals
from recon.rig.props import Mesh, line, nozzle, reflectance, together
from recon.rig.raster import rasterise
from recon.rig.replay import Replay

SMOOTH = 400  # width [px] from which the skin is cut finer
LENS_END = 1.12  # of the picture's farthest corner: what lies further out is not drawn
TAUT = 0.05  # [N], a line that is pulled less hangs out of sight


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """One picture without its backdrop: a window of the camera's picture, premultiplied colour and coverages."""

    column: int
    row: int
    colour: np.ndarray  # (h, w, 3) float32, linear RGB, black where nothing is
    cover: np.ndarray  # (h, w) float32 in 0..1, of everything on the stage
    matte: np.ndarray  # (h, w) float32 in 0..1, of what is seen of the object

    def over(self, picture: np.ndarray) -> np.ndarray:
        """The window of a backdrop (H, W, 3) with this in front."""
        height, width = self.cover.shape
        behind = picture[self.row : self.row + height, self.column : self.column + width]
        return behind * (1 - self.cover[..., None]) + self.colour


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """Everything on the stage in one frame."""

    skin: np.ndarray  # (V, 3) [m] the object's
    light: np.ndarray  # (V, 3) that falls on it
    props: Mesh


class Film:
    """A recording's pictures; what is common to all cameras in a frame is computed once and kept."""

    def __init__(self, shape: str, replay: Replay, width: int) -> None:
        self.replay = replay
        body = replay.motion.body
        cuts, fine = (4, 24) if width >= SMOOTH else (2, 12)
        self._weights, self._triangles = body.skin(cuts)
        self._texture = Baked.of(shape, body, cuts, fine)
        self._moments: dict[int, Moment] = {}

    def moment(self, frame: int) -> Moment:
        """The stage in one frame."""
        if frame not in self._moments:
            self._moments[frame] = self._made(frame)
        return self._moments[frame]

    def view(self, camera: Camera, frame: int, fineness: int) -> View | None:
        """What a camera on the stage sees with fineness^2 samples a pixel; None where the stage is out of its sight."""
        now = self.moment(frame)
        points = np.concatenate([now.skin, now.props.points])
        count = len(now.skin)
        pixels, depth = _within(camera, points)
        window = _window(pixels, camera.size)
        if window is None:
            return None
        column, row, width, height = window
        samples = (pixels - [column, row] + 0.5) * fineness - 0.5
        front = _towards(pixels, self._triangles)  # the body is closed: its back is never seen
        triangles = np.concatenate([self._triangles[front], now.props.triangles + count])
        seen = rasterise(samples, depth, triangles, (width * fineness, height * fineness))
        corners, weights = seen.corners(triangles)
        number = seen.triangle[seen.hit]
        own = number < len(front)
        colour = np.zeros((*seen.hit.shape, 3), np.float32)
        values = np.empty((len(corners), 3), np.float32)
        values[own] = self._skin(now, front[number[own]], corners[own], weights[own].astype(np.float32))
        values[~own] = _props(now.props, corners[~own] - count, weights[~own])
        colour[seen.hit] = values
        shown = seen.hit.astype(np.float32), (seen.hit & (seen.triangle < len(front))).astype(np.float32)
        colour, cover, matte = (_small(a, (width, height)) for a in (colour, *shown))
        return View(column=column, row=row, colour=colour, cover=cover, matte=matte)

    def _skin(self, now: Moment, number: np.ndarray, corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
        light = sum(now.light[corners[:, i]] * weights[:, [i]] for i in range(3))
        return self._texture(number, weights[:, 1], weights[:, 2]) * light

    def _made(self, frame: int) -> Moment:
        replay, body = self.replay, self.replay.motion.body
        nodes = replay.nodes(frame)
        skin = body.surface
        light = np.zeros((len(nodes), 3), np.float32)
        facing = normals(nodes, body.triangles)
        light[skin] = irradiance(nodes[skin], facing[skin], nodes, body.triangles)
        return Moment(
            skin=(self._weights @ nodes).astype(np.float32),
            light=_floored(self._weights, light),
            props=together([nozzle(replay.T_stage_marker(frame)), *_taut(replay, nodes, frame)]),
        )


def _floored(weights: csr_matrix, light: np.ndarray) -> np.ndarray:
    return np.maximum(weights @ light, 0.0).astype(np.float32)


def _taut(replay: Replay, nodes: np.ndarray, frame: int) -> list[Mesh]:
    """The lines that are pulled in this frame."""
    motion = replay.motion
    pulled = np.linalg.norm(replay.lines(frame), axis=1)
    return [
        line(nodes[knot].mean(axis=0), anchor)
        for knot, anchor in zip(motion.knots, motion.anchors, strict=True)
        if pulled[knot].sum() > TAUT * motion.tension.max()
    ]


def _props(props: Mesh, corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
    light = np.einsum("mkj,mk->mj", props.light[corners], weights)
    return reflectance(props, corners, weights)[:, None] * light


def _within(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (V, 2) and depth (V,), NaN pixels beyond the lens: its polynomial folds back far outside the picture."""
    corners = camera.rays(np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) * (np.array(camera.size) - 1))
    cosine = (corners @ camera.axis).min()
    end = LENS_END * np.sqrt(1 / cosine**2 - 1)
    local = points @ camera.T_camera_world[:3, :3].T + camera.T_camera_world[:3, 3]
    pixels, depth = camera.project(points)
    pixels[np.hypot(local[:, 0], local[:, 1]) > end * local[:, 2]] = np.nan
    return pixels, depth


def _towards(pixels: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The triangles that turn their outer side to the camera, by number: counter-clockwise, but y points down."""
    a, b, c = (pixels[triangles[:, i]] for i in range(3))
    first, second = b - a, c - a
    return np.flatnonzero(first[:, 0] * second[:, 1] < first[:, 1] * second[:, 0])


def _window(pixels: np.ndarray, size: tuple[int, int]) -> tuple[int, int, int, int] | None:
    """Column, row, width and height of the part of a picture that holds all pixels (V, 2), None if that is nothing."""
    seen = pixels[np.isfinite(pixels).all(axis=1)]
    if len(seen) == 0:
        return None
    low = np.maximum(np.floor(seen.min(axis=0)).astype(int) - 1, 0)
    high = np.minimum(np.ceil(seen.max(axis=0)).astype(int) + 2, size)
    return (*low.tolist(), *(high - low).tolist()) if (high > low).all() else None


def _small(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)
