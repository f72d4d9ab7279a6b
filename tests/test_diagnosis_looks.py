"""How often a cause is refitted."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from veo_ti.diagnosis import looks
from veo_ti.diagnosis.causes.base import Begun
from veo_ti.diagnosis.effort import Effort
from veo_ti.diagnosis.placing import Spot


@pytest.fixture
def tried(monkeypatch):
    """Makes a cause that was tried at place 1 and leaves so much, where place 2 shows; later ones leave the next of
    `tried.then`; `tried.begun`: the places of all refits, and at which cost they are given up; `tried.rough`: whether
    they are rough; `tried.started`: coefficients and theta that they start from, `tried.scenes`: where."""
    found = SimpleNamespace(place=1, coefficients=0.0, theta=0.0, without=None, evidence=lambda s2: 0.0, cost=100.0)
    found.short = 1.0
    nowhere = {"lags": False, "near": lambda *at: (), "courses": lambda *at: ()}
    found.cause = SimpleNamespace(name="a", begin=lambda place: (place, 0.0), anew=lambda *at: None, **nowhere)
    model = SimpleNamespace(s2=2.0, effort=Effort(), basis=SimpleNamespace(stiffer=lambda a, nats: a + nats))
    known = {"tuned": found, "following": model, "staying": 10.0}

    def make(left: float) -> looks.Tried:
        made = looks.Tried(result=found, model=model, left=left, fine=False)
        made.__dict__.update(known, spot=Spot(place=2, coefficients=0.0, theta=0.0))
        return made

    def again(one: looks.Tried, enough: float = 0.0) -> looks.Tried:
        one.__dict__.update(known)
        return looks.looked(one, 0.9, enough, None, str)

    def refit(scene, model, start, *, place, rough, theta, most=np.inf, **more) -> None:
        make.scenes.append(scene)
        make.started.append((start, theta))
        make.begun.append((place, most))
        make.rough.append(rough)

    make.then, make.begun, make.rough, make.started, make.scenes, make.again = [], [], [], [], [], again
    monkeypatch.setattr(looks, "refit", refit)
    monkeypatch.setattr(looks, "_of_that_material", lambda scene, model, coefficients: coefficients)
    monkeypatch.setattr(looks.Tried, "of", lambda *given, **more: make(make.then.pop(0)))
    return make


@pytest.mark.parametrize(("then", "taken", "roams"), [(0.2, True, 2), (0.95, True, 1), (1.2, False, 1)])
def test_another_place_must_leave_less_and_clearly_less_for_yet_another(then, taken, roams, tried):
    """Else one along the courses still may, and must then as well."""
    tried.then = [then, 2.0]
    after = tried.again(tried(1.0))
    assert tried.begun == [(2, 15.0)]  # given up where it would cost half more
    assert (after.left == then) == taken and after.roams == roams
    after.__dict__["spot"] = Spot(place=3, coefficients=0.0, theta=0.0)
    assert tried.again(after).roams == roams - 1 and tried.begun[1:] == [(3, 15.0)]


@pytest.mark.parametrize(("then", "taken"), [(0.2, True), (1.2, True), (2.0, False)])
def test_a_closer_look_that_leads_away_is_not_taken_and_not_repeated(then, taken, tried):
    """It is at the same place still where another one led nowhere."""
    tried.then = [3.0, then]
    one = replace(tried(1.0), roams=1)
    one.__dict__["spot"] = Spot(place=2, coefficients=0.0, theta=0.0)
    stayed = tried.again(one)
    after = tried.again(stayed)
    assert tried.begun[1:] == [(1, np.inf)] and (after.left == then) == taken and not after.roams
    if not taken:
        assert after.left == 1.0 and tried.again(after) is after


@pytest.mark.parametrize(("left", "enough", "rough"), [(0.9, 5.0, True), (1.5, 5.0, False), (1.5, 1.0, True)])
def test_a_fit_goes_to_its_end_where_little_is_left_and_no_longer_ever_less(left, enough, rough, tried):
    """The last one was made for a variance of 2: a fit that left less than half of that is followed by another."""
    tried.then = [1.0]
    one = replace(tried(left), roams=0)
    one.__dict__["spot"] = Spot(place=1, coefficients=0.0, theta=0.0)
    tried.again(one, enough)
    assert tried.rough == [rough]


@pytest.mark.parametrize(("then", "left"), [(0.8, 0.8), (1.9, 1.5)])
def test_a_fit_that_crept_is_begun_anew_once_from_a_homogeneous_object_without_the_cause(then, left, tried):
    """Not while what it leaves still falls by half; as it was where that leaves more."""
    tried.then = [then, 0.7]
    one = tried(1.5)
    one.result.short, one.result.coefficients, one.result.theta = 3.0, np.ones(4), np.ones(3)
    one.__dict__["spot"] = Spot(place=1, coefficients=None, theta=None)
    after = tried.again(one)
    (start, theta), *_ = tried.started
    assert after.anew and after.left == left and not start.any() and not theta.any() and len(start) == 4
    tried.again(replace(after, fine=False))
    assert len(tried.started) == 2 and tried.started[1][0].all()
    assert not tried(0.9).crept and tried(1.1).crept


def test_a_cause_may_say_where_it_is_begun_anew(tried):
    """Asked in a homogeneous object, and for the effort that it spends."""
    tried.then, one, asked = [0.8], tried(1.5), []
    scene = SimpleNamespace(energy="bare", moved=lambda energy, y: (energy, y))
    one.result.short, one.result.coefficients, one.result.theta, one.result.without = 3.0, np.ones(4), np.ones(1), scene
    begun = Begun(stiffer=2.0, theta=np.full(1, 5.0), y="there", steps=7.0)
    one.result.cause.anew = lambda even, place: asked.append((even.tolist(), place)) or begun
    one.__dict__["spot"] = Spot(place=1, coefficients=None, theta=None)
    tried.again(one)
    (start, theta), *_ = tried.started
    assert asked == [([0.0] * 4, 1)] and (start == 2).all() and theta == 5 and one.model.effort.spent == 7
    assert tried.scenes == [("bare", "there")]


@pytest.mark.parametrize(("leaves", "asked", "left"), [
    ((5.0, 2.0, 1.9), 3, 1.9), ((9.5, 1.0), 1, 9.5), ((11.0, 1.0), 1, 10.0), ((5.0, 2.0, 1.0, 0.1), 3, 1.0),
])  # fmt: skip
def test_a_cause_is_followed_beyond_the_first_order_while_clearly_less_is_left(leaves, asked, left, monkeypatch):
    """From 10 on: not after a tenth or less was gained, not where more is left, and three times at most; each time from
    where it is best along its courses."""
    fits, followed = iter(leaves), []
    cause = SimpleNamespace(
        name="any", followed=True, closer=lambda scene, theta, place: followed.append(place) or ("place", None)
    )

    def tried(left: float) -> SimpleNamespace:
        tuned = SimpleNamespace(cause=cause, scene=None, theta=None, place=left, without=None, coefficients=None)
        model = SimpleNamespace(effort=Effort())
        return SimpleNamespace(result=tuned, tuned=tuned, following=None, left=left, model=model)

    def moved(result: SimpleNamespace, model: None, roams: int) -> SimpleNamespace:
        return SimpleNamespace(place=(roams, result.place), theta=None, coefficients=None)

    monkeypatch.setattr(looks, "refit", lambda *_, **more: None)
    monkeypatch.setattr(looks, "better_place", moved)
    monkeypatch.setattr(looks.Tried, "of", lambda *_, **more: tried(next(fits)))
    assert looks.beyond(tried(10.0), None, str).left == left
    assert len(leaves) - len(list(fits)) == asked
    assert followed == [(1, before) for before in (10.0, *leaves)][: len(followed)] and followed
