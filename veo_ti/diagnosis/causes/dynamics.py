"""Causes in the motion itself: mass that has to be moved, air that has to be pushed aside."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sim.vibration import delay, follow, lag
from veo_ti.diagnosis.causes.base import Carried, Cause, Change, Measure, Parameter
from veo_ti.diagnosis.causes.courses import Course, scaled
from veo_ti.diagnosis.causes.lagging import Response, behind, further
from veo_ti.diagnosis.causes.swings import Creep, Swings
from veo_ti.diagnosis.scene import Scene

_RATIOS = (0.02, 0.07, 0.2, 0.6)
_SLOW = 4  # vibrations, one of which leads most: by it two laws of damping are compared
_RINGS = 0.7  # damping ratio below which an object has a resonance (1 / sqrt 2)
_LAWS = {0: "the same for all vibrations", -1: "less for fast ones, as in air", 1: "more for fast ones, as in rubber"}

_TUNED = 0.05 * np.arange(-30, 31)  # log stiffness over mass, beside that of the scene, at which vibrations are tried
_FAR = 3.0  # nats, that a stiffness is tried beyond the scene's at most
_UNKNOWN = 3.0  # times as far where the scale of the forces, and so that of the stiffness, is not known
_WEIGHED = 0.2  # of the mass, that the linear vibrations of a large motion may be off by
_ANY = 30.0  # of the mass: what a share may be in such units


@dataclass(frozen=True, kw_only=True)
class Ring:
    """How an object rings: at its own stiffness, or in step with what is seen if it were `stiffer` [nats]."""

    ratio: float  # damping ratio of the slowest vibration
    power: int  # of frequency, by which the others' go
    share: float = 1.0  # of the mass, with which that is so
    stiffer: float = 0.0
    smooth: bool = True  # how the motion that it follows goes on between frames: else linearly
    swings: Swings | None = field(default=None, compare=False)  # what the full simulation adds, once it was asked

    @property
    def slower(self) -> float:
        """Times its mass, with which it is as slow in small vibrations as in those it makes."""
        return 1.0 if self.swings is None else self.swings.slower


class Inertia(Cause):
    """M y'' joins the balance of forces: what the lowest vibrations add to the quasi-static motion.

    The damping ratio of a vibration is that of the slowest times `(omega / omega_1)^p`: p = 1 where a drag on the
    material's rate of strain damps, -1 where a drag on velocity does (Rayleigh's two terms), 0 between.
    """

    name = "inertia"
    sentence = "Inertia matters at this speed: the object lags behind its load and rings after it."
    parameters = (Parameter(name="share", unit="of the mass", sd=1.0, positive=True),)
    needs_mass = True
    over_time = "a motion"

    def known(self, place: Ring) -> np.ndarray:
        """The object was weighed."""
        return np.array([place.share])

    def widths(self, scene: Scene) -> np.ndarray:
        """All of the mass; any number where forces, and so what moves the mass, are known up to scale only."""
        return np.array([1.0 if scene.observation.force_scale_known else _ANY])

    def places(self, scene: Scene) -> Sequence[Ring]:
        """Damping ratios of the slowest vibration, how those of the others go with frequency, and each in step.

        A fit without inertia gets the stiffness wrong; a vibration that is out of step by half a period shows no way
        to the right one.
        """
        here = [Ring(ratio=ratio, power=power) for power in _LAWS for ratio in _RATIOS]
        return here + _in_step(scene, here)

    def near(self, scene: Scene, place: Ring) -> Sequence[Ring]:
        """Damping ratios in between, and other laws that damp one of the slowest vibrations as much; what does not ring
        is damping. Then the other way between frames."""
        stretch = scene.vibrations.omega[:_SLOW] / scene.vibrations.omega[0]
        laws = [(stretch ** (place.power - power), power) for power in _LAWS if power != place.power]
        ways = [((0.5, 0.7, 1.4, 2.0), place.power), *laws]
        rings = [replace(place, ratio=place.ratio * f, power=power) for factors, power in ways for f in factors]
        return [*(ring for ring in rings if ring.ratio < _RINGS), replace(place, smooth=not place.smooth)]

    def courses(self, scene: Scene, place: Ring) -> Sequence[Course]:
        """Of damping ratios."""
        return (lambda at, steps: replace(at, ratio=min(scaled(at.ratio, steps), _RINGS)),)

    def measures(self, place: Ring) -> Sequence[Measure]:
        """The damping ratio."""
        return (Measure("damping_ratio", "-", place.ratio, scale=True),)

    def begin(self, place: Ring) -> tuple[Ring, float]:
        """The object is made stiffer, and rings at its own stiffness."""
        return replace(place, stiffer=0.0), place.stiffer

    def plausible(self, scene: Scene, theta: np.ndarray, spread: np.ndarray) -> bool:
        """A mass that was weighed is not off by more than the linear vibrations may be."""
        return bool(abs(theta[0] - 1) < _WEIGHED if scene.observation.force_scale_known else theta[0] > 0)

    def change(self, scene: Scene, theta: np.ndarray, place: Ring) -> Change:
        """Linear about the rest shape, exact in time for loads that go on between frames as the place has it."""
        if place.stiffer == 0:
            beyond = 0.0 if place.swings is None else theta[0] / place.swings.share * place.swings.beyond
            return behind(scene, scene.vibrations, _lag(theta[0], place), beyond)
        modes, u, less = scene.vibrations, scene.y - scene.cloud.x, np.exp(-place.stiffer)
        omega = modes.omega / np.sqrt(less)
        lagging = _lag(theta[0], place)(less * modes.coordinates(u), scene.time, omega, omega[0])
        added = theta[0] / place.share * (less - 1) * u + modes.motion(lagging)
        return Change(observe=lambda y, frames: y + added[frames])

    def carried(self, scene: Scene, theta: np.ndarray, place: Ring) -> Carried:
        """The lag of the change, and what other frequencies do to the lag."""
        return further(scene, scene.vibrations, _lag(theta[0], place))

    def closer(self, scene: Scene, theta: np.ndarray, place: Ring) -> tuple[Ring, np.ndarray] | None:
        """What the full simulation adds to the linear vibrations, and the share that is then as slow."""
        omega = scene.vibrations.omega
        swings = Swings.of(scene, float(theta[0]), _ratios(omega, omega[0], place), smooth=place.smooth)
        return None if swings is None else (replace(place, swings=swings), theta * place.slower / swings.slower)

    def elsewhere(self, scene: Scene, place: Ring) -> Ring:
        """As small vibrations go."""
        return replace(place, swings=None)

    def describe(self, scene: Scene, place: Ring) -> str:
        """The slowest vibration and its damping ratio, and how the others are damped."""
        slowest = scene.vibrations.omega[0] * np.exp(place.stiffer / 2) / (2 * np.pi)
        return f"with a slowest vibration of {slowest:.3g} Hz, damping ratio {place.ratio:.2g}, {_LAWS[place.power]}"


@dataclass(frozen=True, kw_only=True)
class Flow:
    """How an object is dragged: as the motion that it follows goes on between frames, smoothly or linearly."""

    smooth: bool = True
    creep: Creep | None = field(default=None, compare=False)  # what the full simulation adds, once it was asked


class Damping(Cause):
    """f_i = -c V_i v_i."""

    name = "damping"
    sentence = "The surroundings resist the motion in proportion to its speed."
    parameters = (Parameter(name="drag", unit="N s/m4", sd=1e3, positive=True),)
    over_time = "a motion"

    def widths(self, scene: Scene) -> np.ndarray:
        """A drag of a fifth of the largest load when motion is fastest."""
        velocity = np.gradient(scene.y, scene.time, axis=0)
        flow = np.linalg.norm(np.einsum("n,tna->tna", scene.cloud.volume, velocity), axis=2).sum(axis=1)
        return np.array([0.2 * scene.largest_force / max(float(flow.max()), 1e-300)])

    def places(self, scene: Scene) -> Sequence[Flow]:
        """One, smooth between frames."""
        return (Flow(),)

    def near(self, scene: Scene, place: Flow) -> Sequence[Flow]:
        """The other way between frames."""
        return (Flow(smooth=not place.smooth),)

    def change(self, scene: Scene, theta: np.ndarray, place: Flow) -> Change:
        """Linear about the rest shape, exact in time for loads that go on between frames as the place has it."""
        beyond = 0.0 if place.creep is None else theta[0] / place.creep.drag * place.creep.beyond
        return behind(scene, scene.relaxations, _delay(theta[0], place), beyond)

    def carried(self, scene: Scene, theta: np.ndarray, place: Flow) -> Carried:
        """The delay of the change, and what another stiffness does to the delay."""
        return further(scene, scene.relaxations, _delay(theta[0], place))

    def closer(self, scene: Scene, theta: np.ndarray, place: Flow) -> tuple[Flow, np.ndarray] | None:
        """What the full simulation adds to the linear response."""
        creep = Creep.of(scene, float(theta[0]), smooth=place.smooth)
        return None if creep is None else (replace(place, creep=creep), theta)

    def elsewhere(self, scene: Scene, place: Flow) -> Flow:
        """As small motions go."""
        return replace(place, creep=None)


def _lag(share: float, place: Ring) -> Response:
    def response(p: np.ndarray, time: np.ndarray, omega: np.ndarray, slowest: float) -> np.ndarray:
        ratios = _ratios(omega, slowest, place)
        return lag(omega, p, time, inertia=share * place.slower, damping=ratios, smooth=place.smooth)

    return response


def _ratios(omega: np.ndarray, slowest: float, place: Ring) -> np.ndarray:
    """The damping ratio of every vibration, of the shape of omega."""
    return place.ratio * (omega / slowest) ** place.power


def _in_step(scene: Scene, rings: Sequence[Ring]) -> list[Ring]:
    """Each at the stiffness (and, where the scale of forces is free, the mass) that leaves least, to first order."""
    modes, known, seen = scene.vibrations, scene.observation.force_scale_known, _Seen.of(scene)
    tuned = _TUNED if known else _UNKNOWN * _TUNED
    omega, p = np.exp(tuned / 2)[:, None] * modes.omega, modes.coordinates(scene.y - scene.cloud.x)
    found = []
    for ring in rings:
        ratios = _ratios(modes.omega, modes.omega[0], ring)
        x = follow(omega, ratios, p[:, None], scene.time, smooth=ring.smooth)
        slope, curve = seen.parabola(x - p[:, None])
        kappa = np.exp(-tuned) if known else np.clip(slope / curve, np.exp(-_FAR), np.exp(_FAR))
        best = int(np.argmin(curve * kappa**2 - 2 * slope * kappa))
        share = 1.0 if known else float(np.exp(-tuned[best]) / kappa[best])
        found.append(replace(ring, share=share, stiffer=-float(np.log(kappa[best]))))
    return [ring for ring in found if ring.stiffer != 0]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen:
    """What an object of 1/kappa times the stiffness leaves: `|r + u - kappa (u + Phi q)|^2` over all that was seen.

    It moves kappa times as much, u, and lags kappa times as far behind in its vibrations' coordinates, q (T, K).
    """

    gram: np.ndarray  # Phi^T Phi, (T, K, K)
    slow: np.ndarray  # Phi^T u, (T, K)
    whole: np.ndarray  # Phi^T (u + r), (T, K)
    slow_slow: float
    slow_whole: float

    @classmethod
    def of(cls, scene: Scene) -> "_Seen":
        """From the frames that train."""
        seen = np.repeat(scene.target.seen & scene.train[:, None], 3, axis=1)
        u, r = (seen * v.reshape(len(seen), -1) for v in (scene.y - scene.cloud.x, scene.residual))
        shapes = scene.vibrations.shapes.reshape(len(scene.vibrations.omega), -1)
        gram = np.stack([(shapes * row) @ shapes.T for row in seen])
        return cls(gram=gram, slow=u @ shapes.T, whole=(u + r) @ shapes.T, slow_slow=(u**2).sum(),
                   slow_whole=(u * (u + r)).sum())  # fmt: skip

    def parabola(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """B and A (C,) of `A kappa^2 - 2 B kappa + const` for each of q (T, C, K)."""
        curve = np.einsum("tck,tkl,tcl->c", q, self.gram, q, optimize=True)
        curve += self.slow_slow + 2 * np.einsum("tck,tk->c", q, self.slow)
        return self.slow_whole + np.einsum("tck,tk->c", q, self.whole), curve


def _delay(drag: float, place: Flow) -> Response:
    return lambda p, time, omega, slowest: delay(omega, p, time, drag=drag, smooth=place.smooth)
