"""Whether what a fit leaves is more than noise and the simulation's own error could be."""

from dataclasses import dataclass

import numpy as np

from veo_ti.diagnosis.fitted import Refit
from veo_ti.diagnosis.model import Model
from veo_ti.diagnosis.noise import evenness
from veo_ti.diagnosis.scene import Scene

_VISIBLE, _BESIDE = 0.1, 0.35  # of the noise, alone and beside a cause that explains most; and
_SHARE = 0.004  # of the motion: root mean square below which the simulation's own error is as large
_FAINT = 0.6, 0.015  # of the noise and of the motion: no more than that, it takes a cause to be said to be wrong; and
_COARSE = 0.03  # of the motion, where the points are too few for the body: nulls left up to 0.021
_SHARED, _EVEN = 3.0, 0.3  # times the evenness, of the noise between neighbours, that the noise they share may add at
# most; and how even that is at least: in trials it was by 0.53 to 0.77 beside the right cause


@dataclass(frozen=True, kw_only=True, eq=False)
class Left:
    """What a fit leaves in a scene, its cause taken in."""

    scene: Scene
    excess: float  # root mean square per coordinate [m] beyond noise
    noise: float  # as neighbours show it, likewise
    even: float  # how evenly it goes on, as noise does
    coarse: bool = False  # whether the points are too few for the body
    shadow: bool = False  # whether it may be that of a cause that explains most

    @classmethod
    def by(
        cls, current: Refit, model: Model, s2: float, noise: float, modes: np.ndarray, *, shadow: bool = False
    ) -> "Left":  # fmt: skip
        """By a refit in a model, which has used as many parameters as it does at the variance s2 [m2]; noise: as
        neighbours show it."""
        scene, seen = current.scene, current.scene.target.seen & current.scene.train[:, None]
        square = ((scene.target.residual(current.shown) ** 2).sum(axis=2) * seen).sum() / (
            3 * seen.sum() - current.used(s2)
        )
        excess = float(np.sqrt(max(square - noise**2, 0.0)))
        even = evenness(current.left, modes)
        return cls(scene=scene, excess=excess, noise=noise, even=even, coarse=model.coarse, shadow=shadow)

    @property
    def visible(self) -> bool:
        """Whether it is more than the simulation's own error may be."""
        return self.excess > least_visible(self.scene, self.noise, shadow=self.shadow)

    @property
    def faint(self) -> bool:
        """Whether it is so little more that the simulation may be to blame, unless a cause explains it."""
        return self.excess < surely_visible(self.scene, self.noise, coarse=self.coarse)

    @property
    def like_noise(self) -> bool:
        """Whether it is no larger than noise that neighbours share may be, by how evenly it goes on."""
        return self.even > _EVEN and self.excess < _SHARED * self.even * self.noise


def least_visible(scene: Scene, sigma: float, *, shadow: bool = False) -> float:
    """The root mean square of an effect [m], per coordinate, below which the simulation's own error is as large.

    shadow: beside a cause that explains most, and that has not quite the shape it is given.
    """
    return max((_BESIDE if shadow else _VISIBLE) * sigma, _SHARE * _motion(scene))


def surely_visible(scene: Scene, sigma: float, *, coarse: bool = False) -> float:
    """The root mean square of an effect [m], per coordinate, from which on it is seen even where its fingerprint is not
    quite the shape that it leaves; coarse: by points too few for the body."""
    return max(_FAINT[0] * sigma, (_COARSE if coarse else _FAINT[1]) * _motion(scene))


def _motion(scene: Scene) -> float:
    """Root mean square per coordinate [m]."""
    seen = scene.target.seen & scene.train[:, None]
    return float(np.sqrt((((scene.y - scene.cloud.x) ** 2).sum(axis=2) * seen).sum() / (3 * seen.sum())))
