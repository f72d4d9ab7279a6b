"""The force that is missing: the smallest one on the free surface that explains what the material cannot."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from sim.basis import Basis
from sim.lame import Lame
from sim.runtime import serial_blas
from sim.sensitivity import parameter_forces, responses
from veo_ti.diagnosis.scene import Scene
from veo_ti.identification import Identification

SPOTS = 60
_WIDTHS = np.geomspace(1e-4, 0.1, 25)  # of the largest load: prior widths of one spot's force that are tried
_LOG_MU = 1.0  # most that a material coefficient may change by


@dataclass(frozen=True, kw_only=True, eq=False)
class MissingForce:
    """Forces (S, 3) [N] in one frame, each spread around one of the surface points spots (S,)."""

    frame: int
    spots: np.ndarray
    force: np.ndarray

    @property
    def total(self) -> np.ndarray:
        """The resultant (3,) [N]."""
        return self.force.sum(axis=0)


def worst_frame(scene: Scene, shown: np.ndarray) -> int:
    """The frame with the largest mean square residual; shown (T, N, 3) [m]."""
    r = scene.target.residual(shown)
    return int(np.argmax((r**2).sum(axis=(1, 2)) / np.maximum(scene.target.seen.sum(axis=1), 1)))


def missing_force(
    identification: Identification, scene: Scene, shown: np.ndarray, variance: float, frame: int
) -> MissingForce:
    """`min |r - H^-1 W c - J a|^2 / variance + |c|^2 / width^2 + a^T P a` over forces c at spots and the material a.

    This is the residual force H r, spread by W over each spot's surroundings, without noise and without what a change
    of the material (sensitivities J, prior P) explains; the width maximises the evidence. shown (T, N, 3) [m]:
    simulated positions as tracking would show them; variance [m2]: of an independent residual.
    """
    found, at, seen = identification.fit, np.array([frame]), scene.target.seen[frame]
    basis = Basis.of(scene.cloud, identification.options.fit, float(np.exp(found.centre)))
    prior = np.minimum(basis.prior(found.state.length, found.state.amplitude), _LOG_MU**2)
    spots, part, m = scene.spots(SPOTS), scene.energy.frames(at), scene.energy.elastic.m
    soft = parameter_forces(part, scene.y[at], basis.directions(Lame(mu=m[:, 0], lam=m[:, 1])))
    pushes = np.einsum("sn,ab->sanb", _patches(scene, spots), np.eye(3)).reshape(-1, scene.cloud.count, 3)
    both = np.concatenate([soft(np.array([0])), pushes[None]], axis=1)
    X = next(responses(part, scene.y[at], lambda index: both))[:, seen].reshape(both.shape[1], -1)
    A, b = X @ X.T / variance, X @ scene.target.residual(shown)[frame, seen].ravel() / variance
    widths = _WIDTHS * max(float(scene.total_force.max()), 1e-9)
    with serial_blas():
        tried = [_posterior(A, b, np.concatenate([prior, np.full(3 * len(spots), w**2)])) for w in widths]
    mean = max(tried, key=lambda result: result[0])[1]
    return MissingForce(frame=frame, spots=spots, force=mean[len(prior) :].reshape(-1, 3))


def _patches(scene: Scene, spots: np.ndarray) -> np.ndarray:
    """Weights (S, N) of sum 1 that overlap a little."""
    x = scene.cloud.x[spots]
    apart = float(np.median(cKDTree(x).query(x, 2)[0][:, 1])) if len(spots) > 1 else 0.0
    return np.stack([scene.patch(centre, max(2 * scene.cloud.spacing, 0.6 * apart)) for centre in x])


def _posterior(A: np.ndarray, b: np.ndarray, prior: np.ndarray) -> tuple[float, np.ndarray]:
    """Log evidence up to a constant, and the posterior mean."""
    root = np.sqrt(prior)
    precision = np.eye(len(prior)) + root[:, None] * A * root
    mean = root * np.linalg.solve(precision, root * b)
    return float(0.5 * b @ mean - 0.5 * np.linalg.slogdet(precision)[1]), mean
