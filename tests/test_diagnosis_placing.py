"""Another place of a cause that was refitted: what is promised there is what a refit there brings."""

from dataclasses import replace

import numpy as np
import pytest
from test_diagnosis_experiment import NOISE, model, scene  # noqa: F401

from veo_ti.diagnosis.causes.beside import Beside
from veo_ti.diagnosis.causes.dynamics import Inertia, Ring
from veo_ti.diagnosis.causes.history import Mullins, Softening, Viscoelasticity
from veo_ti.diagnosis.causes.measurement import CameraScale
from veo_ti.diagnosis.fitted import OURS
from veo_ti.diagnosis.intervals import measured, unsure_of_place
from veo_ti.diagnosis.model import shown_by
from veo_ti.diagnosis.placing import better_place, moved
from veo_ti.diagnosis.problem import Problem
from veo_ti.diagnosis.refit import refit
from veo_ti.diagnosis.solved import solved

SHARE, TAU, START = 1.5, 1.2, 2.4  # [s]; frames are a second apart
MASS = 0.05  # [kg]


@pytest.fixture(scope="module")
def creeping(scene, model):  # noqa: F811
    """The scene as a viscous material would have moved, and noise."""
    return crept(scene, model, TAU)


def crept(scene, model, tau: float):  # noqa: F811
    """With another time constant [s]."""
    problem = Problem.of(scene, model, Viscoelasticity(), tau)
    true = solved(problem, scene, np.zeros(len(model.prior)), np.array([SHARE]))
    noise = NOISE * np.random.default_rng(2).normal(size=scene.y.shape)
    return replace(scene, target=replace(scene.target, y=true.scene.y + noise, sigma=NOISE))


def test_what_is_promised_elsewhere_is_what_a_refit_brings_there(creeping, model):  # noqa: F811
    """With all that frames pass on, and the share that goes with the other time constant."""
    places = [START, 0.8 * START, 0.6 * START, 0.5 * START]
    start, half = np.zeros(len(model.prior)), np.array([0.5])
    there = [refit(creeping, model, start, cause=Viscoelasticity(), place=at, theta=half) for at in places]
    found = there[0]
    brought = np.array([r.evidence(model.s2) for r in there])
    promised = np.array([p.evidence for p in moved(found, model, places)])
    assert brought[-1] > brought[0] + 10
    assert promised - promised[0] == pytest.approx(brought - brought[0], abs=0.2 * (brought[-1] - brought[0]))
    spot = better_place(found, model)
    assert abs(np.log(spot.place / TAU)) < 0.4
    there = {"cause": Viscoelasticity(), "place": spot.place}
    problem = Problem.of(creeping, model, **there)
    begun, stayed = (
        solved(problem, found.without, c, t)
        for c, t in ((spot.coefficients, spot.theta), (found.coefficients, found.theta))
    )
    begun, stayed = (problem.cost(s.scene, s.coefficients, s.theta) for s in (begun, stayed))
    best = refit(found.without, model, found.coefficients, **there, theta=found.theta)
    least = problem.cost(best.scene, best.coefficients, best.theta)
    assert begun - least < 0.2 * (stayed - least)


def test_a_cause_that_does_nothing_does_nothing_elsewhere(creeping, model):  # noqa: F811
    found = refit(creeping, model, np.zeros(len(model.prior)), cause=Viscoelasticity(), place=START, theta=np.zeros(1))
    absent = replace(found, theta=np.zeros(1))
    here, there = moved(absent, model, [START, 0.5 * START])
    assert here.evidence == there.evidence


def test_a_move_begins_at_what_is_most_probable_there(creeping, model, monkeypatch):  # noqa: F811
    start, half, begun = np.zeros(len(model.prior)), np.array([0.5]), []
    found = refit(creeping, model, start, cause=Viscoelasticity(), place=START, theta=half)
    spot = better_place(found, model)

    def noted(problem, at, coefficients, theta, *others, **options):
        begun.append(theta)
        return solved(problem, at, coefficients, theta, *others, **options)

    monkeypatch.setattr("veo_ti.diagnosis.refit.solved", noted)
    onward = refit(
        found.without, model, found.coefficients, cause=found.cause, place=spot.place, theta=spot.theta,
        shift=spot.coefficients - found.coefficients, since=found.theta,
    )  # fmt: skip
    assert begun[0] == pytest.approx(spot.theta) and abs(onward.theta[0] - SHARE) < 0.2 * SHARE


def test_a_time_constant_between_those_that_are_tried_is_found(creeping, model):  # noqa: F811
    """A quarter off, nearer than any that is tried."""
    start, half = np.zeros(len(model.prior)), np.array([0.5])
    found = refit(creeping, model, start, cause=Viscoelasticity(), place=1.25 * TAU, theta=half)
    assert abs(np.log(better_place(found, model).place / TAU)) < 0.05


