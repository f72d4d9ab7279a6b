"""Hidden effects that are in no catalogue, and that a rig may well have: what nobody looks for beside a jet."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from blind import of_loads
from blind.hidden import Hidden, sign, unit
from blind.jets import Shot
from blind.laws import AtOnce, Stress, geometric, green, wide
from blind.scenes import Model, Observe, Scene


class Lopsided(AtOnce):
    """psi = c/3 (tr E)^3: stiffer where it is pressed, softer where it is pulled, or the other way round."""

    def __init__(self, c: np.ndarray) -> None:
        self.c = c  # (E, Q) [Pa]

    def stress(self, F: np.ndarray, t: float) -> Stress:
        """psi and P."""
        trace = np.trace(green(F), axis1=-2, axis2=-1)
        return self.c / 3 * trace**3, wide(self.c * trace**2, 2) * F

    def tangent(self, F: np.ndarray, t: float) -> np.ndarray:
        """A."""
        trace = np.trace(green(F), axis1=-2, axis2=-1)
        FF = F[..., :, :, None, None] * F[..., None, None, :, :]
        return wide(2 * self.c * trace, 4) * FF + geometric(wide(self.c * trace**2, 2) * np.eye(3))

    def after(self, F: np.ndarray, t: float) -> "Lopsided":
        """Itself."""
        return self


def lopsided(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A foam whose cells buckle."""
    way, size = sign(rng), max(scene.strain, 1e-3) ** 0.5
    return Hidden(
        name="lopsided", start=0.5 / size, most=4 / size, goal=(6.0, 40.0), details={"sign": way},
        change=lambda model, a: model.with_part(Lopsided(way * a * scene.mu)),
    )  # fmt: skip


def throttled_sweep(rng: np.random.Generator, scene: Scene) -> Hidden:
    """One sweep of the jet is weaker, or stronger, than it was said to be."""
    shown = [sweep for sweep in scene.program.sweeps if sweep.begin < scene.time[-1] - scene.interval]
    way, which = sign(rng), shown[int(rng.integers(len(shown)))]

    def change(model: Model, share: float) -> Model:
        before = model.shot

        def shot(t: float) -> Shot:
            factor = 1 + way * share if which.begin <= t < which.begin + which.length else 1.0
            return replace(before(t), pressure=factor * before(t).pressure)

        return replace(model, shot=shot)

    return Hidden(name="load_case", start=0.2, most=0.7, change=change, details={"sign": way})


def wide_footprint(rng: np.random.Generator, scene: Scene) -> Hidden:
    """The jet is wider, or narrower, than it was said to be, at the same force on a wall."""
    way = sign(rng)

    def change(model: Model, share: float) -> Model:
        factor = (1 + share) ** way
        return of_loads.reshot(
            model, lambda s: replace(s, footprint=factor * s.footprint, pressure=s.pressure / factor**2)
        )

    return Hidden(name="wide_footprint", start=0.2, most=1.0, change=change, details={"sign": way})


def smoothing(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Tracking smooths over time: each frame is a Gaussian mean of those around it; the amount is in frames."""

    def view(width: float) -> Observe:
        def show(y: np.ndarray, scene: Scene, model: Model) -> np.ndarray:
            if width == 0:
                return y
            apart = np.subtract.outer(np.arange(len(y)), np.arange(len(y)))
            K = np.exp(-(apart**2) / (2 * width**2))
            K /= K.sum(axis=1, keepdims=True)
            smooth = np.einsum("ts,snc->tnc", K, y - y[0])
            return y[0] + smooth - smooth[0]

        return show

    return Hidden(name="temporal_smoothing", start=0.7, most=2.0, change=lambda model, w: model.with_view(view(w)))


def knocked_camera(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Somebody knocks against the camera: from then on everything is turned and shifted a little."""
    axis, way, since = unit(rng), unit(rng), int(rng.integers(4, len(scene.time) - 4)) if len(scene.time) > 9 else 2
    middle = scene.built.body.nodes.mean(axis=0)

    def view(angle: float) -> Observe:
        def show(y: np.ndarray, scene: Scene, model: Model) -> np.ndarray:
            d = y - middle
            turned = Rotation.from_rotvec(angle * axis).apply(d.reshape(-1, 3)).reshape(d.shape)
            late = (np.arange(len(y)) >= since)[:, None, None]
            return y + late * (turned - d + angle * scene.built.size / 4 * way)

        return show

    return Hidden(
        name="knocked_camera", start=0.01, most=0.1, change=lambda model, a: model.with_view(view(a)),
        details={"axis": axis.tolist(), "since": since},
    )  # fmt: skip


DRAWS = (lopsided, throttled_sweep, wide_footprint, smoothing, knocked_camera)
