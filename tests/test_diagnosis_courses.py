"""Places between those that are scanned: courses lead there, and what a refitted cause leaves tells how far."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_diagnosis_experiment import NOISE, model, scene  # noqa: F401

from sim.cloud import RestCloud
from veo_ti.diagnosis.causes import CATALOGUE
from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.causes.beside import Beside
from veo_ti.diagnosis.causes.courses import along_surface, turned
from veo_ti.diagnosis.causes.loads import HiddenForce, HiddenTether, Patch
from veo_ti.diagnosis.causes.material import Family, FibreAnisotropy
from veo_ti.diagnosis.causes.measurement import CameraScale
from veo_ti.diagnosis.causes.surroundings import HiddenContact, Wall
from veo_ti.diagnosis.intervals import measured, unsure_of_place
from veo_ti.diagnosis.model import shown_by
from veo_ti.diagnosis.placing import better_place, moved
from veo_ti.diagnosis.problem import Problem
from veo_ti.diagnosis.refit import refit
from veo_ti.diagnosis.solved import solved

FORCE = np.array([5e-4, 0.0, 2e-3])
ON_COURSES = [cause for cause in CATALOGUE if type(cause).courses is not Cause.courses]


def filmed(scene, model, cause, place, theta):  # noqa: F811
    """The scene as a cause would have moved it, and noise."""
    true = solved(Problem.of(scene, model, cause, place), scene, np.zeros(len(model.prior)), np.array(theta))
    noise = NOISE * np.random.default_rng(3).normal(size=scene.y.shape)
    return replace(scene, target=replace(scene.target, y=true.scene.y + noise, sigma=NOISE))


def looked_at(scene, model, cause, place, theta, looks: int = 3):  # noqa: F811
    """Refitted there, and at the better places that show."""
    found = refit(scene, model, np.zeros(len(model.prior)), cause=cause, place=place, theta=np.array(theta))
    for _ in range(looks):
        spot = better_place(found, model)
        found = refit(scene, model, spot.coefficients, cause=cause, place=spot.place, theta=spot.theta)
    return found


@pytest.fixture(scope="module")
def spot(scene) -> Patch:  # noqa: F811
    """Half-way between two points of the surface, and narrower than any that is tried."""
    top = scene.cloud.x[:, 2].max()
    on = np.flatnonzero((scene.cloud.x[:, 2] > top - 1e-6) & (scene.cloud.x[:, 0] > 0.4))
    here, other = scene.cloud.x[on[np.argsort(np.linalg.norm(scene.cloud.x[on] - [0.6, 0.2, top], axis=1))[:2]]]
    return Patch(centre=tuple(((here + other) / 2).tolist()), radius=1.7 * scene.cloud.spacing)


@pytest.fixture(scope="module")
def pulled(scene, model, spot):  # noqa: F811
    return filmed(scene, model, HiddenForce(), spot, FORCE)


def test_a_force_is_found_between_the_spots_that_are_tried(scene, model, pulled, spot):  # noqa: F811
    """From the scanned spot next to it; its place to a fraction of a spacing, its size with that."""
    places = HiddenForce().places(scene)
    nearest = min(places, key=lambda p: np.linalg.norm(np.subtract(p.centre, spot.centre)))
    found = looked_at(pulled, model, HiddenForce(), nearest, 0.5 * FORCE)
    off = np.linalg.norm(np.subtract(found.place.centre, spot.centre))
    assert off < 0.1 * scene.cloud.spacing
    assert off < 0.2 * np.linalg.norm(np.subtract(nearest.centre, spot.centre))
    assert found.theta == pytest.approx(FORCE, abs=0.02 * np.linalg.norm(FORCE))
    placed = unsure_of_place(found, {})
    told = {measure.name: (low, high) for measure, low, high in measured(placed)}
    true = dict(zip(("spot_x", "spot_y", "spot_z"), spot.centre, strict=True)) | {"radius": spot.radius}
    assert all(told[name][0] - 1e-9 <= true[name] <= told[name][1] + 1e-9 for name in true)
    alone = replace(placed, placed=replace(placed.placed, elsewhere=()))
    width = {m.name: (high - low) / np.sqrt(placed.off_place) for m, low, high in measured(alone)}
    assert 0 < max(width["spot_x"], width["spot_y"]) < 0.2 * scene.cloud.spacing  # by the noise alone
    assert width["spot_z"] < 1e-6 * scene.cloud.spacing  # it stays on the surface


def test_what_is_promised_at_another_spot_is_what_a_refit_brings_there(scene, model, pulled, spot):  # noqa: F811
    """From the far side of the body, the force turning and growing as it does there."""
    start, places = np.zeros(len(model.prior)), HiddenForce().places(scene)
    by_distance = sorted(places, key=lambda p: np.linalg.norm(np.subtract(p.centre, spot.centre)))
    tried = [by_distance[i] for i in (-1, 3, 1, 0)]
    refits = [refit(pulled, model, start, cause=HiddenForce(), place=at, theta=0.5 * FORCE) for at in tried]
    brought = np.array([r.evidence(model.s2) for r in refits])
    promised = moved(refits[0], model, tried)
    evidence = np.array([p.evidence for p in promised])
    assert brought[-1] > brought[0] + 10
    assert evidence - evidence[0] == pytest.approx(brought - brought[0], abs=0.15 * (brought[-1] - brought[0]))
    for found, told in zip(refits, promised, strict=True):
        assert told.mean[-3:] == pytest.approx(found.theta, abs=0.2 * np.linalg.norm(found.theta))


def test_an_interval_holds_every_spot_that_is_as_likely(scene, model, pulled, spot):  # noqa: F811
    """Those nearby that its own error may hide; all, if that is worth far more."""
    found = refit(pulled, model, np.zeros(len(model.prior)), cause=HiddenForce(), place=spot, theta=FORCE)
    sure, unsure = (unsure_of_place(found, {"hidden_force": nats}) for nats in (0.0, 1e12))
    tried = {at.centre for at in HiddenForce().places(scene)}
    assert tried <= {at.centre for at, _ in unsure.placed.elsewhere}
    assert not tried <= {at.centre for at, _ in sure.placed.elsewhere}
    narrow, wide = ({m.name: (low, high) for m, low, high in measured(r)} for r in (sure, unsure))
    for place, theta in unsure.placed.elsewhere:
        assert all(wide[m.name][0] <= m.value <= wide[m.name][1] for m in HiddenForce().measures(place))
        assert (unsure.interval[0] <= theta).all() and (theta <= unsure.interval[1]).all()
    assert wide["spot_y"][1] - wide["spot_y"][0] > 2 * (narrow["spot_y"][1] - narrow["spot_y"][0])


def test_an_interval_holds_how_unsure_the_spot_is(model, pulled, spot):  # noqa: F811
    """Of one of two causes likewise; where the place is known exactly, it would not."""
    theta, start = np.concatenate([FORCE, np.zeros(4)]), np.zeros(len(model.prior))
    both = Beside(HiddenForce(), CameraScale())
    found = refit(pulled, model, start, cause=both, place=(spot, None), theta=theta)
    whole = unsure_of_place(found, {})
    for one, whole_one in zip(found.apart(), whole.apart(), strict=True):
        alone = unsure_of_place(one, {})
        more = alone.placed.covariance - one.covariance
        assert alone.placed.covariance == pytest.approx(whole_one.placed.covariance)
        assert (np.linalg.eigvalsh(more) > -1e-9 * one.covariance.max()).all()
    force, scale = (unsure_of_place(one, {}) for one in found.apart())
    assert len(measured(force)) == 4 and not measured(scale)  # a scale has no place
    assert (force.spread > 1.02 * found.apart()[0].spread).any()


def test_a_wall_is_found_between_the_gaps_that_are_tried(scene, model):  # noqa: F811
    """A third farther away than it is thought to be, and leaning."""
    low = scene.cloud.x[:, 2].min()
    down = -0.5 * (scene.y[..., 2].min() - low)
    wall = Wall(spot=(1.0, 0.2, low), way=(0.0, 0.0, -1.0), gap=down, wide=True)
    hard = HiddenContact().widths(scene)
    stopped = filmed(scene, model, HiddenContact(), wall, 0.1 * hard)
    leaning = turned(wall.way, 0.06)[0](wall.way, 1.0)
    found = looked_at(stopped, model, HiddenContact(), replace(wall, gap=1.3 * down, way=leaning), 0.1 * hard)
    assert found.place.gap == pytest.approx(down, rel=0.05)
    assert np.dot(found.place.way, wall.way) > np.cos(0.03)


@pytest.mark.parametrize("cause", ON_COURSES, ids=lambda cause: cause.name)
def test_every_course_begins_where_it_is_and_leads_on_evenly(scene, cause):  # noqa: F811
    """What a cause does changes little with a small step, and half as much with half of it."""
    scene = replace(scene, observation=replace(scene.observation, mass=np.float64(0.01)))
    place, theta = list(cause.places(scene))[-1], 0.1 * cause.widths(scene)

    def does(place):
        change = cause.change(scene, theta, place)
        pushes = [term.gradient(scene.y) for term in change.terms]
        return sum(pushes, shown_by(scene, change) - scene.y)

    courses = cause.courses(scene, place)
    assert courses
    for on in courses:
        here, half, whole = (does(on(place, step)) for step in (0.0, 0.01, 0.02))
        assert here == pytest.approx(does(place), abs=1e-9 * np.abs(here).max())
        most = np.abs(whole - here).max()
        assert 0 < most < 0.2 * np.abs(here).max()
        assert np.abs(whole - 2 * half + here).max() < 0.2 * most


def test_ways_along_the_surface_stay_on_it():
    """On a ball: as far away as all its points are, in steps of the length along it, in two directions."""
    lattice = np.stack(np.meshgrid(*[np.linspace(-1, 1, 17)] * 3), axis=-1).reshape(-1, 3)
    ball = RestCloud.build(0.05 * lattice[np.linalg.norm(lattice, axis=1) < 1.01])
    around = np.random.default_rng(0).normal(size=(800, 3))
    shell = 0.05 * around / np.linalg.norm(around, axis=1, keepdims=True)
    cloud = RestCloud.build(np.concatenate([ball.x[np.linalg.norm(ball.x, axis=1) < 0.044], shell]))
    here = cloud.x[-1]
    on = along_surface(_Bare(cloud), here, 0.004)
    moved = np.array([[course(here, steps) for steps in (-1.0, 1.0)] for course in on])
    assert np.linalg.norm(moved, axis=2) == pytest.approx(0.05 * np.ones((2, 2)), rel=0.01)
    sides = moved[:, 1] - moved[:, 0]
    assert np.linalg.norm(sides, axis=1) == pytest.approx([0.008, 0.008], rel=0.05)
    apart = np.array(on[1](on[0](here, 1.0), 1.0)) - on[0](here, 1.0)  # the same way from a step along the other one
    assert apart @ sides[1] > 0.99 * np.linalg.norm(apart) * np.linalg.norm(sides[1])
    assert abs(sides[0] @ sides[1]) < 0.1 * 0.008**2 and np.abs(sides @ here).max() < 0.1 * 0.008 * 0.05


class _Bare:
    """A scene that is a cloud, and nothing held."""

    def __init__(self, cloud: RestCloud) -> None:
        self.cloud, self.free_surface = cloud, np.flatnonzero(cloud.surface)

    def nearest(self, point: np.ndarray) -> int:
        return int(self.free_surface[np.linalg.norm(self.cloud.x[self.free_surface] - point, axis=1).argmin()])


def test_a_patch_lies_on_the_free_surface(scene, spot):  # noqa: F811
    weights = HiddenTether().patch(scene, spot)
    assert weights.sum() == pytest.approx(1) and (weights >= 0).all()
    assert set(np.flatnonzero(weights)) <= set(scene.free_surface)
    one, other = np.argsort(-weights)[[0, 9]]
    far = np.linalg.norm(scene.cloud.x[[one, other]] - spot.centre, axis=1) / spot.radius
    assert weights[other] / weights[one] == pytest.approx(np.exp((far[0] ** 2 - far[1] ** 2) / 2))
    narrow = HiddenTether().patch(scene, replace(spot, radius=1e-3 * spot.radius))
    assert np.sort(narrow)[-3:] == pytest.approx([0, 0.5, 0.5])  # the two that it lies between


def test_an_axis_turns_by_the_angle():
    """To four sides evenly, and with the object."""
    way, beside = np.array([0.6, 0.0, 0.8]), np.array([0.1, 0.3, -0.2])
    around = np.array([on(way, side) for on in turned(way, 0.1, beside) for side in (1.0, -1.0)])
    assert around.mean(axis=0) == pytest.approx(np.cos(0.1) * way)
    turn = Rotation.from_rotvec([0.4, -1.0, 0.7])
    there = turn.apply(way)
    again = np.array([on(there, side) for on in turned(there, 0.1, turn.apply(beside)) for side in (1.0, -1.0)])
    assert turn.apply(around)[:2] == pytest.approx(again[:2])  # the others likewise, or the other way around
    ends = np.array([on(way, 1.0) for on in turned(way, 0.1)])
    assert ends @ way == pytest.approx(np.full(2, np.cos(0.1)))
    assert np.linalg.norm(ends, axis=1) == pytest.approx(np.ones(2))
    assert len(FibreAnisotropy().courses(None, Family(axis=tuple(way)))) == 2
