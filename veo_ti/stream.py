"""How wide an air stream is that nobody measured: found together with a coarse material field under it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sim.basis import Basis, FitOptions
from sim.cloud import RestCloud
from sim.evidence import Normal, posterior
from sim.fit import FitState, fit, guess_modulus, normal_equations
from veo_ti.observation import Observation
from veo_ti.scene import energy_of, forces_of, target_of

_MODES = 8  # of the material meanwhile: under one homogeneous material the width would take over for what varies
_BETWEEN = 2  # steps of the material between two of the width
_ROUNDS = 10
_SURE = 0.02  # of a width, by which the last step may change it
_FURTHEST = 0.4  # natural logarithm, that one step may go
_SMALL = 0.05  # and step of the finite difference


def unmeasured(observation: Observation) -> bool:
    """Whether all that is known of the forces is where a jet was and where it pointed."""
    return observation.jet is not None and observation.forces is None and not observation.force_scale_known


def as_wide(observation: Observation, footprint: float) -> Observation:
    """The measurement with a jet of this footprint [m]."""
    return replace(observation, jet=replace(observation.jet, footprint=footprint))


@dataclass(frozen=True, kw_only=True)
class Stream:
    """A width that was found, and by what share of it the last step still changed it."""

    footprint: float  # [m]
    change: float

    @property
    def sentence(self) -> str:
        """What is wrong with it, or nothing."""
        if abs(self.change) < _SURE:
            return ""
        return f"; the stream's width had not settled, its last step still changed it by {abs(self.change):.0%}"


def find_footprint(
    observation: Observation, cloud: RestCloud, options: FitOptions,
    progress: Callable[[FitState], None] | None = None,
) -> Stream:  # fmt: skip
    """How wide the jet of the measurement is.

    A recording tells where the nozzle was and where it pointed, not how wide its stream is where it meets the object.
    Steps of the material alternate with Gauss-Newton steps of the width in which the material follows.
    """
    options = replace(options, modes=min(options.modes, _MODES), iterations=_BETWEEN)
    target, width = target_of(observation), observation.jet.footprint
    y, a = np.repeat(cloud.x[None], len(observation.time), axis=0), None
    mu = guess_modulus(energy_of(observation, cloud), target)
    basis = Basis.of(cloud, options, mu)
    for _ in range(_ROUNDS):
        energy = energy_of(as_wide(observation, width), cloud)
        state = fit(energy, target, y, mu=mu, options=options, guess=a, progress=progress).state
        wider, narrower = (forces_of(as_wide(observation, width * np.exp(s)), cloud) for s in (_SMALL, -_SMALL))
        normal = Normal.sum(
            normal_equations(energy, target, basis, state, (wider - narrower)[:, None] / (2 * _SMALL))
        )
        prior = np.append(basis.prior(state.length, state.amplitude), 1.0)  # hardly any on the width
        step = float(np.clip(posterior(normal, prior, state.sigma).mean[-1], -_FURTHEST, _FURTHEST))
        width, y, a = width * float(np.exp(step)), state.y, state.a
        if abs(step) < _SURE:
            break
    return Stream(footprint=width, change=step)
