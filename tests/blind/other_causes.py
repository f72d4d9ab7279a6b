"""Hidden effects that a rig may well have and no other mix hides: all of them are causes of the toolkit since."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from blind import of_loads
from blind.hidden import Hidden, sign, unit
from blind.jets import Shot
from blind.laws import Derivatives, Isotropic
from blind.of_material import RAW
from blind.scenes import Model, Observe, Scene


def lopsided(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A foam whose cells buckle: psi += c/3 (tr E)^3, stiffer where pressed and softer where pulled, or the reverse."""
    way, size = sign(rng), max(scene.strain, 1e-3) ** 0.5

    def change(model: Model, a: float) -> Model:
        c = way * a * scene.mu

        def density(I1: np.ndarray, J: np.ndarray, t: float) -> Derivatives:
            x, zero = (I1 - 3) / 2, np.zeros_like(J)
            return c / 3 * x**3, c / 2 * x**2, zero, c / 2 * x, zero, zero

        return model.with_part(Isotropic(density))

    return Hidden(
        name="tension_compression", start=0.5 / size, most=4 / size, goal=RAW, change=change, details={"sign": way}
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

    return Hidden(name="force_footprint", start=0.2, most=1.0, change=change, details={"sign": way})


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
        name="camera_pose", start=0.01, most=0.1, change=lambda model, a: model.with_view(view(a)),
        details={"axis": axis.tolist(), "since": since},
    )  # fmt: skip


DRAWS = (lopsided, throttled_sweep, wide_footprint, smoothing, knocked_camera)
