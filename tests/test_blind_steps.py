"""The blind trials' own simulator in time: what it hides must not depend on how long its steps are."""

from dataclasses import replace

import numpy as np
import pytest
from blind import world
from blind.scenes import Model, draw_scene

IN_TIME = ("damping", "inertia", "permanent_set", "softening", "viscoelasticity",
           "healed_softening", "rubber_inertia", "two_branches", "wake", "yielded_set")  # fmt: skip


@pytest.mark.parametrize("name", IN_TIME)
def test_shorter_steps_change_an_effect_by_less_than_a_hundredth(name):
    """An error of some hundredths would be a second effect, which the toolkit finds."""
    drawn = draw_scene(np.random.default_rng(8), "tiny", brisk=name in world.BRISK)
    scene = replace(drawn, time=drawn.time[:5])
    hidden = world.EFFECTS[name](np.random.default_rng(1), scene)
    model = hidden.change(Model.plain(scene), hidden.start)
    shown, finer = (replace(model, steps=k * model.steps).seen(scene)[0] for k in (1, 4))
    effect = finer - finer[0] - scene.plain_seen
    assert np.linalg.norm(shown - finer) < 0.01 * np.linalg.norm(effect)
