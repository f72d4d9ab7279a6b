"""What changes over the object or acts one way only: strings that pull, and slip that grows along a way."""

from dataclasses import replace

import numpy as np
import pytest
from test_diagnosis_courses import filmed, looked_at
from test_diagnosis_experiment import NOISE, model, scene  # noqa: F401

from sim.sensitivity import responses
from veo_ti.diagnosis.causes.loads import HiddenTether, Tied
from veo_ti.diagnosis.causes.measurement import CorrespondenceSlip
from veo_ti.diagnosis.causes.ways import ALL_AROUND, distinct, ways_of
from veo_ti.diagnosis.intervals import measured, unsure_of_place
from veo_ti.diagnosis.model import shown_by
from veo_ti.diagnosis.refit import refit
from veo_ti.diagnosis.score import scores_of

STIFF = 0.2  # [N/m]


@pytest.fixture(scope="module")
def string(scene) -> Tied:  # noqa: F811
    """From the end that is pushed down, up and to the side."""
    top = scene.cloud.x[:, 2].max()
    way = np.array([0.2, 0.4, 0.9]) / np.linalg.norm([0.2, 0.4, 0.9])
    return Tied(centre=(0.8, 0.2, float(top)), radius=2 * scene.cloud.spacing, way=tuple(way.tolist()), length=1.0)


@pytest.fixture(scope="module")
def held_back(scene, model, string):  # noqa: F811
    return filmed(scene, model, HiddenTether(), string, [STIFF])


def test_a_string_is_tried_where_one_pulls(held_back, string):
    """Near the spot one leads about as it does; where nothing is left to undo, none is tried."""
    strings = [place for place in HiddenTether().places(held_back) if place.way]
    near = min(strings, key=lambda place: np.linalg.norm(np.subtract(place.centre, string.centre)))
    assert np.dot(near.way, string.way) > np.cos(np.deg2rad(40))
    explained = replace(held_back, target=replace(held_back.target, y=held_back.y))
    assert all(place.way is None for place in HiddenTether().places(explained))


def test_a_string_is_told_from_springs(held_back, model, string):  # noqa: F811
    """By its score, from where it is, and however far off in direction: springs push as well."""
    places, modes = HiddenTether().places(held_back), np.eye(held_back.cloud.count)[:, :2]
    start = refit(held_back, model, np.zeros(len(model.prior)))
    found, spring = (
        scores_of(start, model, NOISE**2, modes, [(HiddenTether(), tried)])[1][0]
        for tried in (places, [place for place in places if place.way is None])
    )
    assert found.place.way is not None and found.log_bayes > spring.log_bayes + 10
    assert np.dot(found.place.way, string.way) > np.cos(np.deg2rad(45))


def test_a_string_is_found_between_what_is_tried(held_back, model, string):  # noqa: F811
    """Beside it, and led elsewhere: its spot, its way and its stiffness; and it says how unsure these are."""
    beside = replace(string, centre=(0.8, 0.1, string.centre[2]), way=(0.0, 0.0, 1.0), length=1.4)
    found = looked_at(held_back, model, HiddenTether(), beside, [STIFF / 2], looks=6)
    assert np.linalg.norm(np.subtract(found.place.centre, string.centre)) < 0.5 * held_back.cloud.spacing
    assert np.dot(found.place.way, string.way) > np.cos(np.deg2rad(6))
    assert found.theta == pytest.approx([STIFF], rel=0.05)
    placed = unsure_of_place(found, {"hidden_tether": 1e12})
    assert {place.way is None for place, _ in placed.placed.elsewhere} == {True, False}  # springs are as likely then
    told = {measure.name: (low, high) for measure, low, high in measured(placed)}
    assert set(told) == {"spot_x", "spot_y", "spot_z", "radius", "way_x", "way_y", "way_z"}
    assert all(low <= measure.value <= high for measure, (low, high) in zip(
        HiddenTether().measures(found.place), told.values(), strict=True))  # fmt: skip


