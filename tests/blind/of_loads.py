"""Hidden effects of the catalogue in the loads: not what, where or when they were said to be, or unknown ones."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from blind.hidden import Hidden, greatest_force, named, patch, sign, typical_mu, unit
from blind.jets import Shot
from blind.scenes import Model, Scene
from blind.ties import Obstacle, Springs

GRAVITY = 9.81  # [m/s2]


def reshot(model: Model, change: Callable[[Shot], Shot]) -> Model:
    """The same with every shot changed."""
    before = model.shot
    return replace(model, shot=lambda t: change(before(t)))


def force_direction(rng: np.random.Generator, scene: Scene) -> Hidden:
    """The same rotation in every frame, of the force where it acts, or of the jet about its nozzle."""
    axis, how = unit(rng), str(rng.choice(["force", "nozzle"]))

    def change(model: Model, angle: float) -> Model:
        R = Rotation.from_rotvec(angle * axis).as_matrix()
        if how == "force":
            return replace(model, turn=R)
        return reshot(model, lambda shot: replace(shot, direction=R @ shot.direction))

    return Hidden(
        name="force_direction", start=0.07, most=0.4, change=change, details={"axis": axis.tolist(), "turned": how},
        tells=lambda angle: named("turn", angle * axis),
    )  # fmt: skip


def force_offset(rng: np.random.Generator, scene: Scene) -> Hidden:
    """The same shift of the nozzle in every frame."""
    way = unit(rng)
    return Hidden(
        name="force_offset", start=0.006, most=0.03, details={"direction": way.tolist()},
        change=lambda model, d: reshot(model, lambda shot: replace(shot, position=shot.position + d * way)),
        tells=lambda d: named("shift", d * way),
    )  # fmt: skip


def force_magnitude(rng: np.random.Generator, scene: Scene) -> Hidden:
    """p (p/p_max)^n, or a pressure that saturates: p (1 + a)/(1 + a p/p_max)."""
    form, way, most = str(rng.choice(["power", "saturation"])), sign(rng), scene.program.most(scene.time)

    def change(model: Model, n: float) -> Model:
        def pressure(p: float) -> float:
            if p <= 0:
                return 0.0
            return p * (p / most) ** (way * n) if form == "power" else p * (1 + n) / (1 + n * p / most)

        return reshot(model, lambda shot: replace(shot, pressure=pressure(shot.pressure)))

    return Hidden(
        name="force_magnitude", start=0.2, most=0.7 if form == "power" else 3.0, change=change, goal=(4.0, 30.0),
        details={"form": form, "sign": way if form == "power" else 1},
        tells=(lambda n: {"exponent": way * n}) if form == "power" else (lambda n: {}),
    )  # fmt: skip


def force_timing(rng: np.random.Generator, scene: Scene) -> Hidden:
    """The load comes later, or sometimes earlier, than stamped."""
    way = 1 if rng.random() < 0.8 else -1

    def change(model: Model, delay: float) -> Model:
        before = model.shot
        return replace(model, shot=lambda t: before(t - way * delay))

    return Hidden(
        name="force_timing", start=0.2 * scene.interval, most=1.2 * scene.interval, change=change,
        details={"sign": way}, tells=lambda delay: {"delay": way * delay},
    )  # fmt: skip


def clock_drift(rng: np.random.Generator, scene: Scene) -> Hidden:
    """The load's clock runs at another speed."""
    way, frame = sign(rng), scene.interval / float(scene.time[-1])

    def change(model: Model, rate: float) -> Model:
        before = model.shot
        return replace(model, shot=lambda t: before(t * (1 + way * rate)))

    return Hidden(
        name="clock_drift", start=0.4 * frame, most=2 * frame, change=change, details={"sign": way},
        tells=lambda rate: {"rate": way * rate},
    )  # fmt: skip


