"""What a fit found, and what that is worth."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from sim.evidence import Normal, left_out, posterior
from sim.newton import equilibrate
from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.causes.beside import Beside
from veo_ti.diagnosis.model import Model, change_of, shown_by
from veo_ti.diagnosis.moments import Fingerprints
from veo_ti.diagnosis.problem import Line
from veo_ti.diagnosis.scene import Scene
from veo_ti.diagnosis.solved import NEWTON, Solved

OURS = 0.06  # of a parameter, by which it is off against finite elements beyond its sd (docs/diagnosis_method.md)
_EXACTLY = 0.02  # instead of that, of what an exact cause does


@dataclass(frozen=True, kw_only=True, eq=False)
class Placed:
    """How unsure parameters are, and the place along its courses, together."""

    covariance: np.ndarray  # (d, d)
    steps: np.ndarray  # (c, c)
    nats: float = 0.0  # that what the simulation gets wrong may be worth, which may look like another place
    elsewhere: tuple[tuple[Any, np.ndarray], ...] = ()  # others that are as likely but for that, with theta (d,) there

    def part(self, which: int, own: slice, on: slice) -> "Placed":
        """Of one of two causes."""
        elsewhere = tuple((place[which], theta[own]) for place, theta in self.elsewhere)
        return replace(self, covariance=self.covariance[own, own], steps=self.steps[on, on], elsewhere=elsewhere)


@dataclass(frozen=True, kw_only=True, eq=False)
class Refit:
    """The most probable parameters of a cause (None: of the baseline) and what they are worth."""

    cause: Cause | None
    place: Any
    theta: np.ndarray  # (d,)
    sd: np.ndarray  # (d,), of the posterior or of leaving out runs of frames, whichever is larger
    covariance: np.ndarray  # (d, d) of the posterior
    scene: Scene  # under the extended energy
    without: Scene  # the same motion, before the cause joined the energy
    coefficients: np.ndarray  # (K + E,), material and discretisation
    normal: Normal  # the data linearised at the end
    prior: np.ndarray  # (K + E + d,) variances of all unknowns
    around: np.ndarray  # (K + E + d,) the unknowns there; zero for the discretisation, which the residual still holds
    cost: float  # minus the log posterior, and
    short: float  # nats of it that a further step promises; infinite where nothing can be said
    converged: bool
    numerics: np.ndarray  # (T, N, 3) [m], the discretisation's part
    line: Line  # the fingerprints, and
    told: Solved  # which motion they are of: the last one, or one before
    placed: Placed | None = None  # how unsure all is where a place along courses is as well
    whole: "Refit | None" = None  # of two causes, where this is one of them

    @property
    def kept(self) -> Fingerprints:
        """The columns of all unknowns."""
        return self.line.kept

    def serves(self, scene: Scene) -> bool:
        """Whether a fit of the same cause that goes on in this scene can begin with these fingerprints."""
        return np.array_equal(self.scene.target.seen, scene.target.seen)

    @property
    def spread(self) -> np.ndarray:
        """Standard deviations (d,) with what the simulation itself gets wrong, which is 6 % of what the cause does.

        `sd^2 + 0.06^2 (theta^T C^-1 theta) C_ii` with C the posterior covariance, of any scale: 0.06 |theta| for a
        single parameter, and far more of one that hardly shows, since that much of any motion may look like it; and
        how unsure it is because the place is, where that was asked for (`off_place`).
        """
        if isinstance(self.cause, Beside):
            return np.concatenate([one.spread for one in self.apart()])
        known = self.beside_ours(self.sd)
        if self.placed is None:
            return known
        more = np.diagonal(self.placed.covariance - self.covariance).clip(min=0)
        return np.sqrt(known**2 + self.off_place * more)

    @property
    def off_place(self) -> float:
        """How many times the variance of its place by noise alone is that with what the simulation gets wrong."""
        return 1 + 2 * max(OURS**2 * self.worth, self.placed.nats)

    @property
    def interval(self) -> tuple[np.ndarray, np.ndarray]:
        """The ends (d,) of 95 % intervals, which hold the parameters at other places that are as likely."""
        low, high = self.cause.interval(self.theta, self.spread)
        others = [] if self.placed is None else [theta for _, theta in self.placed.elsewhere]
        return np.min([low, *others], axis=0), np.max([high, *others], axis=0)

    def beside_ours(self, sd: np.ndarray) -> np.ndarray:
        """The standard deviations sd (d,) with what the simulation itself gets wrong, of one cause."""
        return np.hypot(sd, OURS * np.sqrt(2 * self.worth * np.diagonal(self.covariance)))

    @property
    def worth(self) -> float:
        """Nats that the parameters are worth, to second order: `theta^T C^-1 theta / 2`."""
        return float(self.theta @ np.linalg.solve(self.covariance, self.theta)) / 2

    def certain(self, nats: float = 0.0) -> bool:
        """Whether the 95 % interval of one parameter, or the region of all, leaves out that there is no effect; of two
        causes those of the second one.

        Those of a turned jet may hide each other, so that each could be zero, but not all (seed 7585). nats: what it
        costs that the cause is absent, if that is known. Where its effect saturates, as with how stiff an obstacle is,
        that is far more than `worth`, and the interval on that side so much shorter.
        """
        own = self.apart()[-1]
        sd = own.sd / np.sqrt(max(1.0, nats / max(own.worth, 1e-300)))
        wider = max(1.0, float((sd**2 / np.diagonal(own.covariance)).max()))
        together = 2 * own.worth / (wider + 2 * OURS**2 * own.worth)
        alone = np.abs(own.theta) > 1.96 * own.beside_ours(sd)
        return bool(alone.any() or together > chi2.ppf(0.95, len(sd)))

    def evidence(self, s2: float) -> float:
        """Laplace's log evidence at a variance of the noise [m2], up to a constant common to all causes."""
        return posterior(self.normal, self.prior, np.sqrt(s2)).evidence

    def tuned(self, model: Model, s2: float) -> "Refit":
        """The same under the material's prior of highest evidence: what was wrong before may have kept it too stiff."""
        return replace(self, prior=model.tuned(self.normal, self.prior, s2))

    def used(self, s2: float) -> float:
        """Effective number of fitted parameters at a variance of the noise [m2]."""
        return float((posterior(self.normal, self.prior, np.sqrt(s2)).covariance * self.normal.A).sum() / s2)

    def left_out(self, s2: float, blocks: int) -> float:
        """Squared error [m2] of all training blocks, each predicted by the others, linearised at the end of the fit."""
        residual = self.scene.target.residual(self.simulated)
        parts = self.kept.parts(residual, self.scene.target.seen, self.around, blocks)
        return float(left_out(parts, self.prior, np.sqrt(s2)).sum())

    def apart(self) -> tuple["Refit", ...]:
        """One for each cause where there are two, with the parameters that they have together."""
        if not isinstance(self.cause, Beside):
            return (self,)
        n, first = len(self.coefficients), len(self.cause.found.courses(self.without, self.place[0]))
        parts = zip((0, 1), self.cause.parts, self.place, (slice(first), slice(first, None)), strict=True)
        return tuple(
            replace(
                self, cause=cause, place=at, theta=self.theta[own], sd=self.sd[own],
                covariance=self.covariance[own, own],
                placed=None if self.placed is None else self.placed.part(which, own, on),
                prior=np.concatenate([self.prior[:n], self.prior[n:][own]]), whole=self,
            )
            for which, (cause, own), at, on in parts
        )  # fmt: skip

    def taken_in(self) -> "Refit":
        """The same with the cause as part of model, loads and observation, so that the next one stands alone."""
        scene = self.scene if self.cause is None else self.cause.told(self.scene, self.theta, self.place)
        target = replace(scene.target, y=scene.target.y - (self.simulated - scene.y))
        n, theta, given = len(self.coefficients), self.theta, self.normal
        b = given.b[:n] - given.A[:n, n:] @ theta
        c = given.c - 2 * given.b[n:] @ theta + theta @ given.A[n:, n:] @ theta
        normal = Normal(A=given.A[:n, :n], b=b, c=float(c), count=given.count)
        return replace(
            self, scene=replace(scene, target=target), cause=None, theta=np.zeros(0), sd=np.zeros(0),
            covariance=np.zeros((0, 0)),
            normal=normal, prior=self.prior[:n], around=self.around[:n], line=self.line.first(n),
        )  # fmt: skip

    @property
    def left(self) -> Scene:
        """The scene whose residual is all that the prediction leaves, the discretisation's part taken in as well."""
        target = replace(self.scene.target, y=self.scene.target.y - (self.shown - self.scene.y))
        return replace(self.scene, target=target)

    @property
    def simulated(self) -> np.ndarray:
        """Simulated positions as tracking would show them, (T, N, 3) [m]."""
        return shown_by(self.scene, change_of(self.scene, self.cause, self.theta, self.place))

    @property
    def shown(self) -> np.ndarray:
        """The prediction: simulated positions corrected by the discretisation's part, (T, N, 3) [m]."""
        return self.simulated + self.numerics


def ours_of(*found: Refit) -> float:
    """Share of what any of some causes does, by which our simulation of it may be off."""
    return _EXACTLY if all(one.cause.exact for one in found) else OURS


def everywhere(found: Refit) -> Refit:
    """A fit with the frames in equilibrium as well that did not train, as far as they have one."""
    scene, frames = found.scene, np.flatnonzero(~found.scene.train)
    if len(frames) == 0 or (found.cause is not None and found.cause.spans):
        return found
    there = equilibrate(scene.energy.frames(frames), scene.y[frames], options=replace(NEWTON, iterations=60))
    y = scene.with_frames(frames, there.y)
    return replace(found, scene=scene.moved(scene.energy, y), without=found.without.moved(found.without.energy, y))
