"""What a refit says it shows: the motion of the material it ended at, and a discretisation's part that suits it."""

from dataclasses import replace

import numpy as np
import pytest
from test_diagnosis_experiment import NOISE, model, scene  # noqa: F401

from sim.newton import NewtonOptions, equilibrate
from veo_ti.diagnosis.columns import Known
from veo_ti.diagnosis.effort import Effort
from veo_ti.diagnosis.problem import Problem
from veo_ti.diagnosis.refit import _bent, _tried, refit
from veo_ti.diagnosis.solved import solved
from veo_ti.diagnosis.way import Reached, Way, cost_of

MODE, CHANGE, TIMES = 2, 0.8, 4.0  # of the material, so much from the prior's mean [sd]; of the discretisation's part


@pytest.fixture(scope="module")
def alike(scene, model):  # noqa: F811
    """A measurement of a material off its prior's mean, and a discretisation's part that looks like that material.

    Both together fit it in any mixture, and a mixture is more probable: by less than what a fit goes on for.
    """
    a = np.zeros(len(model.prior))
    a[MODE] = CHANGE * np.sqrt(model.prior[MODE])
    energy = scene.energy.with_elastic(model.basis.elastic(scene.energy.elastic, a))
    y = equilibrate(energy, scene.y, options=NewtonOptions(tolerance=1e-10)).require_converged().y
    seen = y + NOISE / 100 * np.random.default_rng(0).normal(size=y.shape)
    part = Known(motion=TIMES * (y - scene.y))
    both = replace(model, extra=(part,), prior=np.append(model.prior, 1.0), s2=NOISE**2)
    return scene.moved(energy, y), replace(scene.target, y=seen), both, np.append(a, 0.0)


def test_what_is_shown_fits_as_well_as_the_motion_it_ended_at(alike):
    moved, target, both, start = alike
    found = refit(replace(moved, target=target), both, start)
    assert found.converged and found.scene.y == pytest.approx(moved.y, abs=2e-6)  # nothing was worth a step
    assert np.sqrt(2 * found.short) > 0.02  # though a mixture is more probable
    counted = target.seen[..., None]
    left, without = (np.linalg.norm((target.y - y) * counted) for y in (found.shown, found.scene.y))
    assert left <= 1.001 * without
    assert np.linalg.norm(both.extra[0].motion * counted) > 20 * without  # which a little of the part would spoil


@pytest.fixture(scope="module")
def measured(scene, model):  # noqa: F811
    """Data of a material off its prior's mean."""
    a = np.zeros(len(model.prior))
    a[MODE] = CHANGE * np.sqrt(model.prior[MODE])
    energy = scene.energy.with_elastic(model.basis.elastic(scene.energy.elastic, a))
    y = equilibrate(energy, scene.y, options=NewtonOptions(tolerance=1e-10)).require_converged().y
    seen = y + NOISE * np.random.default_rng(0).normal(size=y.shape)
    return replace(scene, target=replace(scene.target, y=seen))


def test_a_step_is_bent_where_the_way_is(scene, model):  # noqa: F811
    """No share of the step towards a softer body costs nearly as little as its end with what that asks for."""
    alone = replace(model, s2=NOISE**2)
    start = model.basis.stiffer(np.zeros(len(model.prior)), -0.2)
    soft = scene.energy.with_elastic(model.basis.elastic(scene.energy.elastic, start))
    y = equilibrate(soft, scene.y, options=NewtonOptions(tolerance=1e-10)).require_converged().y
    measured = replace(scene, target=replace(scene.target, y=y))
    state = solved(Problem.of(measured, alone), measured, np.zeros(len(model.prior)), np.zeros(0))
    here = Reached.of(Problem.of(measured, alone), state)
    cost, step = cost_of(here.line.problem, state), here.way.change
    straight = {share: _tried(here, cost, share * step, None) for share in (0.25, 0.5, 0.75, 1.0)}
    bent = _bent(here, cost, step, *straight[1.0])
    assert bent[1] < 0.1 * min(end for _, end in straight.values())
    assert _bent(here, cost, step, straight[1.0][0], 0.0) == (straight[1.0][0], 0.0)  # which costs less anyway


def test_a_step_past_the_minimum_is_shortened_to_it_where_no_bend_is_told(measured, model, monkeypatch):  # noqa: F811
    """Of half more than the way that fingerprints tell; what is best there is found by trying."""
    monkeypatch.setattr(Way, "bent", lambda way, step, there, s2: step)
    start = np.zeros(len(model.prior))
    problem = Problem.of(measured, replace(model, s2=NOISE**2))
    state = solved(problem, measured, start, np.zeros(0))
    cost = problem.cost(state.scene, start, state.theta)
    here = Reached.of(problem, state)
    whole = here.way.change
    ends = {times: _tried(here, cost, times * whole, None) for times in (0.5, 0.75, 1.0, 1.25, 1.5)}
    brought = cost - _bent(here, cost, 1.5 * whole, *ends[1.5])[1]
    best = cost - min(end for _, end in ends.values())
    assert brought > 0.9 * best > 1.2 * (cost - ends[1.5][1]) > 0


@pytest.mark.parametrize("others", [0, 1])
def test_a_fit_that_goes_on_begins_with_the_fingerprints_it_has(measured, model, others):  # noqa: F811
    """At another noise it ends where a new one does; where other points count it takes fresh ones."""
    start, rough = np.zeros(len(model.prior)), replace(model, s2=(3 * NOISE) ** 2)
    first = refit(measured, rough, start, rough=True)
    seen = measured.target.seen.copy()
    seen[-1, np.flatnonzero(seen[-1])[:others]] = False
    there = replace(first.without, target=replace(first.without.target, seen=seen))
    ends, spent = [], []
    for onward in (None, first):
        fine = replace(model, s2=NOISE**2, effort=Effort())
        ends.append(refit(there, fine, first.coefficients, onward=onward))
        spent.append(fine.effort.spent)
    assert all(end.converged for end in ends)
    assert (spent[0] - spent[1] > 3) == (others == 0)
    a, b = (end.scene.y for end in ends)
    assert np.abs(a - b).max() < 0.1 * NOISE


def test_a_fit_is_given_up_where_more_is_known_elsewhere_than_the_whole_way_may_bring(measured, model):  # noqa: F811
    """The first step tells how low a cost may be in reach: a quarter more than it promises, which here is right."""
    start, rough = np.zeros(len(model.prior)), replace(model, s2=NOISE**2)
    found, first = refit(measured, rough, start), solved(Problem.of(measured, rough), measured, start, np.zeros(0))
    before = Problem.of(measured, rough).cost(first.scene, start, np.zeros(0))
    hopeless, possible = (
        refit(measured, rough, start, most=before - times * (before - found.cost)) for times in (1.4, 0.9)
    )
    assert found.converged and np.abs(found.coefficients - start).max() > 0.1
    assert not hopeless.converged and (hopeless.coefficients == start).all()
    assert possible.coefficients == pytest.approx(found.coefficients)
