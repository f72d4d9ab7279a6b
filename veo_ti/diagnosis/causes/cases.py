"""A cause in single load cases: what belongs together in the load's history, and is off by itself."""

from collections.abc import Sequence

import numpy as np

from sim.terms.jet import Jet
from veo_ti.diagnosis.causes.base import Parameter
from veo_ti.diagnosis.causes.other_loads import OtherLoads
from veo_ti.diagnosis.scene import Scene

_LOADED = 0.02  # of the largest load, below which a frame is between load cases
_ANOTHER = 0.8  # cosine of the angle by which the load turns from one frame to the next where another case begins


class LoadCase(OtherLoads):
    """f = (1 + s) f0 in the frames of one load case."""

    name = "load_case"
    sentence = "One load case was weaker or stronger, beside the others, than it was said to be."
    parameters = (Parameter(name="scale", unit="-", sd=0.2),)

    def untestable(self, scene: Scene) -> str | None:
        """A single one is as strong as the object is stiff."""
        reason = super().untestable(scene)
        return reason or (None if len(cases(scene)) > 1 else "there is one load case only; measure another one")

    def places(self, scene: Scene) -> Sequence[tuple[int, int]]:
        """Each case, from a frame up to another one."""
        return cases(scene)

    def loads(self, scene: Scene, theta: np.ndarray, place: tuple[int, int]) -> tuple[np.ndarray, Jet | None]:
        """Scaled in these frames."""
        factor = np.ones((len(scene.time), 1, 1))
        factor[place[0] : place[1]] += theta[0]
        return factor * scene.forces, scene.jet

    def describe(self, scene: Scene, place: tuple[int, int]) -> str:
        """Which one."""
        return f"in frames {place[0]} to {place[1] - 1}"


def cases(scene: Scene) -> list[tuple[int, int]]:
    """The first frame of each load case and the one after its last: loaded all the time, and never suddenly from
    elsewhere."""
    total = scene.forces.sum(axis=1)
    size = np.linalg.norm(total, axis=1)
    loaded = size > _LOADED * size.max(initial=0.0)
    turned = np.append(True, (total[1:] * total[:-1]).sum(axis=1) < _ANOTHER * size[1:] * size[:-1])
    found: list[tuple[int, int]] = []
    for frame in map(int, np.flatnonzero(loaded)):
        if found and found[-1][1] == frame and not turned[frame]:
            found[-1] = (found[-1][0], frame + 1)
        else:
            found.append((frame, frame + 1))
    return found
