"""Pictures of a collider, by sphere tracing of its signed distance: what stands beside the object in a rendering."""

import numpy as np

from recon.cameras import Camera
from recon.radiance.rendering import Picture
from sim.terms.shapes import Shape

_STEPS = 64
_NEAR = 1e-4  # [m], where the surface counts as met
_FAR = 20.0  # [m]
_LIGHT = np.array([0.3, 0.9, 0.3]) / np.sqrt(0.99)


def collider_picture(shape: Shape, position: np.ndarray, camera: Camera, colour: tuple[float, float, float]) -> Picture:
    """A shape at `position` (3,) [m] as a camera sees it, lit from above, in one colour, 0 to 1."""
    rays = camera.rays(camera.grid()).reshape(-1, 3)
    away, met = np.zeros(len(rays)), np.zeros(len(rays), bool)
    for _ in range(_STEPS):
        active = np.flatnonzero(~met & (away < _FAR))
        if not len(active):
            break
        d = shape.distance(camera.centre + away[active, None] * rays[active] - position).d
        away[active] += np.maximum(d, 0)
        met[active] = d < _NEAR
    hit = np.flatnonzero(met)
    shade = np.zeros(len(rays))
    if len(hit):
        normal = shape.distance(camera.centre + away[hit, None] * rays[hit] - position).normal
        shade[hit] = 0.35 + 0.65 * np.clip(normal @ _LIGHT, 0, 1)
    size = camera.size[::-1]
    return Picture(
        colour=(shade[:, None] * np.array(colour)).reshape(*size, 3), opacity=met.astype(float).reshape(size),
        depth=np.where(met, away, np.inf).reshape(size),
    )  # fmt: skip
