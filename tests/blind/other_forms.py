"""Hidden effects of the catalogue in loads, dynamics and measurement, in forms that no other mix hides."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from blind import of_loads, of_setting
from blind.hidden import SHORT, Hidden, patch, sign, typical_mu, unit
from blind.history import Viscous
from blind.jets import Shot
from blind.scenes import Model, Observe, Scene
from blind.ties import String, Wake

UP = np.array([0, 0, 1.0])
VALVE = 40  # steps in a frame interval, in which a valve opens


def dead_zone(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A regulator that opens at a share a of the largest pressure: p <p/p_max - a>/(1 - a)."""
    most = scene.program.most(scene.time)

    def change(model: Model, a: float) -> Model:
        return of_loads.reshot(
            model, lambda shot: replace(shot, pressure=most * max(0.0, shot.pressure / most - a) / (1 - a))
        )

    return Hidden(name="force_magnitude", start=0.1, most=0.5, change=change, goal=(4.0, 30.0))


def slow_valve(rng: np.random.Generator, scene: Scene) -> Hidden:
    """The pressure follows the nominal one as through a volume that fills, p' = (p_nominal - p)/tau."""
    step = scene.interval / VALVE
    times = step * np.arange(VALVE * len(scene.time))
    nominal = np.array([scene.program.at(float(t)).pressure for t in times])

    def change(model: Model, tau: float) -> Model:
        if tau == 0:
            return model
        kept, filled = np.exp(-step / tau), np.zeros_like(nominal)
        for i in range(1, len(times)):
            filled[i] = kept * filled[i - 1] + (1 - kept) * (nominal[i] + nominal[i - 1]) / 2
        before = model.shot
        return replace(model, shot=lambda t: replace(before(t), pressure=float(np.interp(t, times, filled))))

    return Hidden(name="force_timing", start=0.2 * scene.interval, most=1.2 * scene.interval, change=change)


