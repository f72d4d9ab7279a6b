"""The cracks of the blind trials: something opens, and nothing comes off."""

import numpy as np
import pytest
from blind.of_setting import disconnection
from blind.scenes import Model, draw_scene


@pytest.mark.parametrize("seed", [3, 9, 13, 28, 2478])  # the first cuts drawn set an arm free, or open nothing
def test_a_crack_opens_and_every_cell_still_hangs_on_the_held_ones(seed):
    scene = draw_scene(np.random.default_rng([seed, 0]), "small")
    hidden = disconnection(np.random.default_rng([seed, 1]), scene)
    whole, cracked = scene.built.body, hidden.change(Model.plain(scene), hidden.start).built.body
    opened = cracked.count - whole.count
    assert opened > 0
    assert np.isin(np.arange(cracked.count), cracked.elements).all(), "a node without a cell"
    reached = np.isin(cracked.elements, np.flatnonzero(cracked.fixed)).any(axis=1)
    for _ in range(len(reached)):
        reached |= (np.isin(cracked.elements, cracked.elements[reached]).sum(axis=1)) >= 9
    assert reached.all(), "a part has come off"
