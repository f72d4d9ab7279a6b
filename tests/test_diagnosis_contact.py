"""Where walls are looked for that nobody modelled: against a motion that one has stopped."""

from types import SimpleNamespace

import numpy as np
import pytest
import sim_cases

from sim.elastic import Elastic
from sim.energy import Energy
from sim.lame import Lame
from sim.newton import equilibrate
from sim.terms.contact import Contact
from sim.terms.loads import AppliedForce
from sim.terms.shapes import Plane
from veo_ti.diagnosis.causes.surroundings import HiddenContact

WAY, ELSEWHERE = np.array([0.0, 0.6, 0.8]), np.array([0.0, 0.0, -1.0])


def pushed(*ways: np.ndarray) -> SimpleNamespace:
    """A box whose end is pushed one way after the other, seen with a hard wall across WAY, simulated without."""
    cloud, loads = sim_cases.cloud(), np.concatenate([np.linspace(0, 1, 7)[:, None] * way for way in ways])
    force = np.zeros((len(loads), cloud.count, 3))
    force[:, cloud.x[:, 0] > 0.9] = 4e-4 * loads[:, None]
    elastic, fixed = Elastic.neo_hookean(cloud, Lame(mu=1.0, lam=2.0)), cloud.x[:, 0] < 1e-9
    rest = np.repeat(cloud.x[None], len(loads), axis=0)
    free = equilibrate(Energy.of(elastic, [AppliedForce(force=force)], fixed), rest).require_converged().y
    beyond = 0.4 * ((free @ WAY).max() - (cloud.x @ WAY).max())
    face = ((cloud.x @ WAY).max() + beyond) * WAY
    wall = Contact(shape=Plane(normal=-WAY), volume=cloud.volume, alpha=2e3, position=face)
    seen = equilibrate(Energy.of(elastic, [AppliedForce(force=force), wall], fixed), rest).require_converged().y
    return SimpleNamespace(
        cloud=cloud, y=free, residual=seen - free, train=np.ones(len(loads), bool), beyond=beyond, forces=force,
        spots=lambda: np.flatnonzero(cloud.surface & ~fixed)[::3],
    )  # fmt: skip


@pytest.fixture(scope="module")
def stopped() -> SimpleNamespace:
    """Pushed against the wall only."""
    return pushed(WAY)


def test_a_wide_wall_is_tried_where_the_object_was_stopped(stopped):
    wide = [w for w in HiddenContact().places(stopped) if w.wide]
    best = min(wide, key=lambda w: abs(w.gap - stopped.beyond) - stopped.beyond * np.dot(w.way, WAY))
    assert np.dot(best.way, WAY) > np.cos(np.deg2rad(20))
    assert best.gap == pytest.approx(stopped.beyond, rel=0.25)
    assert len({w.way for w in wide}) == len(wide) / 3  # no direction twice


def test_a_wall_is_tried_where_the_object_hardly_goes_since_something_is_there():
    """Elsewhere it goes three times as far."""
    wide = [w for w in HiddenContact().places(pushed(3 * ELSEWHERE, WAY)) if w.wide]
    assert max(np.dot(w.way, WAY) for w in wide) > np.cos(np.deg2rad(20))


def test_a_way_that_leads_to_no_wall_hides_none_that_does(stopped):
    """Seed 9414: along one some degrees off, a limb that rests reaches farther than the object was seen to go."""
    off = np.cos(np.deg2rad(20)) * WAY - np.sin(np.deg2rad(20)) * np.array([1.0, 0.0, 0.0])
    residual = stopped.residual.copy()
    residual[0, -1] = -10 * np.abs(residual).max() * off
    wide = [w for w in HiddenContact().places(SimpleNamespace(**vars(stopped) | {"residual": residual})) if w.wide]
    assert max(np.dot(w.way, WAY) for w in wide) > np.cos(np.deg2rad(10))


def test_walls_push_nothing_at_rest(stopped):
    for wall in HiddenContact().places(stopped):
        (term,) = HiddenContact().change(stopped, np.ones(1), wall).terms
        assert not term.gradient(stopped.cloud.x[None]).any()