def lifted_nozzle(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Every jet blows higher, or lower, than its nozzle points."""
    way = sign(rng)

    def lifted(shot: Shot, angle: float) -> Shot:
        R = Rotation.from_rotvec(way * angle * _aside(shot))
        return replace(shot, direction=R.apply(shot.direction))

    return Hidden(
        name="force_direction", start=0.07, most=0.4, details={"sign": way},
        change=lambda model, angle: of_loads.reshot(model, lambda shot: lifted(shot, angle)),
    )  # fmt: skip


def nozzle_aside(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Every jet comes from farther right, or left, as the nozzle sees it."""
    way = sign(rng)
    return Hidden(
        name="force_offset", start=0.006, most=0.03, details={"sign": way},
        change=lambda model, d: of_loads.reshot(
            model, lambda shot: replace(shot, position=shot.position + way * d * _aside(shot))
        ),
    )  # fmt: skip


def _aside(shot: Shot) -> np.ndarray:
    """Level, and across the jet."""
    d = shot.direction
    across = np.cross(d, UP) if abs(d @ UP) < 0.99 else np.array([1.0, 0, 0])
    return across / np.linalg.norm(across)


def string(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A patch hangs on a string that is taut at rest, and pulls only where it gets longer."""
    (w, spot, radius), n, body = patch(rng, scene), unit(rng), scene.built.body
    anchor = spot + 0.1 * n
    size = typical_mu(scene) * scene.built.spacing
    return Hidden(
        name="hidden_tether", start=2 * size, most=40 * size, goal=(4.0, 30.0),
        details={"spot": spot.tolist(), "radius": radius, "anchor": anchor.tolist()},
        change=lambda model, k: model.with_tie(String(body.nodes, k * w, anchor)),
    )  # fmt: skip


def soft_pad(rng: np.random.Generator, scene: Scene) -> Hidden:
    """An obstacle hardly stiffer than the body."""
    hard = of_loads.hidden_contact(rng, scene)

    def change(model: Model, share: float) -> Model:
        tie = hard.change(model, share).ties[-1]
        return model.with_tie(replace(tie, k=tie.k / 15))

    return replace(hard, change=change)


def sinking_table(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A tilt that grows with time."""
    tilted, last = of_loads.gravity_direction(rng, scene), float(scene.time[-1])

    def change(model: Model, angle: float) -> Model:
        return model.with_force(lambda t: tilted.change(Model.plain(scene), angle * t / last).extra(t))

    return replace(tilted, change=change, tells=lambda angle: {})


def uneven_support(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Held nodes whose springs are a hundred times stiffer on one side than on the other."""
    even, body, way = of_setting.support_compliance(rng, scene), scene.built.body, unit(rng)
    along = body.nodes @ way
    held = along[body.fixed]
    share = (along - held.min()) / max(float(np.ptp(held)), 1e-12)

    def change(model: Model, c: float) -> Model:
        changed = even.change(model, c)
        if c == 0:
            return changed
        springs = changed.ties[-1]
        uneven = replace(springs, k=springs.k * 10 ** (2 * share - 1))
        return replace(changed, ties=(*changed.ties[:-1], uneven))

    return replace(even, change=change)


def rubber_inertia(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Mass, and a damping by the material, the more the quicker it vibrates."""
    light = of_setting.inertia(rng, scene)
    ratio = light.details["damping_ratio"]
    slowest = of_setting.slowest_vibration(scene, scene.built.body.volume)

    def change(model: Model, density: float) -> Model:
        if density == 0:
            return model
        heavy, omega = light.change(model, density), slowest / np.sqrt(density)
        tau = 0.02 / omega
        mass = replace(heavy.ties[-1], c=0.0)
        return replace(heavy, ties=(*heavy.ties[:-1], mass)).with_part(Viscous(2 * ratio / 0.02 * scene.mu, tau))

    return replace(light, change=change, tells=lambda density: {"share": 1.0})


def wake(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Drag by the square of the speed."""
    linear = of_setting.damping(rng, scene)
    speed = np.abs(np.diff(scene.plain, axis=0)).max() / scene.interval
    return Hidden(
        name="damping", start=2 * linear.start / speed, most=2 * linear.most / speed,
        change=lambda model, c: model.with_tie(Wake(c * scene.built.body.volume), steps=2 * SHORT),
    )  # fmt: skip


def growing_scale(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Everything seen larger or smaller the later it is."""
    way, middle, last = sign(rng), scene.built.body.nodes.mean(0), float(scene.time[-1])

    def view(s: float) -> Observe:
        def show(y: np.ndarray, scene: Scene, model: Model) -> np.ndarray:
            return middle + (1 + way * s * scene.time / last)[:, None, None] * (y - middle)

        return show

    return Hidden(
        name="camera_scale", start=0.01, most=0.06, change=lambda model, s: model.with_view(view(s)),
        details={"sign": way},
    )  # fmt: skip


def uneven_slip(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A share of the motion along the surface is not seen, most on one side of the body."""
    even, way = of_setting.correspondence_slip(rng, scene), unit(rng)

    def view(share: float) -> Observe:
        def show(y: np.ndarray, scene: Scene, model: Model) -> np.ndarray:
            along = y[0] @ way
            side = 2 * (along - along.min()) / np.ptp(along)
            slipped = even.change(Model.plain(scene), share).observe[0](y, scene, model)
            return y + side[:, None] * (slipped - y)

        return show

    return replace(even, change=lambda model, c: model.with_view(view(c)), tells=lambda c: {})


def lost_frames(rng: np.random.Generator, scene: Scene) -> Hidden:
    """The load's clock stops for a moment, and is late from then on."""
    since = float(rng.uniform(0.2, 0.5) * scene.time[-1])

    def change(model: Model, delay: float) -> Model:
        before = model.shot
        return replace(model, shot=lambda t: before(t if t < since else max(since, t - delay)))

    return Hidden(
        name="clock_drift", start=0.4 * scene.interval, most=2 * scene.interval, change=change,
        details={"since": since},
    )  # fmt: skip


DRAWS = (dead_zone, slow_valve, lifted_nozzle, nozzle_aside, string, soft_pad, sinking_table, uneven_support,
         rubber_inertia, wake, growing_scale, uneven_slip, lost_frames)  # fmt: skip
