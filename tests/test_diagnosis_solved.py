"""Equilibria under a cause that follows the motion: the motion is the one that its own history leads to."""

from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_diagnosis_experiment import NOISE, model, scene  # noqa: F401

from sim.newton import NewtonOptions, equilibrate
from veo_ti.diagnosis.causes.beside import Beside
from veo_ti.diagnosis.causes.dynamics import Damping
from veo_ti.diagnosis.causes.history import Mullins, PermanentSet, Softening, StiffnessDrift, Viscoelasticity
from veo_ti.diagnosis.causes.loads import HiddenForce
from veo_ti.diagnosis.causes.material import StrainStiffening, VolumetricLaw
from veo_ti.diagnosis.causes.other_loads import FollowerLoad
from veo_ti.diagnosis.fitted import everywhere
from veo_ti.diagnosis.model import shown_by
from veo_ti.diagnosis.problem import Problem
from veo_ti.diagnosis.refit import _Care, _lower, refit
from veo_ti.diagnosis.solved import Solved, solved
from veo_ti.diagnosis.way import Reached, Way

STRONG = {Viscoelasticity: 2.0, PermanentSet: 0.4, Softening: 0.7}


@pytest.mark.parametrize(
    ("cause", "which"), [*((make(), 0) for make in STRONG), (Softening(), -1), (PermanentSet(), -1)]
)
def test_motion_is_the_one_that_its_own_history_leads_to(cause, which, scene, model):  # noqa: F811
    """One more round, solved tightly, leaves it where it is, to a tenth of the noise."""
    scene = replace(scene, target=replace(scene.target, sigma=NOISE))
    theta, place = np.array([STRONG[type(cause)]]), list(cause.places(scene))[which]
    problem = Problem.of(scene, model, cause, place)
    found = solved(problem, scene, np.zeros(len(model.prior)), theta)
    assert found.found
    energy = found.without.energy
    change = problem.change(found.scene.of_material(energy.elastic), theta)
    whole = replace(energy, terms=(*scene.energy.terms, *change.terms))
    again = equilibrate(whole, found.scene.y, options=NewtonOptions(tolerance=1e-9)).require_converged()
    assert np.sqrt(((again.y - found.scene.y) ** 2).mean()) < 0.1 * NOISE
    assert np.abs(found.scene.y - scene.y).max() > NOISE  # it does something


def test_a_hopeless_motion_is_not_followed_to_its_end(scene, model, monkeypatch):  # noqa: F811
    """Once a round costs too much it is what is returned, at a cost beyond the bound; under any other bound nothing
    changes."""
    cause, theta = Softening(), np.array([STRONG[Softening]])
    problem, still = Problem.of(scene, model, cause, next(iter(cause.places(scene)))), np.zeros(len(model.prior))

    def cost(most: float) -> float:
        found = solved(problem, scene, still, theta, most=most)
        return problem.cost(found.scene, still, theta)

    whole = cost(np.inf)
    monkeypatch.setattr("sim.through_time._FAR", 0.0)  # so that rounds come after the first step
    assert cost(np.inf) == cost(1e3 * whole) == pytest.approx(whole, rel=1e-2)
    assert 1e-3 * whole < cost(1e-3 * whole) != whole


@pytest.mark.parametrize(
    ("cause", "which"), [(VolumetricLaw(), 0), (HiddenForce(), 0), (Viscoelasticity(), 0), (Softening(), -1)]
)
def test_a_motion_is_foreseen_to_second_order(cause, which, scene, model):  # noqa: F811
    """Half the step, a quarter of the error, of the material's change and the cause's together."""
    scene = replace(scene, target=replace(scene.target, sigma=1e-3 * NOISE))
    problem, n = Problem.of(scene, model, cause, list(cause.places(scene))[which]), len(model.prior)
    here = np.concatenate([np.zeros(n), 0.2 * cause.widths(scene)])
    change = np.concatenate([np.full(n, 0.1), 0.1 * cause.widths(scene)])

    def at(unknowns: np.ndarray) -> Solved:
        return solved(problem, scene, unknowns[:n], unknowns[n:])

    start = at(here)
    line = Reached.of(problem, start).line
    errors = [np.abs(line.ahead(start.scene, s * change).y - at(here + s * change).scene.y).max() for s in (0.2, 0.1)]
    assert errors[0] < 0.15 * np.abs(at(here + 0.2 * change).scene.y - start.scene.y).max()
    assert 3 < errors[0] / errors[1] < 5


