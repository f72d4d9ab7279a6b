"""The fit beside Adam: how many equilibria each solves until the loss is down at the noise."""

import time
from dataclasses import dataclass, field
from unittest import mock

import numpy as np

import sim.fit
from benchmarks import scene
from benchmarks.table import Row
from sim.adam import fit_adam
from sim.basis import FitOptions
from sim.energy import Energy
from sim.fit import FitState, fit, guess_modulus
from sim.lame import Lame
from sim.newton import equilibrate
from sim.target import Target

_NOISE = 0.01  # spacings: a good tracker
_FORCE = 4000.0  # [N], moves the free end by an eighth of the bar's length
_CLOSE = 1.2  # the loss counts as down at the noise when it is below this many times count sigma^2
_RATE = 0.1  # of Adam; with 0.05 and 0.2 it is slower, or no faster to speak of


@dataclass(kw_only=True)
class _Course:
    """Loss over the noise floor after every solve of all frames, or outer iteration, and when it came down."""

    floor: float
    limit: int
    begin: float = field(default_factory=time.perf_counter)
    losses: list[float] = field(default_factory=list)
    seconds: float = 0.0

    def proceed(self, loss: float) -> bool:
        """Note a loss; whether to go on."""
        self.losses.append(loss / self.floor)
        self.seconds = time.perf_counter() - self.begin
        return not self.down and len(self.losses) < self.limit

    @property
    def down(self) -> bool:
        return self.losses[-1] <= _CLOSE


def fit_rows(points: int, frames: int, limit: int) -> list[Row]:
    """Outer iterations of ours, and Adam over ours in solves and in time; Adam stops after `limit` solves."""
    energy, target = problem(points, frames)
    start, floor = scene.at_rest(energy, frames), target.count * target.sigma**2
    ours, solves = _ours(energy, target, start, floor)
    theirs = _Course(floor=floor, limit=limit)
    fit_adam(energy, target, start, rate=_RATE, newton=FitOptions().newton, proceed=theirs.proceed)
    outer, count, slower = len(ours.losses), len(theirs.losses) / solves, theirs.seconds / ours.seconds
    begin = f"from {theirs.losses[0]:.1f} x" if ours.down else f"missed: down to {ours.losses[-1]:.2f} x only"
    more, note = ("", "") if theirs.down else ("> ", f", given up at {theirs.losses[-1]:.2f} x")
    size = f"Fit, {energy.elastic.cloud.count} points x {frames} frames, noise {_NOISE} spacing, to {_CLOSE} x its loss"
    return [
        Row(what=f"{size}: outer iterations", figure=f"{outer} ({begin})", target="<= 15",
            reached=ours.down and outer <= 15),
        Row(what=f"{size}: equilibria that Adam solves over ours", target=">= 5 x", reached=ours.down and count >= 5,
            figure=f"{more}{count:.1f} x ({len(theirs.losses)}{note}, over {solves})"),
        Row(what=f"{size}: time of Adam over ours",
            figure=f"{more}{slower:.1f} x ({theirs.seconds:.1f} s over {ours.seconds:.1f} s)"),
    ]  # fmt: skip


def problem(points: int, frames: int) -> tuple[Energy, Target]:
    """A bar seen with noise, its half at the free end five times softer; the energy has the first guess as material."""
    energy = scene.bar(points, frames, force=_FORCE)
    cloud = energy.elastic.cloud
    truth = Lame.from_young(scene.YOUNG * np.where(cloud.x[:, 0] < scene.SIZE[0] / 2, 5.0, 1.0), scene.POISSON)
    true = energy.with_elastic(energy.elastic.with_parameters(np.stack([truth.mu, truth.lam], axis=1)))
    y = equilibrate(true, scene.at_rest(energy, frames)).require_converged().y
    sigma = _NOISE * cloud.spacing
    seen = np.repeat(~energy.fixed[None], frames, axis=0)
    noise = sigma * np.random.default_rng(0).standard_normal(y.shape)
    target = Target(y=y + noise, seen=seen, sigma=sigma)
    mu = guess_modulus(energy, target)
    ratio = 2 * scene.POISSON / (1 - 2 * scene.POISSON)
    guess = np.tile([mu, ratio * mu], (cloud.count, 1))
    return energy.with_elastic(energy.elastic.with_parameters(guess)), target


def _ours(energy: Energy, target: Target, start: np.ndarray, floor: float) -> tuple[_Course, int]:
    """The course up to where it came down, and the solves that took."""
    course, solves = _Course(floor=floor, limit=100), []

    def progress(state: FitState) -> None:
        if not course.losses or not course.down:
            course.proceed(target.loss(state.y)[0])
            solves.append(counted.call_count)

    with mock.patch.object(sim.fit, "equilibrate", wraps=equilibrate) as counted:
        fit(energy, target, start, mu=float(energy.elastic.m[0, 0]), progress=progress)
    return course, solves[-1]