def rung(scene, model, ring: Ring, noise: float):  # noqa: F811
    """What is filmed of an object that was weighed and rings so."""
    weighed, start = replace(scene, observation=replace(scene.observation, mass=MASS)), np.zeros(len(model.prior))
    true = solved(Problem.of(weighed, model, Inertia(), ring), weighed, start, np.ones(1))
    y = shown_by(true.scene, Inertia().change(true.scene, np.ones(1), ring))
    y = y + noise * np.random.default_rng(5).normal(size=scene.y.shape)
    return replace(weighed, target=replace(scene.target, y=y, sigma=NOISE))


def test_a_damping_ratio_between_those_that_are_tried_is_found(scene, model):  # noqa: F811
    """At another one the mass makes up for it, and comes out wrong."""
    ring, start = Ring(ratio=0.12, power=-1), np.zeros(len(model.prior))
    filmed, there = rung(scene, model, ring, NOISE), replace(ring, ratio=0.16)
    found = refit(filmed, model, start, cause=Inertia(), place=there, theta=np.ones(1))
    spot = better_place(found, model, roams=1)
    assert spot.place.ratio == pytest.approx(0.12, rel=0.1)
    again = refit(filmed, model, spot.coefficients, cause=Inertia(), place=spot.place, theta=spot.theta)
    assert abs(again.theta[0] - 1) < min(0.02, 0.5 * abs(found.theta[0] - 1))
    assert better_place(found, model, roams=0).place is found.place


@pytest.mark.parametrize("power", [-1, 1])
def test_how_damping_goes_with_frequency_is_found(scene, model, power):  # noqa: F811
    """From a law that damps the second vibration as much, at a ratio between those that are tried."""
    filmed = rung(scene, model, Ring(ratio=0.12, power=power), 0.2 * NOISE)
    slowest, second = filmed.vibrations.omega[:2]
    there = Ring(ratio=0.12 * (second / slowest) ** power, power=0)
    found = refit(filmed, model, np.zeros(len(model.prior)), cause=Inertia(), place=there, theta=np.ones(1))
    spot = better_place(found, model)
    assert spot.place.power == power and spot.place.ratio == pytest.approx(0.12, rel=0.1)


def test_an_interval_holds_how_unsure_the_time_constant_is(scene, model):  # noqa: F811
    """Against refits nearby: `var = var at this one + (d share / d tau)^2 / (d2 cost / d tau2)`.

    Of a creep that is slow, more of a share with a longer time constant is nearly the same.
    """
    slow, start, half = 5 * TAU, np.zeros(len(model.prior)), np.array([0.5])
    filmed, step = crept(scene, model, slow), 0.05
    tau = slow * np.exp(step * np.arange(-1, 2))
    near = [refit(filmed, model, start, cause=Viscoelasticity(), place=at, theta=half) for at in tau]
    share, cost = np.array([r.theta[0] for r in near]), np.array([r.cost for r in near])
    slope, curve = (share[2] - share[0]) / (2 * step), (cost[0] - 2 * cost[1] + cost[2]) / step**2
    here = near[1]
    placed = unsure_of_place(here, {})
    more = placed.placed.covariance[0, 0] - here.covariance[0, 0]
    assert np.sqrt(more) == pytest.approx(slope / np.sqrt(curve), rel=0.2)  # a step of the course is not a small one
    assert more > here.covariance[0, 0]  # most of what is not known
    assert placed.spread[0] > 1.3 * here.spread[0]
    ((told, low, high),) = measured(placed)
    beside_ours = np.sqrt(1 + 2 * OURS**2 * placed.worth)
    assert (told.name, told.value) == ("time_constant", slow)
    assert np.log(high / slow) == pytest.approx(np.log(slow / low))
    assert np.log(high / low) / (2 * 1.96) == pytest.approx(beside_ours / np.sqrt(curve), rel=0.2)
    assert not measured(here)  # where that was not asked
    assert placed.theta is here.theta and unsure_of_place(replace(here, cause=None), {}).placed is None


def test_of_two_causes_each_goes_along_its_own_course(scene):  # noqa: F811
    both = Beside(Viscoelasticity(), Softening())
    here = (2.0, Mullins(0.1))
    before, after = ([on(here, step) for on in both.courses(scene, here)] for step in (-1.0, 1.0))
    assert before[0][0] < 2.0 < after[0][0] and before[0][1] == after[0][1] == Mullins(0.1)
    assert before[1][1].scale < 0.1 < after[1][1].scale and before[1][0] == after[1][0] == 2.0
    assert [on(here, 0.0) for on in both.courses(scene, here)] == [here] * 2
    assert not Beside(CameraScale(), CameraScale()).courses(scene, (None, None))
