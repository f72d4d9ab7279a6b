"""A cloud of the beam for tests, and the shapes that it moves in."""

import numpy as np

from veo_ti.beam import BeamModel
from veo_ti.beam_dynamics.ritz import Ritz, beam_elastic
from veo_ti.body import tie_markers
from veo_ti.markers import settle

TIP = np.array([[0.0, 0.015, 0.036], [0.0, -0.006, 0.024], [0.0, 0.036, 0.006]])  # [m] markers
YOUNG, POISSON = 2.6e5, 0.3  # compressible: no locking, so finite elements and beam theory are oracles
WEIGHT = 0.51  # [N]


def shapes(model: BeamModel, load: float, softness: float = 1.0) -> Ritz:
    """About the settled pose of a beam `softness` times as soft as YOUNG."""
    young, x = YOUNG / softness, model.cloud.x
    force = model.force(load)[None]
    y = settle(model.cloud, force, fixed=model.fixed, young=young, poisson=POISSON, start=x[None])[0]
    return Ritz.about(model, beam_elastic(model, young, POISSON), y, tie_markers(x, TIP))
