"""The model that a cause joins."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sim.basis import Basis
from sim.evidence import Normal, posterior
from sim.solvers import Solver
from veo_ti.diagnosis.causes.base import Cause, Change
from veo_ti.diagnosis.checkpoints import Checkpoints
from veo_ti.diagnosis.columns import Known
from veo_ti.diagnosis.effort import Effort
from veo_ti.diagnosis.scene import Scene

_COARSE = 0.15  # of the motion, that a discretisation column is by first order: compact bodies show 0.03 to 0.13


def change_of(scene: Scene, cause: Cause | None, theta: np.ndarray, place: Any) -> Change:
    """What a cause does at theta; nothing for none."""
    return Change() if cause is None else cause.change(scene, theta, place)


def shown_by(scene: Scene, change: Change) -> np.ndarray:
    """The simulated positions as tracking would show them, (T, N, 3) [m]."""
    return scene.y if change.observe is None else change.observe(scene.y, np.arange(len(scene.y)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """What stays the same in every refit: the material's basis, all prior variances, the variance of the noise."""

    basis: Basis
    prior: np.ndarray  # (K + E,) of the material's coefficients and of the discretisation columns
    s2: float  # [m2]
    extra: tuple[Known, ...]  # discretisation columns
    solver: Solver | None  # for equilibria of all frames that train, and
    through_time: Solver | None = None  # of all frames, where what a cause does in one depends on others
    effort: Effort = field(default_factory=Effort)  # one for the whole diagnosis, and
    checkpoints: Checkpoints = field(default_factory=Checkpoints)  # likewise

    @property
    def coarse(self) -> bool:
        """Whether the points are too few for the body, as for a toy's limbs: other neighbours would change much."""
        return any(known.whole > _COARSE for known in self.extra)

    def tuned(self, normal: Normal, prior: np.ndarray, s2: float) -> np.ndarray:
        """The prior variances with the material's length and amplitude that have the highest evidence at s2 [m2].

        normal: data linearised in all unknowns; prior: their variances, of which those of the material change.
        """
        choices = [np.concatenate([own, prior[len(own) :]]) for own in self.basis.priors()]
        return max([prior, *choices], key=lambda choice: posterior(normal, choice, np.sqrt(s2)).evidence)