def test_a_string_leaves_the_rest_shape_and_what_comes_nearer_alone(scene, string):  # noqa: F811
    x, way = scene.cloud.x, np.array(string.way)
    long = replace(string, length=100.0)  # pulls all points of its patch one way
    (term,) = HiddenTether().change(scene, np.array([STIFF]), long).terms
    moved = x + 0.02 * np.array([0.0, 1.0, -1.0])[:, None, None] * way
    pull = -term.gradient(moved)
    assert not pull[:2].any()
    w = HiddenTether().patch(scene, string)
    taut = STIFF * 0.02 * way  # k times how much longer it is
    assert pull[2].sum(axis=0) == pytest.approx(taut, abs=0.01 * np.linalg.norm(taut))
    assert set(np.flatnonzero(pull[2].any(axis=1))) == set(np.flatnonzero(w))


def test_what_forces_undo_is_the_slope_of_what_is_left(held_back):
    """`d(|r|^2 / 2)/df = -H^-1 r`, H symmetric: against the motion that each force makes."""
    rng = np.random.default_rng(1)
    force = rng.normal(size=held_back.y.shape) * held_back.energy.free(np.ones_like(held_back.y))
    moved = np.concatenate(list(responses(held_back.energy, held_back.y, lambda index: force[index, None].copy())))
    by_motion = (held_back.residual * moved).sum(axis=(1, 2))
    assert (held_back.undone * force).sum(axis=(1, 2)) == pytest.approx(by_motion, rel=2e-2)


def slipped(scene, place):  # noqa: F811
    """As tracking shows it, and noise."""
    shown = shown_by(scene, CorrespondenceSlip().change(scene, np.array([0.3]), place))
    noise = NOISE * np.random.default_rng(3).normal(size=scene.y.shape)
    return replace(scene, target=replace(scene.target, y=shown + noise, sigma=NOISE))


def test_slip_that_grows_is_found_between_the_ways_that_are_tried(scene, model):  # noqa: F811
    """Its way, and how much of the motion is lost on average; an even one is told as before."""
    way = np.array([0.9, 0.3, -0.2]) / np.linalg.norm([0.9, 0.3, -0.2])
    found = looked_at(slipped(scene, tuple(way.tolist())), model, CorrespondenceSlip(), (1.0, 0.0, 0.0), [0.3])
    assert np.dot(found.place, way) > np.cos(np.deg2rad(5))
    assert found.theta == pytest.approx([0.3], rel=0.05)
    even = looked_at(slipped(scene, None), model, CorrespondenceSlip(), (1.0, 0.0, 0.0), [0.3])
    assert even.place is None and even.theta == pytest.approx([0.3], rel=0.05)


def test_slip_that_grows_is_none_at_one_end_and_twice_at_the_other(scene):  # noqa: F811
    """Of what an even one hides, along the object."""
    here, even = ((shown_by(scene, CorrespondenceSlip().change(scene, np.array([0.1]), place)) - scene.y)
                  for place in ((1.0, 0.0, 0.0), None))  # fmt: skip
    x = scene.cloud.x[:, 0]
    share = 2 * (x - x.min()) / np.ptp(x)
    assert here == pytest.approx(share[:, None] * even, abs=1e-12 * np.abs(even).max())


def test_ways_are_told_apart():
    """All around there are twenty-six; of vectors the strong ones count, of those that lie close together the first."""
    assert len(ALL_AROUND) == len(set(ALL_AROUND)) == 26
    assert np.linalg.norm(ALL_AROUND, axis=1) == pytest.approx(np.ones(26))
    found = ways_of(np.array([[0.0, 0, 0], [0, 2.0, 0], [0, 0.1, 0], [4.0, 0, 0], [0.0, 2.0, 0.2]]))
    assert found[0] == (1.0, 0.0, 0.0) and len(found) == 3
    assert distinct(found, 5) == [(1.0, 0.0, 0.0), found[1]]
    assert distinct(found, 1) == [(1.0, 0.0, 0.0)]