def test_what_would_turn_a_frame_inside_out_is_not_foreseen(scene, model):  # noqa: F811
    problem = Problem.of(scene, model)
    start = solved(problem, scene, np.zeros(len(model.prior)), np.zeros(0))
    line = Reached.of(problem, start).line
    far = line.ahead(start.scene, 15.0 * np.eye(len(model.prior))[0])
    kept = (far.y == start.scene.y).all(axis=(1, 2))
    np.testing.assert_array_equal(kept, [True, False, False, True, False, False, True])  # unloaded, and loaded most
    assert np.linalg.det(far.F).min() > 0


def test_frames_that_do_not_train_wait_for_the_end(scene, model):  # noqa: F811
    """They cost no solve, and are then in the equilibrium that all frames together have."""
    every = solved(Problem.of(scene, model), scene, np.full(len(model.prior), 0.3), np.zeros(0))
    some = replace(scene, train=np.arange(len(scene.y)) != 3)
    fitted = refit(some, model, np.zeros(len(model.prior)))
    found = solved(Problem.of(some, model), some, every.coefficients, every.theta).scene
    np.testing.assert_array_equal(found.y[3], scene.y[3])
    np.testing.assert_allclose(found.y[some.train], every.scene.y[some.train], atol=1e-9)
    at = everywhere(replace(fitted, scene=found, without=found)).scene
    np.testing.assert_allclose(at.y, every.scene.y, atol=1e-6)


@pytest.mark.parametrize("cause", [Damping(), Viscoelasticity(), Beside(HiddenForce(), Damping())], ids=type)
def test_frames_that_others_depend_on_do_not_wait(cause, scene, model):  # noqa: F811
    """What lags behind the motion shows that of frames before, whether they train or not."""
    parts = (cause.found, cause.other) if isinstance(cause, Beside) else (cause,)
    places = tuple(next(iter(part.places(scene))) for part in parts)
    place, some = places if len(places) > 1 else places[0], replace(scene, train=np.arange(len(scene.y)) != 3)
    softer, theta = np.full(len(model.prior), -0.3), 0.1 * cause.widths(scene)
    seen = []
    for at in (scene, some):
        problem = Problem.of(at, model, cause, place)
        found = solved(problem, at, softer, theta).scene
        seen.append(shown_by(found, problem.change(found, theta)))
    assert np.abs(seen[0][4] - scene.y[4]).max() > NOISE
    np.testing.assert_allclose(seen[1], seen[0], atol=1e-3 * NOISE)


def test_no_step_takes_all_of_a_material_away():
    both, at = Beside(StiffnessDrift(), Softening()), (0.0, Mullins(0.1))
    far = both.stepped(np.zeros(2), np.array([7.0, 3.0]), at)
    assert far == pytest.approx([7.0, 1 - np.exp(-2.0)])
    more = both.stepped(far, np.array([0.0, 5.0]), at)
    assert more[1] == pytest.approx(8 / 9)  # beyond, stress falls as strain grows


def test_a_share_and_the_stiffness_that_gives_it_back_are_straight_against_each_other():
    """log(1 - d) moves by what the slope at the start says, however long the step; a short step is the slope itself."""
    cause, start, step, at = Softening(), np.array([0.4]), np.array([0.3]), Mullins(0.1)
    after = cause.stepped(start, step, at)
    assert np.log1p(-after) - np.log1p(-start) == pytest.approx(-step / (1 - start))
    assert cause.stepped(start, 1e-6 * step, at) - start == pytest.approx(1e-6 * step, rel=1e-5)
    assert np.isfinite(cause.stepped(start, np.array([-1e3]), at)).all()


@pytest.mark.parametrize("cause", [*(make() for make in STRONG), FollowerLoad()], ids=lambda c: c.name)
def test_columns_are_slopes_of_the_motion_with_its_history(cause, scene, model, monkeypatch):  # noqa: F811
    """Of the material and of the cause itself, beside a strong cause, in the frames long after too.

    The set's weights are taken as given. Without what frames pass on, to later ones or a load that turns to its own,
    the columns are off by a third and more.
    """
    monkeypatch.setattr("veo_ti.diagnosis.solved._ROUNDS", 40)
    monkeypatch.setattr("veo_ti.diagnosis.solved.NEWTON", NewtonOptions(tolerance=1e-9, iterations=40))
    scene = replace(scene, target=replace(scene.target, sigma=1e-9))
    problem = Problem.of(scene, model, cause, next(iter(cause.places(scene))))
    n, h = len(model.prior), 1e-3

    def at(unknowns: np.ndarray) -> Solved:
        return solved(problem, scene, unknowns[:n], unknowns[n:])

    here = np.array([*np.full(n, 0.1), STRONG.get(type(cause), 0.8)])
    columns = Reached.of(problem, at(here)).line.kept
    for k in (2, n):
        step = h * np.eye(n + 1)[k]
        slope = (at(here + step).scene.y - at(here - step).scene.y) / (2 * h)
        for t, X in zip(columns.frames, columns.columns, strict=True):
            expected = slope[t, scene.target.seen[t]].ravel()
            assert np.linalg.norm(X[k] - expected) <= 0.01 * np.linalg.norm(expected)


