"""The measurement that would tell two causes apart, chosen by predicted separation over a small library of loads."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sim.energy import Energy
from sim.newton import equilibrate
from sim.terms.loads import AppliedForce
from veo_ti.diagnosis.columns import directions_of
from veo_ti.diagnosis.fitted import Refit
from veo_ti.diagnosis.model import Model
from veo_ti.diagnosis.moments import moments
from veo_ti.diagnosis.scene import Scene
from veo_ti.diagnosis.solved import NEWTON

_UP = np.array([0, 0.25, 0.5, 0.75, 1.0])


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """description; nats by which the two causes differ in what was measured, and with this measurement added."""

    description: str
    now: float
    then: float


def separating(current: Refit, first: Refit, second: Refit, model: Model, s2: float) -> Experiment | None:
    """The load of the library that separates two refitted causes best, or None where no force is named.

    `lambda_ab = |S_a theta_a|^2` in the metric in which material, discretisation and cause b are projected out
    (T-optimal design); the expected difference in evidence is half of it, and the smaller of the two directions counts.
    Linear about the fitted baseline; each measurement is taken as one of its own, that starts at rest.
    """
    if not current.scene.forces.any():
        return None
    done = _information(current.scene, current, (first, second), model)
    now = _apart(done, first, second, model, s2)
    best = None
    for description, scene in _library(current.scene):
        found = _apart(done + _information(scene, current, (first, second), model), first, second, model, s2)
        if best is None or found > best.then:
            best = Experiment(description=description, now=now, then=found)
    return best


def _library(scene: Scene) -> Iterator[tuple[str, Scene]]:
    """Loads made from the strongest one that was measured, each with the equilibria that the baseline predicts."""
    strongest = int(scene.total_force.argmax())
    force, step = scene.forces[strongest], scene.interval
    there_and_back = np.concatenate([_UP, _UP[-2::-1]])
    held = np.array([0.0, 1, 1, 1, 1, 0, 0, 0])
    name = f"the load of frame {strongest}"
    for description, course, pace in (
        (f"{name} in four steps up and down again", there_and_back, 1.0),
        (f"{name} up and down again, five times as fast", there_and_back, 0.2),
        (f"{name} up and down again at half its strength", 0.5 * there_and_back, 1.0),
        (f"{name} up and down again at one and a half times its strength", 1.5 * there_and_back, 1.0),
        (f"{name} from the opposite side, up and down again", -there_and_back, 1.0),
        (f"{name} switched on, held for {40 * step:.3g} s, switched off and watched as long", held, 10.0),
    ):
        made = _under(scene, course[:, None, None] * force, pace * step * np.arange(len(course)))
        if made is not None:
            yield description, made


def _under(scene: Scene, forces: np.ndarray, time: np.ndarray) -> Scene | None:
    """The object under other forces (T, N, 3) [N]; None where an equilibrium is not found."""
    frames, rest = len(time), scene.cloud.x
    bare = Energy(
        elastic=scene.energy.elastic, terms=(AppliedForce(force=forces),), fixed=scene.energy.fixed | _led(scene)
    )
    found = equilibrate(bare, np.repeat(rest[None], frames, axis=0), options=NEWTON)
    if not found.converged:
        return None
    observation = replace(
        scene.observation, points=found.y, forces=forces, time=time, jet=None, sigma=None,
        observed=np.ones((frames, len(rest)), bool),
    )  # fmt: skip
    seen = np.repeat(scene.target.seen.any(axis=0)[None], frames, axis=0)
    target = replace(scene.target, y=found.y, seen=seen)
    return Scene(observation=observation, energy=bare, y=found.y, target=target, train=np.ones(frames, bool))


def _led(scene: Scene) -> np.ndarray:
    return np.asarray(scene.observation.handles, bool)


def _information(scene: Scene, current: Refit, pair: tuple[Refit, Refit], model: Model) -> np.ndarray:
    """Inner products (M, M) of the columns of material, discretisation (zero where not at hand) and both causes."""
    K, n = model.basis.log_mu.shape[1], len(model.prior)
    extra = model.extra if scene is current.scene else ()
    directions = [d for one in pair for d in directions_of(one.cause, scene, one.cause.elsewhere(scene, one.place))]
    A = moments(scene, model.basis, current.around[:K], extra, directions).normal.A
    out = np.zeros((n + len(directions),) * 2)
    rows = np.concatenate([np.arange(K + len(extra)), np.arange(n, n + len(directions))])
    out[np.ix_(rows, rows)] = A
    return out


def _apart(A: np.ndarray, first: Refit, second: Refit, model: Model, s2: float) -> float:
    """Expected nats of evidence between the two, in the harder of the two directions."""
    n, d = len(model.prior), len(first.theta)
    own, other = np.arange(n, n + d), np.arange(n + d, len(A))
    ways = ((own, first, other, second), (other, second, own, first))
    return min(_gap(A, i, a.theta, j, b.prior[n:], model, s2) for i, a, j, b in ways)


def _gap(
    A: np.ndarray, own: np.ndarray, theta: np.ndarray, other: np.ndarray, widths: np.ndarray, model: Model, s2: float
) -> float:
    rest = np.concatenate([np.arange(len(model.prior)), other])
    precision = A[np.ix_(rest, rest)] + s2 * np.diag(1 / np.concatenate([model.prior, widths]))
    cross = A[np.ix_(rest, own)] @ theta
    return float(theta @ A[np.ix_(own, own)] @ theta - cross @ np.linalg.solve(precision, cross)) / (2 * s2)