def follower_load(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A share of the force goes with the surface, by its cofactor or by its rotation only."""
    how = str(rng.choice(["cofactor", "turned"]))
    return Hidden(
        name="follower_load", start=0.5, most=1.0, change=lambda model, w: replace(model, follow=(w, how)),
        goal=(4.0, 30.0), details={"form": how}, tells=lambda w: {"share": w} if how == "cofactor" else {},
    )  # fmt: skip


def hidden_force(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A constant force on a patch from the second frame on."""
    (w, spot, radius), way = patch(rng, scene), unit(rng)
    return Hidden(
        name="hidden_force", start=0.1 * greatest_force(scene), most=0.5 * greatest_force(scene),
        details={"spot": spot.tolist(), "radius": radius, "direction": way.tolist()},
        change=lambda model, f: model.with_force(lambda t: (t > 0) * f * w[:, None] * way),
        tells=lambda f: named("force", f * way) | named("spot", spot),
    )  # fmt: skip


def hidden_tether(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Springs over a patch that hold it where it was at rest."""
    w, spot, radius = patch(rng, scene)
    size = typical_mu(scene) * scene.built.spacing
    return Hidden(
        name="hidden_tether", start=0.5 * size, most=20 * size, goal=(4.0, 30.0),
        details={"spot": spot.tolist(), "radius": radius},
        change=lambda model, k: model.with_tie(Springs(k * w)),
        tells=lambda k: {"stiffness": k} | named("spot", spot),
    )  # fmt: skip


def hidden_contact(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A plane or a ball in the way, clear of the rest shape; the amount is the share of the motion it blocks."""
    body, radius = scene.built.body, float(rng.choice([0, rng.uniform(0.04, 0.1)]))
    stiffness = 10 * typical_mu(scene) / scene.built.spacing * body.surface
    reaches = [_reach(scene, s.direction) for s in scene.program.sweeps]
    d, tip, rest, far = reaches[int(np.argmax([r[3] - r[2] for r in reaches]))]

    def change(model: Model, share: float) -> Model:
        wall = tip + (rest + (far - rest) * (1 - share) - tip @ d) * d
        if not radius:
            return model.with_tie(Obstacle(body.nodes, stiffness, wall, -d))
        away = wall + radius * d
        while (clear := np.linalg.norm(body.nodes - away, axis=1).min() - radius) < 0:
            away = away + (1e-4 - clear) * d
        return model.with_tie(Obstacle(body.nodes, stiffness, away, -d, radius))

    return Hidden(
        name="hidden_contact", start=0.3, most=0.9, change=change,
        details={"direction": d.tolist(), "radius": radius or None},
    )  # fmt: skip


def _reach(scene: Scene, d: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, float]:
    """The direction, where the body reaches farthest along it in its motion, and how far at rest and then."""
    along = (scene.built.body.nodes + scene.plain) @ d
    frame, node = np.unravel_index(along.argmax(), along.shape)
    return d, scene.built.body.nodes[node] + scene.plain[frame, node], float(along[0].max()), float(along.max())


def gravity_direction(rng: np.random.Generator, scene: Scene) -> Hidden:
    """The body tilted by an angle after frame 0: the weight changes by m g (sin a h + (1 - cos a) z)."""
    turn, mass = rng.uniform(0, 2 * np.pi), scene.density * scene.built.body.volume
    level = np.array([np.cos(turn), np.sin(turn), 0.0])

    def pull(angle: float) -> np.ndarray:
        return GRAVITY * (np.sin(angle) * level + (1 - np.cos(angle)) * np.array([0, 0, 1.0]))

    return Hidden(
        name="gravity_direction", start=0.1, most=0.8, details={"level": level.tolist()},
        change=lambda model, a: model.with_force(lambda t: (t > 0) * mass[:, None] * pull(a)),
        tells=lambda a: named("change", pull(a)),
    )  # fmt: skip


DRAWS = (force_direction, force_offset, force_magnitude, force_timing, clock_drift, follower_load, hidden_force,
         hidden_tether, hidden_contact, gravity_direction)  # fmt: skip
