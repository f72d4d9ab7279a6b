"""The beam that the hypotheses move: one cloud, its modulus from the settled poses, its shapes about each of them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import splu

from sim.elastic import Elastic
from veo_ti.beam import POISSON, BeamModel
from veo_ti.beam_dynamics.fitting import Fit
from veo_ti.beam_dynamics.full import full_markers
from veo_ti.beam_dynamics.ritz import Physics, Ritz, Start, beam_elastic, edge_share, stiffness_of
from veo_ti.beam_dynamics.takes import PLANE, Release
from veo_ti.body import MarkerTies, tie_markers
from veo_ti.markers import settle

TRIES = 12  # random clouds to choose from
POINTS = 300  # the modulus is fitted on the same cloud, which takes the stiffness of so coarse a one back


@dataclass(frozen=True, kw_only=True, eq=False)
class Setting:
    """What every hypothesis shares."""

    model: BeamModel
    elastic: Elastic
    young: float  # [Pa] on this cloud
    ritz: Mapping[str, Ritz]  # by take
    ties: Mapping[str, MarkerTies]  # by take
    tolerance: float  # [m] root mean square of what the settled poses leave, and of noise: the static model's own error

    @classmethod
    def of(
        cls, fitted: Sequence[Release], others: Sequence[Release] = (), *, points: int = POINTS, seed: int = 0
    ) -> "Setting":
        """Fit the modulus to the settled poses of some takes; shapes for the others too. seed: of the clouds."""
        model = straightest(points, range(seed * TRIES, (seed + 1) * TRIES))
        static = model.fit([r.settled for r in fitted])
        elastic = beam_elastic(model, static.young, POISSON)
        y = {r.load: pose for r, pose in zip(fitted, static.y, strict=True)}
        for r in others:
            if r.load not in y:
                force, start = model.force(r.load)[None], static.y[:1]
                y[r.load] = settle(
                    model.cloud, force, fixed=model.fixed, young=static.young, poisson=POISSON, start=start
                )[0]
        takes = [*fitted, *others]
        ties = {r.name: tie_markers(model.cloud.x, r.settled.held) for r in takes}
        ritz = {r.name: Ritz.about(model, elastic, y[r.load], ties[r.name]) for r in takes}
        noise = np.mean([r.settled.noise**2 for r in fitted])
        error = float(np.sqrt(np.mean(static.residual[..., PLANE] ** 2) + noise))
        return cls(model=model, elastic=elastic, young=static.young, ritz=ritz, ties=ties, tolerance=error)

    def full(self, physics: Physics, start: Start, r: Release) -> np.ndarray:
        """A take by the full simulation, (T, 3, 3) [m]."""
        ritz, ties = self.ritz[r.name], self.ties[r.name]
        return full_markers(self.model, self.elastic, ritz, ties, physics, start, r.load, r.time)

    def defect(self, fit: Fit, number: int) -> np.ndarray:
        """The full simulation minus the shapes' at a fit's parameters, (T, 3, 3) [m], for a reach of one."""
        r = fit.setup.releases[number]
        physics, start = fit.setup.physics(fit.theta, r), fit.setup.start(fit.theta, number)
        shapes = self.ritz[r.name].markers(physics, start, r.time)
        return (self.full(physics, start, r) - shapes) / start.reach


def straightest(points: int, seeds: Iterable[int]) -> BeamModel:
    """Of several random clouds the one that moves least sideways when its tip is pushed down.

    The beam is symmetric, a cloud is not: pushed down it moves sideways by up to 3 %. Under a mass at the tip the two
    directions swing nearly as fast as each other, and within a few periods such a cloud hands the motion from one to
    the other: that would tell a mass fixed to the beam from one on a string for no physical reason.
    """
    return min((BeamModel.of(points, seed) for seed in seeds), key=_sideways)


def _sideways(model: BeamModel) -> float:
    """Sideways over vertical deflection of the tip edge under a vertical force, for small ones."""
    elastic, inner = beam_elastic(model, 1.0, POISSON), np.flatnonzero(~np.repeat(model.fixed, 3))
    push = np.stack([np.ravel(edge_share(model)[:, None] * axis)[inner] for axis in np.eye(3)[1:]], axis=1)
    moved = push.T @ splu(stiffness_of(model, elastic, model.cloud.x, inner)).solve(push[:, 1])
    return abs(float(moved[0] / moved[1]))
