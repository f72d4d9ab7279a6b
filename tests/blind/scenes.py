"""A scene with nothing hidden: a random body, its material, the jets that sweep over it, and how it is simulated."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from blind import jets, laws
from blind.shapes import Built, build, draw_shape
from blind.solver import System, Tie, march, pattern_of

FRAMES = {"tiny": (2, 5), "small": (3, 7), "full": (4, 10)}  # sweeps, loaded frames in each
REST = 3  # unloaded frames at the end
STATIONS = 5
SAG_STEPS = 4
Observe = Callable[[np.ndarray, "Scene", "Model"], np.ndarray]  # y (T, M, 3) [m] -> what tracking shows


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """What stays the same whatever is hidden."""

    built: Built
    mu: np.ndarray  # (E, Q) [Pa]
    lam: np.ndarray  # (E, Q) [Pa]
    density: float  # [kg/m3]
    program: jets.Program
    time: np.ndarray  # (T,) [s]

    @property
    def interval(self) -> float:
        """Time between frames [s]."""
        return float(self.time[1] - self.time[0])

    @cached_property
    def plain(self) -> np.ndarray:
        """Nodal displacements (T, N, 3) [m] with nothing hidden."""
        return Model.plain(self).nodal(self)

    @cached_property
    def plain_seen(self) -> np.ndarray:
        """The same at the seen points, (T, M, 3) [m]."""
        return np.stack([self.built.body.seen @ u for u in self.plain])

    @cached_property
    def counted(self) -> np.ndarray:
        """Seen points that tell something: free ones of the surface, (M,) bool."""
        return self.built.surface & ~self.built.fixed

    @cached_property
    def strain(self) -> float:
        """I1 - 3 without the change of volume: its 95th percentile over the body in the frame of the largest motion."""
        worst = np.abs(self.plain).max((1, 2)).argmax()
        F = self.built.body.F(self.plain[worst])
        return float(np.quantile(laws.isochoric((F * F).sum((-1, -2)), np.linalg.det(F)) - 3, 0.95))


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """How a scene moves: what an effect changes. `Model.plain` is the scene as the nominal data say."""

    built: Built
    parts: tuple[laws.Part, ...]
    shot: Callable[[float], jets.Shot]  # the true jet at a time
    ties: tuple[Tie, ...] = ()
    turn: np.ndarray | None = None  # (3, 3), the force turned where it acts
    follow: tuple[float, str] = (0.0, "")  # share of the force carried along, and how
    extra: Callable[[float], np.ndarray] | None = None  # t -> (N, 3) [N] on top
    support: Callable[[float], np.ndarray] | None = None
    weight: np.ndarray | None = None  # (N, 3) [N] that the frame-0 shape already carries
    steps: int = 1  # in each frame interval
    observe: tuple[Observe, ...] = ()

    @classmethod
    def plain(cls, scene: Scene) -> "Model":
        """Nothing hidden."""
        return cls(built=scene.built, parts=(laws.neo_hookean(scene.mu, scene.lam),), shot=scene.program.at)

    def with_part(self, *parts: laws.Part, steps: int = 1) -> "Model":
        """More material."""
        return replace(self, parts=(*self.parts, *parts), steps=max(steps, self.steps))

    def with_tie(self, *ties: Tie, steps: int = 1) -> "Model":
        """More springs, obstacles or masses."""
        return replace(self, ties=(*self.ties, *ties), steps=max(steps, self.steps))

    def with_force(self, force: Callable[[float], np.ndarray]) -> "Model":
        """More load, t -> (N, 3) [N]."""
        before = self.extra
        return replace(self, extra=force if before is None else lambda t: before(t) + force(t))

    def with_view(self, view: Observe) -> "Model":
        """Another thing that tracking does."""
        return replace(self, observe=(*self.observe, view))

    def sag(self) -> np.ndarray:
        """Displacement (N, 3) [m] from the stress-free shape to that of frame 0."""
        start = np.zeros_like(self.built.body.nodes)
        if self.weight is None:
            return start
        system = System(body=self.built.body, parts=self.parts[:1], force=lambda u, t: t * self.weight)
        return march(system, np.linspace(0, 1, SAG_STEPS + 1))[-1]

    def nodal(self, scene: Scene, start: np.ndarray | None = None) -> np.ndarray:
        """Displacements (T, N, 3) [m] from the stress-free shape; start: that of frame 0, where it is known."""
        start = self.sag() if start is None else start
        body = self.built.body
        x, area = body.facet_geometry(start)
        share, how = self.follow

        def force(u: np.ndarray, t: float) -> np.ndarray:
            pull = self.shot(t).pull(x, area)
            if self.turn is not None:
                pull = pull @ self.turn.T
            if share and pull.any():
                pull = (1 - share) * pull + share * _carried(body.facet_F(u).reshape(-1, 3, 3), pull, how)
            total = body.spread @ pull
            total = total if self.extra is None else total + self.extra(t)
            return total if self.weight is None else total + self.weight

        system = System(
            body=body, parts=self.parts, ties=self.ties, force=force, support=self.support, follows=bool(share)
        )
        return march(system, scene.time, steps=self.steps, start=start)

    def seen(self, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
        """Noise-free positions that tracking shows, (T, M, 3) [m], and the rest shape among them."""
        start = self.sag()
        body = self.built.body
        y = np.stack([body.seen @ (body.nodes + u) for u in self.nodal(scene, start)])
        for view in self.observe:
            y = view(y, scene, self)
        return y, y[0]


def _carried(F: np.ndarray, pull: np.ndarray, how: str) -> np.ndarray:
    """The force carried along by the surface: by its `cofactor`, or `turned` with the polar rotation only."""
    if how == "cofactor":
        return (np.linalg.det(F)[:, None, None] * np.linalg.inv(F).swapaxes(1, 2) @ pull[..., None])[..., 0]
    U, _, V = np.linalg.svd(F)
    return (U @ V @ pull[..., None])[..., 0]


def draw_scene(rng: np.random.Generator, size: str, *, brisk: bool = False) -> Scene:
    """A random body with 2 or 3 regions of stiffness under random sweeps; brisk: 20 to 50 frames a second."""
    built = build(rng, draw_shape(rng), size)
    mu, lam = _draw_material(rng, built)
    sweeps, loaded = FRAMES[size]
    shortest, longest = (0.02, 0.05) if brisk else (0.03, 0.5)
    interval = float(np.exp(rng.uniform(np.log(shortest), np.log(longest))))
    count = 1 + sweeps * (loaded + 1) + REST
    program = _draw_program(rng, built, mu, lam, interval, sweeps, loaded)
    return Scene(
        built=built, mu=mu, lam=lam, density=float(np.exp(rng.uniform(np.log(30), np.log(300)))), program=program,
        time=interval * np.arange(count),
    )  # fmt: skip


def _draw_material(rng: np.random.Generator, built: Built) -> tuple[np.ndarray, np.ndarray]:
    """mu (E, Q) [Pa] 3 to 40 kPa in 2 or 3 regions with smooth or sharp borders, lam/mu 2 to 8, a little uneven."""
    x, nodes = built.body.points, built.body.nodes
    log_mu, log_ratio = np.log(rng.uniform(6e3, 20e3)) * np.ones(x.shape[:2]), np.log(rng.uniform(2, 8))
    width = rng.choice([1e-4, rng.uniform(0.005, 0.03)])
    for _ in range(rng.integers(1, 3)):
        centre = nodes[rng.integers(len(nodes))]
        if rng.random() < 0.6:
            way = built.axis + 0.5 * rng.normal(size=3)
            past = (x - nodes.mean(0) * 0.5 - centre * 0.5) @ (way / np.linalg.norm(way))
        else:
            past = rng.uniform(0.2, 0.4) * built.size - np.linalg.norm(x - centre, axis=-1)
        inside = 1 / (1 + np.exp(-np.clip(past / width, -50, 50)))
        log_mu += rng.choice([-1, 1]) * np.log(rng.uniform(1.5, 4)) * inside
        log_ratio = log_ratio + rng.normal(0, 0.1) * inside
    mu = np.exp(np.clip(log_mu, np.log(3e3), np.log(40e3)))
    return mu, mu * np.exp(np.clip(log_ratio, np.log(2), np.log(8)))


def _draw_program(
    rng: np.random.Generator, built: Built, mu: np.ndarray, lam: np.ndarray, interval: float, sweeps: int, loaded: int
) -> jets.Program:
    """Sweeps along the body from different sides, throttled so that each moves it by 5 to 25 mm at most."""
    footprint, made, previous = rng.uniform(0.022, 0.042), [], None
    moves = _Compliance(built, mu, lam)
    for i in range(sweeps):
        timing = {"begin": interval * i * (loaded + 1), "length": interval * (loaded + 1)}
        if i == sweeps - 1 and sweeps > 2 and rng.random() < 0.4:  # the first one again
            made.append(replace(made[0], pressure=made[0].pressure * rng.choice([1.0, 0.6, 1.3]), **timing))
            continue
        direction = _draw_direction(rng, built.axis, previous)
        previous, held = direction, rng.random() < 0.35
        start, end = _draw_path(rng, built, direction, held)
        sweep = jets.Sweep(
            start=start, end=end, direction=direction, pressure=np.ones(STATIONS),
            shape="held" if held else "hump", **timing,
        )  # fmt: skip
        goal = np.clip(rng.uniform(0.04, 0.12) * built.size, 0.006, 0.025)
        made.append(replace(sweep, pressure=moves.pressure(sweep, footprint, goal)))
    return jets.Program(sweeps=tuple(made), footprint=footprint)


def _draw_direction(rng: np.random.Generator, axis: np.ndarray, previous: np.ndarray | None) -> np.ndarray:
    """Mostly across the long axis, at least 50 degrees away from the sweep before."""
    while True:
        d = rng.normal(size=3)
        d -= (d @ axis) * axis
        d = d / np.linalg.norm(d) + rng.uniform(-0.5, 0.3) * axis
        d /= np.linalg.norm(d)
        if previous is None or d @ previous < np.cos(np.deg2rad(50)):
            return d


def _draw_path(
    rng: np.random.Generator, built: Built, direction: np.ndarray, held: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Two points on the side that faces the jet, in the outer two thirds of the body."""
    body = built.body
    x, area = body.facet_geometry(np.zeros_like(body.nodes))
    far = x @ built.axis
    far = (far - far.min()) / np.ptp(far)
    facing = x[(area @ direction < -0.3 * np.linalg.norm(area, axis=1)) & (far > 0.35)]
    start, end = facing[rng.integers(len(facing), size=2)]
    return start, start if held else end


class _Compliance:
    """How far a jet moves the body, linearly, to choose its pressure."""

    def __init__(self, built: Built, mu: np.ndarray, lam: np.ndarray) -> None:
        self.built, self.mu = built, mu
        zero = np.zeros_like(built.body.nodes)
        self.system = System(body=built.body, parts=(laws.neo_hookean(mu, lam),), force=lambda u, t: zero)
        self.geometry = built.body.facet_geometry(zero)

    def pressure(self, sweep: jets.Sweep, footprint: float, goal: float) -> np.ndarray:
        """Pressure [Pa] at each station that moves some node by `goal` [m], but none that dents the softest part."""
        body, free = self.built.body, pattern_of(self.built.body).free
        moved = []
        for phase in np.linspace(0, 1, STATIONS):
            position = sweep.target(phase) - jets.DISTANCE * sweep.direction
            shot = jets.Shot(position=position, direction=sweep.direction, pressure=1.0, footprint=footprint)
            force = (body.spread @ shot.pull(*self.geometry)).ravel()[free]
            moved.append(np.abs(self.system.solver().solve(force)).max())
        return np.minimum(goal / np.array(moved), 0.35 * np.median(self.mu))
