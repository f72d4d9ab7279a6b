"""What can be hidden in a scene: a name, an amount that is nothing at zero, and what it changes."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from blind.scenes import Model, Scene
from blind.solver import System, pattern_of

Draw = Callable[[np.random.Generator, Scene], "Hidden"]

SHORT = 4  # steps in a frame interval, for what takes turns, or goes on, within one


@dataclass(frozen=True, kw_only=True, eq=False)
class Hidden:
    """An effect drawn for one scene.

    goal: range of raw effects in units of noise to aim at, the amount being scaled from `start` to at most `most`.
    tells: parameters by the toolkit's names where its formula is the one used here.
    """

    name: str
    start: float
    most: float
    change: Callable[[Model, float], Model]
    goal: tuple[float, float] = (2.0, 20.0)
    details: dict[str, object] | None = None
    tells: Callable[[float], dict[str, float]] = lambda amount: {}
    density: bool = False  # the amount is the body's density [kg/m3]


def sign(rng: np.random.Generator) -> int:
    """1 or -1."""
    return int(rng.choice([-1, 1]))


def unit(rng: np.random.Generator) -> np.ndarray:
    """A direction, evenly over the sphere."""
    d = rng.normal(size=3)
    return d / np.linalg.norm(d)


def named(prefix: str, vector: np.ndarray) -> dict[str, float]:
    """A vector as three parameters."""
    return {f"{prefix}_{a}": float(v) for a, v in zip("xyz", vector, strict=True)}


def patch(rng: np.random.Generator, scene: Scene) -> tuple[np.ndarray, np.ndarray, float]:
    """Weights (N,) of sum 1 around a free spot of the surface that moves, the spot (3,) and the radius [m]."""
    body = scene.built.body
    moved = np.linalg.norm(scene.plain, axis=2).max(axis=0) * (body.surface > 0) * ~body.fixed
    spot = body.nodes[rng.choice(np.flatnonzero(moved > 0.25 * moved.max()))]
    radius = scene.built.spacing * rng.uniform(1, 2.5)
    w = body.surface * ~body.fixed * np.exp(-((body.nodes - spot) ** 2).sum(1) / (2 * radius**2))
    w[w < 1e-3 * w.max()] = 0
    return w / w.sum(), spot, radius


def region(rng: np.random.Generator, scene: Scene) -> tuple[np.ndarray, dict[str, object]]:
    """A ball around a free point inside the body, 1 within and 0 without over a tenth of its radius, (E, Q)."""
    body = scene.built.body
    centre = body.nodes[rng.choice(np.flatnonzero(np.linalg.norm(scene.plain, axis=2).max(0) > 2e-3))]
    radius = rng.uniform(0.15, 0.3) * scene.built.size
    d = np.linalg.norm(body.points - centre, axis=-1)
    inside = 1 / (1 + np.exp(np.clip((d - radius) / (0.1 * radius), -50, 50)))
    return inside, {"centre": centre.tolist(), "radius": radius}


def typical_mu(scene: Scene) -> float:
    """Median shear modulus [Pa]."""
    return float(np.median(scene.mu))


def greatest_force(scene: Scene) -> float:
    """The largest resultant of the nominal load [N]."""
    geometry = scene.built.body.facet_geometry(np.zeros_like(scene.built.body.nodes))
    shots = [scene.program.at(float(t)) for t in scene.time]
    return max(float(np.linalg.norm(s.pull(*geometry).sum(0))) for s in shots)


def stiffness_of(scene: Scene, w: np.ndarray, n: np.ndarray) -> float:
    """How stiffly a patch w (N,) of sum 1 resists along n (3,) about rest, 1 / (w n . K^-1 w n) [N/m]."""
    body = scene.built.body
    system = System(body=body, parts=Model.plain(scene).parts, force=lambda u, t: np.zeros_like(u))
    push = (w[:, None] * n).ravel()[pattern_of(body).free]
    return float(1 / (push @ system.solver().solve(push)))