def reached(problem, way: Way, **state) -> SimpleNamespace:
    """A state that is no motion, and the way on from it."""
    line = SimpleNamespace(problem=problem, ahead=lambda motion, change: motion)
    return SimpleNamespace(state=SimpleNamespace(scene=None, factors=None, **state), line=line, way=way)


def of_one(whole: float) -> Way:
    """The way of one unknown, which is no material's."""
    bowl = {"curvature": np.eye(1), "room": np.full(1, np.inf), "log_mu": np.zeros((1, 0))}
    return Way(normal=None, found=None, whole=np.array([whole]), **bowl)


@pytest.mark.parametrize(
    ("beyond", "shares", "care", "less"),
    [
        (np.inf, [1.0, 0.3, 0.09], _Care(share=0.09), _Care(share=0.3)),
        (1.0, [1.0, 1 / 1.01, 1 / 1.1, 1 / 2, 1 / 11], _Care(damping=10.0), _Care(damping=1.0)),
    ],
)
def test_a_step_without_equilibrium_is_shortened_and_one_that_costs_more_damped(
    beyond, shares, care, less, monkeypatch
):  # fmt: skip
    """As one beyond 0.15 does; so is the next one. Damping d shortens a step to 1 / (1 + d)."""
    tried: list[float] = []

    def fake(problem, near, coefficients, theta, factors, *, most):
        tried.append(float(coefficients[0]))
        return SimpleNamespace(coefficients=coefficients)

    def cost(problem, trial):
        return beyond if trial.coefficients[0] > 0.15 else -trial.coefficients[0]

    monkeypatch.setattr("veo_ti.diagnosis.refit.solved", fake)
    monkeypatch.setattr("veo_ti.diagnosis.refit.cost_of", cost)
    monkeypatch.setattr("veo_ti.diagnosis.refit._bent", lambda end, cost, step, trial, lower: (trial, lower))
    free = SimpleNamespace(stepped=lambda theta, change: theta, turned=lambda theta, before: False)
    here = reached(free, of_one(1.0), coefficients=np.zeros(1), theta=np.zeros(0))
    (state, _), _, found = _lower(here, 0.0, _Care(), 0.5, fresh=True)
    assert tried == pytest.approx(shares) and state.coefficients == tried[-1]
    assert asdict(found) == pytest.approx(asdict(care))
    (state, _), _, found = _lower(here, 0.0, found, 0.5, fresh=True)
    assert state.coefficients == tried[-2] and asdict(found) == pytest.approx(asdict(less))  # it was possible at once
    monkeypatch.setattr("veo_ti.diagnosis.refit.cost_of", lambda problem, trial: -trial.coefficients[0])
    (state, _), told, found = _lower(here, 0.0, _Care(), 0.5, fresh=True)
    assert (state.coefficients, told, found) == (1.0, True, _Care())  # Newton's own step, as there always is one


def test_what_must_be_positive_is_never_tried_otherwise(monkeypatch):
    """Yeoh's beta below zero leaves a body without equilibrium, which is slow to find out: such steps are damped."""
    tried: list[float] = []

    def fake(problem, near, coefficients, theta, factors, *, most):
        tried.append(float(theta[0]))
        return SimpleNamespace(coefficients=coefficients, theta=theta)

    monkeypatch.setattr("veo_ti.diagnosis.refit.solved", fake)
    monkeypatch.setattr("veo_ti.diagnosis.refit.cost_of", lambda problem, trial: float(trial.theta[0]))
    monkeypatch.setattr("veo_ti.diagnosis.refit._bent", lambda end, cost, step, trial, lower: (trial, lower))
    beta = StrainStiffening()
    problem = Problem(model=SimpleNamespace(), base=None, cause=beta, place=None, prior=np.ones(1))
    way = of_one(-1.5)
    here = reached(problem, way, coefficients=np.zeros(0), theta=np.array([1.0]))
    (state, _), _, care = _lower(here, 1.0, _Care(), 0.5, fresh=True)
    assert tried == pytest.approx([1 - 1.5 / 2]) == state.theta and care == _Care(damping=1.0)
    assert problem.turned(np.array([-0.1]), np.array([0.1]))
    assert not problem.turned(np.array([-0.2]), np.array([-0.1]))  # what began there may stay
