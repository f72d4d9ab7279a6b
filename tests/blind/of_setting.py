"""Hidden effects of the catalogue in geometry, support, dynamics and measurement."""

from dataclasses import replace

import fem
import numpy as np

from blind.body import Body, split
from blind.hidden import SHORT, Hidden, greatest_force, sign, typical_mu
from blind.of_loads import GRAVITY
from blind.scenes import Model, Observe, Scene
from blind.shapes import Built
from blind.solver import System, pattern_of
from blind.ties import Drag, Inertia, Springs

SUBSTEPS = 60  # at least, in a period of the slowest vibration


def disconnection(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A crack across the body: nodes of a cut plane doubled over a share of the section, from one side.

    One that would open nothing, or set a part free, is drawn again.
    """
    while True:
        crack = _crack(rng, scene)
        body = crack.change(Model.plain(scene), crack.start).built.body
        if body.count > scene.built.body.count and body.hangs_together:
            return crack


def _crack(rng: np.random.Generator, scene: Scene) -> Hidden:
    lattice, axis = scene.built.lattice, 2
    planes = np.unique(lattice[:, axis].round(6))[2::2]
    planes = planes[(planes > 0.25 * planes.max()) & (planes < 0.75 * planes.max())]
    plane, across, side = float(rng.choice(planes)), int(rng.integers(2)), sign(rng)
    cells = lattice[scene.built.body.elements].mean(axis=1)

    def change(model: Model, share: float) -> Model:
        on = np.abs(lattice[:, axis] - plane) < 1e-6
        s = side * lattice[:, across]
        low = s[on].min()
        # The front follows a line of corner nodes, so that no cell is half open.
        lines = side * np.unique(lattice[on, across].round(6))[::2]
        front = lines[np.abs(lines - (low + share * np.ptp(s[on]))).argmin()]
        open_ = on & (s < front - 1e-6) & ~model.built.body.fixed
        return _with_body(model, split(model.built.body, open_, cells[:, axis] > plane))

    return Hidden(
        name="disconnection", start=float(rng.uniform(0.4, 0.8)), most=0.8, change=change,
        details={"plane": plane, "from": "xy"[across]},
    )  # fmt: skip


def _with_body(model: Model, body: Body) -> Model:
    return replace(model, built=replace(model.built, body=body))


def support_compliance(rng: np.random.Generator, scene: Scene) -> Hidden:
    """The held nodes stand on an even bed of springs of the compliance c [m3/N], a length over a modulus."""
    body = scene.built.body
    bed = body.surface * body.fixed

    def change(model: Model, c: float) -> Model:
        if c == 0:
            return model
        freed = replace(model.built.body, fixed=np.zeros_like(body.fixed))
        return _with_body(model, freed).with_tie(Springs(bed / c))

    size = scene.built.size / typical_mu(scene)
    return Hidden(name="support_compliance", start=0.03 * size, most=0.5 * size, change=change, goal=(3.0, 20.0))


def prestress(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Frame 0 already sags under the body's weight; the amount is its density [kg/m3]."""
    weight = scene.built.body.volume[:, None] * np.array([0, 0, -GRAVITY])
    return Hidden(
        name="prestress", start=200.0, most=1100.0, density=True, goal=(3.0, 20.0),
        tells=lambda density: {"share": 1.0},
        change=lambda model, density: replace(model, weight=density * weight),
    )  # fmt: skip


def inertia(rng: np.random.Generator, scene: Scene) -> Hidden:
    """The body's mass, weighed, and a damping of some per cent of the critical; the amount is the density [kg/m3]."""
    ratio, volume = float(rng.uniform(0.02, 0.15)), scene.built.body.volume
    slowest = slowest_vibration(scene, volume)  # [rad/s] at 1 kg/m3

    def change(model: Model, density: float) -> Model:
        if density == 0:
            return model
        omega = slowest / np.sqrt(density)
        steps = int(np.clip(np.ceil(SUBSTEPS * scene.interval * omega / (2 * np.pi)), 2, 30))
        return model.with_tie(Inertia(density * volume, 2 * ratio * omega), steps=steps)

    return Hidden(
        name="inertia", start=100.0, most=900.0, change=change, density=True, details={"damping_ratio": ratio},
        tells=lambda density: {"share": 1.0, "damping_ratio": ratio},
    )  # fmt: skip


def damping(rng: np.random.Generator, scene: Scene) -> Hidden:
    """The surroundings brake: -c V_i v_i; the amount is c [N s/m4]."""
    speed = np.abs(np.diff(scene.plain, axis=0)).max() / scene.interval
    volume = scene.built.body.volume
    start = 0.05 * greatest_force(scene) / (speed * volume.sum())
    return Hidden(
        name="damping", start=start, most=50 * start, tells=lambda c: {"drag": c},
        change=lambda model, c: model.with_tie(Drag(c * volume), steps=2 * SHORT),
    )  # fmt: skip


def slowest_vibration(scene: Scene, mass: np.ndarray) -> float:
    """Angular frequency [rad/s] of the first mode about rest, by inverse iteration; mass (N,) [kg]."""
    plain = Model.plain(scene)
    body = scene.built.body
    system = System(body=body, parts=plain.parts, force=lambda u, t: np.zeros_like(u))
    m = np.repeat(mass, 3)[pattern_of(body).free]
    v = np.random.default_rng(0).normal(size=len(m))
    for _ in range(30):
        w = system.solver().solve(m * v)
        v = w / np.sqrt(w @ (m * w))
    return float(1 / np.sqrt(v @ (m * system.solver().solve(m * v))))


def camera_scale(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Everything seen larger or smaller after frame 0, about a point near the body's middle."""
    way, body = sign(rng), scene.built.body
    middle = body.nodes.mean(0) + 0.05 * scene.built.size * rng.normal(size=3)

    def view(s: float) -> Observe:
        def show(y: np.ndarray, scene: Scene, model: Model) -> np.ndarray:
            return np.concatenate([y[:1], middle + (1 + way * s) * (y[1:] - middle)])

        return show

    return Hidden(
        name="camera_scale", start=0.005, most=0.04, change=lambda model, s: model.with_view(view(s)),
        details={"sign": way}, tells=lambda s: {"scale": way * s},
    )  # fmt: skip


def correspondence_slip(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A share of the motion along the surface is not seen, of points on it."""

    def view(share: float) -> Observe:
        def show(y: np.ndarray, scene: Scene, model: Model) -> np.ndarray:
            return np.stack([y[0], *(_slipped(scene.built, y[0], now, share) for now in y[1:])])

        return show

    return Hidden(
        name="correspondence_slip", start=0.1, most=0.5, change=lambda model, c: model.with_view(view(c)),
        tells=lambda c: {"share": c},
    )  # fmt: skip


def _slipped(built: Built, rest: np.ndarray, y: np.ndarray, share: float) -> np.ndarray:
    area = fem.area_vectors(fem.hats(built.seen_mesh(y)))
    n = area / np.maximum(np.linalg.norm(area, axis=1, keepdims=True), 1e-12)
    u = y - rest
    along = u - (u * n).sum(1, keepdims=True) * n
    return y - share * along * built.surface[:, None]


DRAWS = (disconnection, support_compliance, prestress, inertia, damping, camera_scale, correspondence_slip)
