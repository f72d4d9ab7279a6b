"""What a measurement cannot tell, however good the model: one sentence each, with what it can."""

import numpy as np

from veo_ti.diagnosis.scene import Scene

_LEVEL = 0.1  # relative spread below which loads are one level
_ALIKE = 0.02  # relative difference below which loads are the same
_IDLE = 0.02  # of the largest load
_FEW = 8  # training frames


def limits(scene: Scene) -> tuple[str, ...]:
    """Sentences on a scene's frames and loads; none where there is nothing to say."""
    load, said = scene.total_force, []
    if not load.any():
        return (
            "No frame names a force, so nothing about the loads and no stiffness in pascals can be told; what moves "
            "without a load, and what tracking does to it, can.",
        )
    loaded = np.flatnonzero(load > _IDLE * load.max())
    if not (np.flatnonzero(load <= _IDLE * load.max()) > loaded[0]).any():
        said.append(
            "No unloaded frame follows a load, so what stays after unloading (permanent set, creep, a support that "
            "slipped) can hardly be told; what happens under load can."
        )
    if load[loaded].min() > (1 - _LEVEL) * load[loaded].max():
        said.append(
            "All loaded frames carry about the same load, so what depends on its size (stiffening, a force that is not "
            "proportional) cannot be told from stiffness; what depends on place, direction or time can."
        )
    pattern = scene.forces[loaded]
    if np.abs(pattern - pattern[:1]).max() < _ALIKE * np.abs(pattern).max():
        said.append(
            "All loaded frames are alike, so no cause can be told from another stiffness; only noise and what changes "
            "without the load can."
        )
    if scene.train.all():
        said.append("Too few frames to hold any out, so what a cause gains cannot be measured; causes can be ranked.")
    elif scene.train.sum() < _FEW:
        said.append(
            f"Only {int(scene.train.sum())} frames choose the model, so noise that is slow in time looks like an "
            "effect; a strong effect can still be told."
        )
    return tuple(said)
