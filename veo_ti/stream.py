"""How wide an air stream is that nobody measured: what one homogeneous material under it says."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from sim.basis import FitOptions
from sim.cloud import RestCloud
from sim.fit import FitState, fit, guess_modulus
from veo_ti.observation import Observation
from veo_ti.scene import energy_of, target_of

_NARROWEST, _WIDEST = 0.4, 3.0  # of the width that was assumed
_SURE = 0.1  # of a width, to which it is sought: data of one nozzle distance tell no more


def unmeasured(observation: Observation) -> bool:
    """Whether all that is known of the forces is where a jet was and where it pointed."""
    return observation.jet is not None and observation.forces is None and not observation.force_scale_known


def as_wide(observation: Observation, footprint: float) -> Observation:
    """The measurement with a jet of this footprint [m]."""
    return replace(observation, jet=replace(observation.jet, footprint=footprint))


def find_footprint(
    observation: Observation, cloud: RestCloud, frames: np.ndarray, options: FitOptions,
    progress: Callable[[FitState], None] | None = None,
) -> float:  # fmt: skip
    """How wide the jet of the measurement is [m], as the chosen frames say.

    A recording tells where the nozzle was and where it pointed, not how wide its stream is where it meets the object.
    That width and one homogeneous material are those of the least residual.
    """
    target = target_of(observation).frames(frames)
    mu = guess_modulus(energy_of(observation, cloud).frames(frames), target)
    last: list[FitState] = []

    def residual(log_width: float) -> float:
        energy = energy_of(as_wide(observation, float(np.exp(log_width))), cloud).frames(frames)
        start = last[-1].y if last else np.repeat(cloud.x[None], len(frames), axis=0)
        guess = last[-1].a if last else None
        found = fit(energy, target, start, mu=mu, options=options, guess=guess, progress=progress)
        last.append(found.state)
        return target.rms(found.state.y)

    assumed = np.log(observation.jet.footprint)
    bounds = assumed + np.log([_NARROWEST, _WIDEST])
    return float(np.exp(minimize_scalar(residual, bounds=bounds, method="bounded", options={"xatol": _SURE}).x))
