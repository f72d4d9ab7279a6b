"""Where a fit is, and the way that its fingerprints tell from there."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sim.evidence import Normal, Posterior, jackknife, posterior
from veo_ti.diagnosis.fitted import Refit
from veo_ti.diagnosis.problem import Line, Problem, farthest
from veo_ti.diagnosis.scene import Scene
from veo_ti.diagnosis.solved import Solved, solved

LEAST = 0.5  # predicted gain [nats] below which a fit is done
SHARE = 1e-3  # of the cost, likewise
_ALL = 1.1  # of the cost, which is a sum of squares: more gain than that is none
_PARTS = 8  # runs of frames that are left out in turn to see how sure a parameter is
_T = 2.36 / 1.96  # Student's 97.5 % quantile with seven degrees of freedom over the normal one
_HOLDS, _HALVINGS = (-12.0, 9.0), 24  # decades of the curvature that may hold the material back; how often halved
_STATE = ("y", "coefficients", "theta")


def cost_of(problem: Problem, state: Solved) -> float:
    """Minus the log posterior; infinite where an equilibrium that counts was not found."""
    return problem.cost(state.scene, state.coefficients, state.theta) if state.found else np.inf


@dataclass(frozen=True, kw_only=True, eq=False)
class Way:
    """From a state to the most probable unknowns of its linearisation, as far as they can go."""

    normal: Normal
    found: Posterior
    whole: np.ndarray  # change of all unknowns, were there room for it
    curvature: np.ndarray  # of the cost
    room: np.ndarray  # the largest change of each
    log_mu: np.ndarray  # (N, K) that the first unknowns add

    @classmethod
    def of(cls, line: Line, state: Solved) -> "Way":
        """By fingerprints of this state or of one nearby."""
        s2, prior = line.problem.model.s2, line.problem.prior
        normal = line.normal(state.scene, state.coefficients, state.theta)
        found = posterior(normal, prior, np.sqrt(s2))
        whole = found.mean - np.concatenate([state.coefficients, state.theta])
        curvature, room = normal.A / s2 + np.diag(1 / prior), line.problem.room(state.theta)
        log_mu = line.problem.model.basis.log_mu
        return cls(normal=normal, found=found, whole=whole, curvature=curvature, room=room, log_mu=log_mu)

    @cached_property
    def change(self) -> np.ndarray:
        """Of all unknowns: where one has no room for all of it, the others do what is best beside that."""
        return self._possible(self.whole, self.curvature)

    @cached_property
    def gain(self) -> float:
        """Nats that it promises."""
        return self.promised(self.change)

    def broken(self, cost: float) -> bool:
        """Whether it promises more than there is: next to an instability fingerprints have no digit left."""
        return not self.gain <= _ALL * cost

    def at(self, problem: Problem, state: Solved) -> np.ndarray:
        """The coefficients (K + E,) of the state, with the discretisation's part that is most probable beside them.

        That of the linear optimum belongs to another material, and may be far off beside this one.
        """
        own, unknowns = slice(problem.materials, len(state.coefficients)), np.append(state.coefficients, state.theta)
        left = (self.normal.b / problem.model.s2 - self.curvature @ unknowns)[own]
        unknowns[own] += np.linalg.solve(self.curvature[own, own], left)
        return unknowns[: len(state.coefficients)]

    def damped(self, damping: float, most: float = np.inf) -> np.ndarray:
        """The step of a curvature with so much more of its diagonal; changes of the material are held back until none
        of log mu is over `most`, so that a region which would change far shortens nothing else."""
        diagonal = damping * np.diag(np.diagonal(self.curvature))
        step = self._held_by(diagonal) if damping else self.change
        if farthest(self.log_mu, step) <= most:
            return step
        K, field = self.log_mu.shape[1], np.zeros_like(self.curvature)
        field[:K, :K] = self.log_mu.T @ self.log_mu
        field *= np.trace(self.curvature[:K, :K]) / np.trace(field)
        low, high = _HOLDS
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            step = self._held_by(diagonal + 10**middle * field)
            low, high = (middle, high) if farthest(self.log_mu, step) > most else (low, middle)
        return self._held_by(diagonal + 10**high * field)

    def bent(self, step: np.ndarray, there: Normal, s2: float) -> np.ndarray:
        """A step with what its end asks for beyond it, `r(x + v) = r - X v + r_vv / 2`: what further ones can take up
        of r_vv; there: the data at its end, linearised by the same fingerprints."""
        return step + np.linalg.solve(self.curvature, (there.b - self.normal.b) / s2)

    def _held_by(self, more: np.ndarray) -> np.ndarray:
        """The step of a curvature with so much more."""
        curvature = self.curvature + more
        return self._possible(np.linalg.solve(curvature, self.curvature @ self.whole), curvature)

    def _possible(self, step: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        held = step > self.room
        if not held.any():
            return step
        lost, free = step[held] - self.room[held], ~held
        step = np.where(held, self.room, step)
        step[free] += np.linalg.solve(curvature[np.ix_(free, free)], curvature[np.ix_(free, held)] @ lost)
        return step

    def promised(self, step: np.ndarray) -> float:
        """Nats by another step."""
        return self.slope(step) - float(0.5 * step @ self.curvature @ step)

    def slope(self, step: np.ndarray) -> float:
        """Nats by it to first order."""
        return float(step @ self.curvature @ self.whole)


@dataclass(frozen=True, kw_only=True, eq=False)
class Reached:
    """A state, and fingerprints of it or of one before."""

    state: Solved
    line: Line
    told: Solved  # which they are of, without its factors, which take much room

    @classmethod
    def of(cls, problem: Problem, state: Solved) -> "Reached":
        """With fresh fingerprints."""
        line = problem.linearised(state.scene, state.coefficients, state.theta)
        return cls(state=state, line=line, told=replace(state, factors=None))

    @classmethod
    def onward(cls, problem: Problem, state: Solved, found: Refit) -> "Reached":
        """With the fingerprints of a fit of the same cause that ended nearby."""
        return cls(state=state, line=replace(found.line, problem=problem), told=found.told)

    @classmethod
    def again(cls, problem: Problem, scene: Scene, arrays: Mapping[str, np.ndarray]) -> "Reached":
        """From its arrays, for the effort that was spent then."""

        def there(name: str) -> Solved:
            y, coefficients, theta = (arrays[f"{name}_{part}"] for part in _STATE)
            return solved(problem, scene.moved(problem.energy(coefficients), y), coefficients, theta)

        found = replace(cls.of(problem, there("told")), state=there("state"))
        problem.model.effort.spent = float(arrays["spent"])
        return found

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """What that takes."""
        found = {"spent": np.array(self.line.problem.model.effort.spent)}
        for name, at in (("state", self.state), ("told", self.told)):
            found |= dict(zip([f"{name}_{p}" for p in _STATE], [at.scene.y, at.coefficients, at.theta], strict=True))
        return found

    @cached_property
    def way(self) -> Way:
        """On from here."""
        return Way.of(self.line, self.state)

    @property
    def result(self) -> Refit:
        """What a fit that ends here found."""
        state, problem, way = self.state, self.line.problem, self.way
        n = len(state.coefficients)
        around, residual = problem.around(state.coefficients, state.theta), problem.residual(state.scene, state.theta)
        parts = self.line.kept.parts(residual, state.scene.target.seen, around, _PARTS)
        unsure = _T * jackknife(parts, problem.prior, np.sqrt(problem.model.s2))
        sd, cost = np.maximum(np.sqrt(np.diagonal(way.found.covariance)), unsure), cost_of(problem, state)
        broken = way.broken(cost)
        best = state.coefficients if broken else way.at(problem, state)
        return Refit(
            cause=problem.cause, place=problem.place, theta=state.theta, sd=sd[n:],
            covariance=way.found.covariance[n:, n:], scene=state.scene, without=state.without, coefficients=best,
            normal=way.normal, prior=problem.prior, around=around, cost=cost,
            short=np.inf if broken else way.gain, converged=way.gain < max(LEAST, 2 * SHARE * cost),
            numerics=problem.numerics(best), line=self.line, told=self.told,
        )  # fmt: skip
