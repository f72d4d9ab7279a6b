"""Causes by other laws than those of the toolkit: what makes them other."""

import numpy as np
import pytest
from blind import laws, other_causes, world
from blind.history import Healed
from blind.ties import String
from test_blind import scene, strained  # noqa: F401


def test_other_laws_are_of_causes_that_have_a_name_or_of_none_that_others_hide(scene):  # noqa: F811
    plans = [world.plan(seed, "other")[0] for seed in range(9001, 9001 + len(world.OTHER))]
    assert sorted(plans) == sorted((name,) for name in world.OTHER)
    names = {world.OTHER[name](np.random.default_rng(1), scene).name for (name,) in plans}
    assert names - set(world.CATALOGUE) == {draw(np.random.default_rng(1), scene).name for draw in other_causes.DRAWS}
    assert not set(world.OTHER) & set(world.CATALOGUE)


def test_healed_softening_spares_the_first_loading_and_shows_once_it_is_less(scene):  # noqa: F811
    base = laws.neo_hookean(scene.mu, scene.lam)
    part = Healed(base, 0.5, scene.mu / 100).after(strained(scene, 0, 0.05), 1.0)
    more, less = strained(scene, 0, 0.07), strained(scene, 0, 0.03)
    assert not part.stress(more, 2.0)[1].any()
    P, whole = part.stress(less, 2.0)[1], base.stress(less, 2.0)[1]
    share = -(P * whole).sum((-1, -2)) / (whole * whole).sum((-1, -2))
    assert ((share > 0) & (share <= 0.5)).all() and share.max() > 0.4


def test_a_string_pulls_only_where_it_gets_longer(scene):  # noqa: F811
    x, p = scene.built.body.nodes, np.array([0, 0, 1.0])
    tie, way = String(x, np.ones(len(x)), p), (p - x) / np.linalg.norm(p - x, axis=1)[:, None]
    assert not tie.respond(0.01 * way, 0.0)[1].any()
    assert tie.respond(-0.01 * way, 0.0)[1] == pytest.approx(-0.01 * way)
