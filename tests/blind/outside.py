"""Hidden effects that are in no catalogue: the only right answer is that something is wrong which has no name."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from blind import laws
from blind.hidden import Hidden, greatest_force, patch, region, stiffness_of, typical_mu, unit
from blind.scenes import Model, Observe, Scene
from blind.ties import Buckling, Friction, Magnet

RAW = (4.0, 25.0)


def swelling(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A region that takes up water: its stress-free size grows by (1 + g t/T), F_e = F/(1 + g t/T)."""
    inside, where = region(rng, scene)
    last, mu, lam = float(scene.time[-1]), scene.mu * inside, scene.lam * inside

    def change(model: Model, g: float) -> Model:
        def density(I1: np.ndarray, J: np.ndarray, t: float) -> laws.Derivatives:
            # psi = s^3 psi_NH(I1/s^2, J/s^3) - psi_NH, whose logarithms differ by a constant
            s, zero = 1 + g * t / last, np.zeros_like(J)
            dJ, dJJ = lam * (J / s**3 - J) - mu * (s**3 - 1) / J, lam * (s**-3 - 1) + mu * (s**3 - 1) / J**2
            psi = mu / 2 * (s - 1) * (I1 - 3) - mu * (s**3 - 1) * np.log(J) + lam / 2 * (
                s**3 * (J / s**3 - 1) ** 2 - (J - 1) ** 2)  # fmt: skip
            return psi, mu / 2 * (s - 1) + zero, dJ, zero, zero, dJJ

        return model.with_part(laws.Isotropic(density))

    return Hidden(name="swelling", start=0.05, most=0.3, change=change, goal=RAW, details=where)


