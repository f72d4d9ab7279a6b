"""Two things that nobody filmed: a push from the side, and a ball pressed on the top, simulated and filmed."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from recon.cameras import UP, Camera, look_at
from recon.images import shown
from sim.terms.contact import Contact, contact_alpha
from sim.terms.shapes import Sphere
from veo_ti.object import VirtualElasticObject
from veo_ti.reconstruction.collider import collider_picture
from veo_ti.reconstruction.rerender import Rerenderer
from veo_ti.view import write_film

STEPS = 10  # states of each film, there; and back the same way
_SIDE, _FPS = 192, 15  # [px], [1/s]
_PRESSED, _PUSHED = 0.12, 0.1  # of the object's height, how far the ball goes down, and about how far the top is pushed
_BALL = 0.15  # of the object's height, the ball's radius
_BALL_COLOUR = (0.2, 0.45, 0.85)


def film_novel(obj: VirtualElasticObject, renderer: Rerenderer, out: Path) -> dict[str, object]:
    """push.mp4 and ball.mp4 into out; what was done and how it ended."""
    camera = _camera(obj.x)
    height = float(np.ptp(obj.x[:, 1]))
    top = obj.x[np.argmax(np.where(obj.surface, obj.x[:, 1], -np.inf))]
    ramp = np.linspace(0, 1, STEPS + 1)
    force = _push_force(obj, top, _PUSHED * height, 0.15 * height)
    pushed = obj.simulate(obj.push_at(top, ramp[:, None] * force, 0.15 * height), frames=len(ramp), gradual=True)
    write_film(
        (shown(renderer.picture(y, camera).colour) for y in _there_and_back(pushed.y)),
        camera.size, out / "push.mp4", _FPS,
    )
    ball, start = Sphere(radius=_BALL * height), top + (_BALL * height + 0.02 * height) * UP
    way = start - ramp[:, None] * (_PRESSED + 0.02) * height * UP
    alpha = contact_alpha(float(np.median(obj.lame.mu)), obj.cloud.spacing)
    contact = Contact(shape=ball, volume=obj.cloud.volume, alpha=alpha, position=way)
    pressed = obj.simulate(contact, frames=len(ramp), gradual=True)

    def pictures() -> Iterator[np.ndarray]:
        for y, place in zip(_there_and_back(pressed.y), _there_and_back(way), strict=True):
            yield shown(renderer.picture(y, camera, collider_picture(ball, place, camera, _BALL_COLOUR)).colour)

    write_film(pictures(), camera.size, out / "ball.mp4", _FPS)
    moved = {name: 1e3 * float(np.linalg.norm(e.y[-1] - obj.x, axis=1).max())
             for name, e in (("push", pushed), ("ball", pressed))}  # fmt: skip
    return {
        "push": {"force": force.tolist(), "status": pushed.sentence, "largest_displacement_mm": moved["push"]},
        "ball": {"radius_mm": 1e3 * ball.radius, "status": pressed.sentence, "largest_displacement_mm": moved["ball"]},
    }


def _push_force(obj: VirtualElasticObject, place: np.ndarray, goal: float, radius: float) -> np.ndarray:
    """A sideways force (3,) that moves the place by about `goal` [m]: in proportion to a small one's effect."""
    little = float(np.median(obj.lame.mu)) * radius**2 * 1e-3 * np.array([1.0, 0, 0])
    moved = np.linalg.norm(obj.simulate(obj.push_at(place, little[None], radius)).y[0] - obj.x, axis=1).max()
    return little * goal / max(float(moved), 1e-12)


def _camera(x: np.ndarray) -> Camera:
    """From the front, a little above, the object filling half of the picture."""
    middle, size = (x.min(axis=0) + x.max(axis=0)) / 2, float(np.ptp(x, axis=0).max())
    eye = middle + size * np.array([0.9, 0.7, 2.6])
    focal = 0.55 * _SIDE * np.linalg.norm(eye - middle) / size
    K = np.array([[focal, 0, _SIDE / 2], [0, focal, _SIDE / 2], [0, 0, 1]])
    return Camera(name="novel", K=K, T_camera_world=look_at(eye, middle, UP), size=(_SIDE, _SIDE))


def _there_and_back(states: np.ndarray) -> np.ndarray:
    return np.concatenate([states, states[-2::-1]])
