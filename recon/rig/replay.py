"""A stored motion as a recording: as many frames as wanted, quasi-static or ringing, with its forces and nozzle."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import eigh

from recon.plush.reconstruction import MM, NOZZLE_IN_MARKER, STREAM_IN_MARKER
from recon.rig.jet import Stream, stream_forces
from recon.rig.motion import Motion
from recon.rig.stage import FPS

DAMPING = 0.03  # share of the critical one, of every mode
SUBSTEPS = 32


@dataclass(frozen=True, kw_only=True, eq=False)
class Replay:
    """Frame by frame, on the stage; which stored frame each one shows is `at`, a fraction where there are more."""

    motion: Motion
    at: np.ndarray  # (F,)
    course: np.ndarray  # (F, R)

    @classmethod
    def of(cls, motion: Motion, frames: int, *, inertia: bool = False) -> "Replay":
        """So many frames, evenly: chosen among the stored ones while there are enough, between them otherwise.

        A chosen frame is in balance with its forces; one in between is so up to the second order of the step.
        """
        at = np.linspace(0, motion.frames - 1, frames)
        at = np.round(at) if frames <= motion.frames else at
        course = along(motion.course, at)
        return cls(motion=motion, at=at, course=ringing(motion, course) if inertia else course)

    def nodes(self, frame: int) -> np.ndarray:
        """The body's nodes, (N, 3) [m]."""
        return self.motion.body.nodes + np.tensordot(self.course[frame], self.motion.modes, axes=1)

    def stream(self, frame: int) -> Stream:
        """The air stream."""
        position, way = (along(a, self.at[[frame]])[0] for a in (self.motion.position, self.motion.direction))
        motion = self.motion
        return Stream(
            position=position, direction=way / np.linalg.norm(way), force=motion.force, footprint=motion.footprint
        )

    def T_stage_marker(self, frame: int) -> np.ndarray:
        """The marker's pose (4, 4) [m]: the stream starts 105 mm along its y and blows along -z; y points down."""
        stream = self.stream(frame)
        z = -stream.direction
        x = np.cross([0.0, 0.0, -1.0], z)
        x /= np.linalg.norm(x)
        R = np.stack([x, np.cross(z, x), z], axis=1)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, stream.position - R @ (MM * NOZZLE_IN_MARKER)
        return T

    def jet(self, frame: int) -> np.ndarray:
        """Forces (N, 3) [N] of the stream on the nodes, lumped."""
        body, nodes = self.motion.body, self.nodes(frame)
        points, area = body.skin_points(nodes)
        return body.lumped @ stream_forces(self.stream(frame), points, area, nodes, body.triangles)

    def lines(self, frame: int) -> np.ndarray:
        """Forces (N, 3) [N] of the lines on the nodes."""
        nodes = self.nodes(frame)
        out, tension = np.zeros_like(nodes), along(self.motion.tension, self.at[[frame]])[0]
        for knot, anchor, strength in zip(self.motion.knots, self.motion.anchors, tension, strict=True):
            way = anchor - nodes[knot].mean(axis=0)
            out[knot] += strength / len(knot) * way / np.linalg.norm(way)
        return out


def along(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values (T, ...) at fractional frames (F,)."""
    first = np.clip(np.floor(at).astype(int), 0, len(values) - 2)
    share = (at - first).reshape(-1, *[1] * (values.ndim - 1))
    return (1 - share) * values[first] + share * values[first + 1]


def stream_of(T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the stream starts (..., 3) [m] and blows (..., 3) for marker poses (..., 4, 4)."""
    R = T[..., :3, :3]
    return T[..., :3, 3] + R @ (MM * NOZZLE_IN_MARKER), R @ STREAM_IN_MARKER


def ringing(motion: Motion, course: np.ndarray) -> np.ndarray:
    """The course (F, R) of a body with mass, driven by the same loads at the recording's frame rate.

    In the span of the stored modes, at the stiffness of the rest shape: `q'' + 2 c w q' + w^2 (q - s) = 0` for each
    of its vibrations, s(t) being the quasi-static course; Newmark's trapezoidal rule.
    """
    squares, shapes = eigh(motion.stiffness, motion.mass)
    w = np.sqrt(np.maximum(squares, 0.0))
    goal = np.linalg.solve(shapes, course.T).T
    h, q, v = 1 / FPS / SUBSTEPS, goal[0].copy(), np.zeros(len(w))
    out = [q]
    for start, end in pairwise(goal):
        for step in range(1, SUBSTEPS + 1):
            before, after = (start + (step + k) / SUBSTEPS * (end - start) for k in (-1, 0))
            a = w**2 * (before - q) - 2 * DAMPING * w * v
            # Unknown at the step's end: its acceleration, on which place and speed there depend linearly.
            rest, speed = q + h * v + h**2 / 4 * a, v + h / 2 * a
            b = (w**2 * (after - rest) - 2 * DAMPING * w * speed) / (1 + DAMPING * w * h + w**2 * h**2 / 4)
            q, v = rest + h**2 / 4 * b, speed + h / 2 * b
        out.append(q)
    return np.stack(out) @ shapes.T