def breathing(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A region whose inner pressure comes and goes with a period of its own: psi = -p (1 - cos) / 2 J."""
    inside, where = region(rng, scene)
    period = float(rng.uniform(0.15, 0.6) * scene.time[-1])

    def change(model: Model, p: float) -> Model:
        def density(I1: np.ndarray, J: np.ndarray, t: float) -> laws.Derivatives:
            zero, now = np.zeros_like(J), p * (1 - np.cos(2 * np.pi * t / period)) / 2 * inside
            return -now * (J - 1), zero, -now, zero, zero, zero

        return model.with_part(laws.Isotropic(density))

    start = 0.2 * typical_mu(scene)
    return Hidden(
        name="breathing", start=start, most=6 * start, change=change, goal=RAW, details={**where, "period": period}
    )


def muscle(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Something alive: a region that contracts along an axis in twitches at random moments, psi = a(t) I4 / 2."""
    (inside, where), axis = region(rng, scene), unit(rng)
    beats, width = rng.uniform(0.1, 1, 3) * scene.time[-1], rng.uniform(0.03, 0.1) * scene.time[-1]

    def change(model: Model, tension: float) -> Model:
        def density(I4: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            now = inside * tension * (t > 0) * np.exp(-((t - beats) ** 2) / (2 * width**2)).sum()
            return now * (I4 - 1) / 2, now / 2, 0 * now

        return model.with_part(laws.Fibre(axis, density))

    start = 0.2 * typical_mu(scene)
    details = {**where, "axis": axis.tolist(), "beats": beats.tolist()}
    return Hidden(name="muscle", start=start, most=6 * start, change=change, goal=RAW, details=details)


def buckling(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Negative stiffness: a snap dome under a patch that pushes on once it was pushed, up to its reach."""
    w, spot, radius = patch(rng, scene)
    moved = np.linalg.norm(scene.plain, axis=2)[:, w > 0]
    frame, node = np.unravel_index(moved.argmax(), moved.shape)
    u = scene.plain[frame, np.flatnonzero(w > 0)[node]]
    n = u / np.linalg.norm(u)
    k, reach = stiffness_of(scene, w, n), float(rng.uniform(0.3, 0.7) * np.linalg.norm(u))
    return Hidden(
        name="buckling", start=0.4 * k, most=0.8 * k, goal=RAW, details={"spot": spot.tolist(), "radius": radius},
        change=lambda model, k: model.with_tie(Buckling(w, k, n, reach)),
    )  # fmt: skip


def dry_friction(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A patch rubs on something: it sticks, and slips beyond a force."""
    w, spot, radius = patch(rng, scene)
    k = 5 * typical_mu(scene) * scene.built.spacing
    return Hidden(
        name="dry_friction", start=0.05 * greatest_force(scene), most=0.4 * greatest_force(scene), goal=(2.0, 15.0),
        details={"spot": spot.tolist(), "radius": radius},
        change=lambda model, f: model.with_tie(Friction(k * w, most=f * w), steps=3),
    )  # fmt: skip


def wandering_soft_spot(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A warm spot moves along the body and softens what it passes."""
    body, base = scene.built.body, laws.neo_hookean(scene.mu, scene.lam)
    ends = body.nodes[rng.integers(body.count, size=2)]
    radius, last = rng.uniform(0.2, 0.35) * scene.built.size, float(scene.time[-1])

    def spot(t: float) -> np.ndarray:
        d = np.linalg.norm(body.points - (ends[0] + t / last * (ends[1] - ends[0])), axis=-1)
        return np.exp(-(d**2) / (2 * radius**2))

    return Hidden(
        name="wandering_soft_spot", start=0.5, most=0.9, goal=RAW,
        change=lambda model, d: model.with_part(laws.Scaled(base, lambda t: -d * spot(t))),
    )  # fmt: skip


def netting(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Threads along three axes across each other that hold when pulled and not when pushed.

    psi_4 = mu k p(I4 - 1) of each, p(x) = 0 below 0, x - slack above 2 slack, a parabola between.
    """
    axes, mu, slack = np.linalg.qr(rng.normal(size=(3, 3)))[0].T, scene.mu, 0.005

    def change(model: Model, k: float) -> Model:
        def density(I4: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            x = np.maximum(I4 - 1, 0)
            y, taut = np.minimum(x, 2 * slack), np.maximum(x - 2 * slack, 0)
            psi = y**3 / (12 * slack) + taut * (slack + taut / 2)
            return mu * k * psi, mu * k * (y**2 / (4 * slack) + taut), mu * k * y / (2 * slack)

        return model.with_part(*(laws.Fibre(axis, density) for axis in axes))

    return Hidden(name="netting", start=0.5, most=5.0, goal=RAW, change=change, details={"axes": axes.tolist()})


def moving_support(rng: np.random.Generator, scene: Scene) -> Hidden:
    """The table sways: the held points rock about the support's middle."""
    body, axis = scene.built.body, unit(rng)
    pivot, period = body.nodes[body.fixed].mean(0), float(rng.uniform(0.2, 0.7) * scene.time[-1])

    def change(model: Model, angle: float) -> Model:
        def support(t: float) -> np.ndarray:
            turn = Rotation.from_rotvec(angle * np.sin(2 * np.pi * t / period) * axis)
            return turn.apply(body.nodes - pivot) + pivot - body.nodes

        return replace(model, support=support)

    return Hidden(name="moving_support", start=0.02, most=0.2, change=change, details={"period": period})


def gusts(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A draught that comes and goes and blows on every face that it meets."""
    body, way = scene.built.body, unit(rng)
    _, area = body.facet_geometry(np.zeros_like(body.nodes))
    facing = body.spread @ (np.maximum(0, -area @ way)[:, None] * way)
    periods, phases = rng.uniform(0.1, 0.5, 2) * scene.time[-1], rng.uniform(0, 2 * np.pi, 2)

    def change(model: Model, p: float) -> Model:
        return model.with_force(
            lambda t: (t > 0) * p * np.maximum(0, np.sin(2 * np.pi * t / periods + phases).sum()) * facing
        )

    start = 0.1 * greatest_force(scene) / max(float(np.linalg.norm(facing.sum(0))), 1e-9)
    return Hidden(name="gusts", start=start, most=6 * start, change=change)


def magnet(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A point near the body pulls one patch, the more the nearer it comes."""
    (w, spot, radius), body = patch(rng, scene), scene.built.body
    n = unit(rng)
    p = spot + (0.03 + float(rng.uniform(0, 0.03))) * n
    near = np.linalg.norm(body.nodes[w > 0] - p, axis=1).min()
    p = p + max(0.0, 0.03 - near) * n
    start = 0.1 * greatest_force(scene) * float(np.linalg.norm(p - spot)) ** 2

    def change(model: Model, s: float) -> Model:
        tie = Magnet(body.nodes, w, s, p)
        rest = tie.respond(np.zeros_like(body.nodes), 0.0)[1]
        return model.with_tie(tie).with_force(lambda t: rest)  # the rest shape was filmed with it

    return Hidden(
        name="magnet", start=start, most=12 * start, change=change, goal=RAW,
        details={"spot": spot.tolist(), "radius": radius, "pole": p.tolist()},
    )  # fmt: skip


def rolling_shutter(rng: np.random.Generator, scene: Scene) -> Hidden:
    """The camera reads its lines one after the other: what is high is seen later; the amount is a time [s]."""

    def view(delay: float) -> Observe:
        def show(y: np.ndarray, scene: Scene, model: Model) -> np.ndarray:
            height = (y[0, :, 2] - y[0, :, 2].min()) / np.ptp(y[0, :, 2])
            at = np.clip(scene.time[:, None] - delay * height, 0, None) / scene.interval
            i = np.minimum(at.astype(int), len(y) - 2)
            points, f = np.arange(y.shape[1]), (at - i)[..., None]
            return (1 - f) * y[i, points] + f * y[i + 1, points]

        return show

    return Hidden(
        name="rolling_shutter", start=0.3 * scene.interval, most=1.5 * scene.interval,
        change=lambda model, delay: model.with_view(view(delay)),
    )  # fmt: skip


def zoom_breathing(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A lens that warms up: radial distortion s (t/T) r^2 about an axis through the body, r in its sizes."""
    body, axis, size = scene.built.body, unit(rng), scene.built.size
    middle, last = body.nodes.mean(0), float(scene.time[-1])

    def view(s: float) -> Observe:
        def show(y: np.ndarray, scene: Scene, model: Model) -> np.ndarray:
            d = y - middle
            across = d - (d @ axis)[..., None] * axis
            r2 = (across**2).sum(-1, keepdims=True) / size**2
            return y + s * (scene.time / last)[:, None, None] * r2 * across

        return show

    return Hidden(name="zoom_breathing", start=0.05, most=0.5, change=lambda model, s: model.with_view(view(s)))


DRAWS = (swelling, breathing, muscle, buckling, dry_friction, wandering_soft_spot, netting, moving_support,
         gusts, magnet, rolling_shutter, zoom_breathing)  # fmt: skip
