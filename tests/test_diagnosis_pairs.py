"""Two causes at once: what both do together, refitted together, and named only where no other pair comes near."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_diagnosis_experiment import NOISE, model, scene  # noqa: F401

from sim.newton import NewtonOptions, equilibrate
from veo_ti.diagnosis import pairs, rounds
from veo_ti.diagnosis.causes.beside import Beside
from veo_ti.diagnosis.causes.clocks import ForceTiming
from veo_ti.diagnosis.causes.dynamics import Damping
from veo_ti.diagnosis.causes.loads import HiddenForce
from veo_ti.diagnosis.causes.measurement import CameraScale, CorrespondenceSlip
from veo_ti.diagnosis.causes.other_loads import ForceMagnitude
from veo_ti.diagnosis.columns import directions_of
from veo_ti.diagnosis.effort import Effort
from veo_ti.diagnosis.misfit import Misfit
from veo_ti.diagnosis.model import shown_by
from veo_ti.diagnosis.moments import Along, moments
from veo_ti.diagnosis.refit import refit
from veo_ti.diagnosis.rounds import Round, look, statistics_of, with_more
from veo_ti.diagnosis.verdict import Candidate, unexplained

FORCE, SCALE = np.array([0.0, 4e-4, 2e-4]), np.array([0.02, 0.0, 3e-3, 0.0])
LASTING = SimpleNamespace(effort=Effort())  # a model


class OtherForce(HiddenForce):
    """The same physics under another name: no measurement tells it apart."""

    name = "other_force"


class OtherScale(CameraScale):
    """Likewise."""

    name = "other_scale"


@pytest.fixture(scope="module")
def both() -> Beside:
    return Beside(HiddenForce(), CameraScale())


@pytest.fixture(scope="module")
def place(scene):  # noqa: F811
    return (list(HiddenForce().places(scene))[5], None)


@pytest.fixture(scope="module")
def filmed(scene, both, place):  # noqa: F811
    """The scene with both effects in what was seen, and noise."""
    change = both.change(scene, np.array([*FORCE, *SCALE]), place)
    energy = replace(scene.energy, terms=(*scene.energy.terms, *change.terms))
    y = equilibrate(energy, scene.y, options=NewtonOptions(tolerance=1e-10)).require_converged().y
    seen = shown_by(scene.moved(energy, y), change)
    noise = NOISE * np.random.default_rng(1).normal(size=seen.shape)
    return replace(scene, target=replace(scene.target, y=seen + noise))


def test_two_causes_push_with_both_and_show_both(scene, both, place):  # noqa: F811
    force, scale = HiddenForce(), CameraScale()
    change = both.change(scene, np.array([*FORCE, *SCALE]), place)
    alone = force.change(scene, FORCE, place[0])
    assert sum(t.gradient(scene.y) for t in change.terms) == pytest.approx(alone.terms[0].gradient(scene.y))
    frames = np.arange(len(scene.y))
    expected = scale.change(scene, SCALE, None).observe(scene.y, frames)
    assert change.observe(scene.y, frames) == pytest.approx(expected)


@pytest.mark.parametrize(("cause", "times"), [(Damping(), 1.0), (CorrespondenceSlip(), 3.0)])
def test_fingerprint_of_a_force_is_shown_as_all_that_is_seen(scene, model, place, cause, times):  # noqa: F811
    """Against other solves with the force both ways, shown as a braked object would be, or one whose points slide."""
    shown = times * cause.widths(scene)
    own = next(iter(cause.places(scene)))
    both, at, theta = Beside(cause, HiddenForce()), (own, place[0]), np.array([*shown, 0.0, 0.0, 0.0])

    def seen(force: float) -> np.ndarray:
        pushed = HiddenForce().change(scene, np.array([0.0, force, 0.0]), place[0])
        energy = replace(scene.energy, terms=(*scene.energy.terms, *pushed.terms))
        y = equilibrate(energy, scene.y, options=NewtonOptions(tolerance=1e-9)).require_converged().y
        return shown_by(moved := scene.moved(energy, y), cause.change(moved, shown, own))

    slope = (seen(2e-5) - seen(-2e-5)) / 4e-5
    K, directions = model.basis.log_mu.shape[1], directions_of(both, scene, at, theta)
    for along, least, most in ((Along.with_cause(both, scene, theta, at), 0.0, 0.003), (Along(), 0.05, np.inf)):
        kept = moments(scene, model.basis, np.zeros(K), (), directions, along=along, keep=True).kept
        found = np.concatenate([X[K + len(shown) + 1] for X in kept.columns])
        expected = np.concatenate([slope[t, scene.target.seen[t]].ravel() for t in kept.frames])
        assert least < np.linalg.norm(found - expected) / np.linalg.norm(expected) < most


def test_refitted_together_both_get_their_sizes(filmed, model, both, place):  # noqa: F811
    start, theta = np.zeros(len(model.prior)), np.zeros(7)
    found = refit(filmed, model, start, cause=both, place=place, theta=theta)
    assert found.converged
    force, scale = found.apart()
    assert (force.cause.name, scale.cause.name) == ("hidden_force", "camera_scale")
    assert np.abs(force.theta - FORCE).max() < 0.1 * np.linalg.norm(FORCE)
    assert (np.abs(force.theta - FORCE) < 4 * force.sd).all()
    assert (np.abs(scale.theta - SCALE) < 4 * scale.sd).all()
    assert len(force.prior) == len(model.prior) + 3 and len(scale.prior) == len(model.prior) + 4


@pytest.mark.parametrize("imitated", [False, True])
def test_two_that_explain_together_what_none_explains_alone_are_named(imitated, filmed, model, monkeypatch):  # noqa: F811
    """Also where another material imitates one of them nearly, but as much speaks for it as for any."""
    plain = rounds.scores_of
    seem = {"camera_scale": {"keep": 0.01}, "force_magnitude": {"log_bayes": 2e6, "explained": 0.5}}

    def scores_of(*given):
        statistics, scores = plain(*given)
        return statistics, tuple(replace(s, **seem.get(s.name, {})) if imitated else s for s in scores)

    monkeypatch.setattr(rounds, "scores_of", scores_of)
    wrong = refit(filmed, model, np.zeros(len(model.prior)))
    causes = [HiddenForce(), CameraScale(), ForceMagnitude(), ForceTiming()]
    modes = model.basis.field.modes[:, :12]
    first = look(wrong, model, NOISE**2, modes, causes, lambda text: None)
    alone = replace(first, verdict=unexplained(()))
    found = pairs.two_at_once(alone, lambda c: (model, NOISE**2), modes, causes, lambda text: None, None)
    assert found is not None
    assert {r.verdict.causes[0].name for r in found} == {"hidden_force", "camera_scale"}
    before, after = (statistics_of(one, model, modes).misfit() for one in (wrong, found[1].verdict.causes[0].refit))
    assert after.excess < 1e-3 * before.excess


def pair(first: str, second: str, evidence: float, short: float = 0.0, leaves: float = 0.002) -> pairs._Pair:
    def candidate(name: str) -> Candidate:
        cause = SimpleNamespace(name=name, sentence=name, exact=False, plain=False)
        told = SimpleNamespace(cause=cause, evidence=lambda s2: evidence)
        told.tuned, told.short, told.converged, told.cost = lambda *_: told, short, not short, 0.0
        left = Misfit(energy=1500 * leaves, mean=0.0, sd=1.0)
        return Candidate(refit=told, gained=100, predicted=100, misfit=left, explained=1 - leaves**0.5, settled=True,
                         plausible=True)  # fmt: skip

    found = SimpleNamespace(s2=1.0)
    return pairs._Pair(first=candidate(first), second=candidate(second), found=found, model=None)


def unexplained_by(*candidates: Candidate) -> Round:
    left = Misfit(energy=0.0, mean=0.0, sd=1.0)
    return Round(misfit=left, scores=(), candidates=candidates, verdict=unexplained(()), s2=1.0)


def test_a_pair_is_alone_only_where_no_other_comes_near():
    best, far, near = pair("a", "b", 200), pair("a", "c", 100), pair("d", "b", 190)
    assert pairs._near([far, best]) == [best]
    assert pairs._near([far, near, best]) == [best, near]
    assert pairs._near([best, pair("b", "a", 199)]) == [best]  # the same two, found the other way round
    assert pairs._near([]) == []
    promising = pair("a", "b", 200, short=60)
    assert pairs._near([promising, far]) == [promising]  # without what it only promises it is still far ahead
    unsure = pair("a", "b", 200, short=90)
    assert pairs._near([unsure, far]) == [unsure, far]
    assert pairs._near([best, pair("a", "c", 190, leaves=0.02)]) == [best]  # it leaves what the best one explains
    better, worse = pair("a", "c", 201, leaves=0.003), pair("a", "c", 199, leaves=0.003)
    assert pairs._near([best], [better]) == [best, better]  # which explains too little, but is likelier
    assert pairs._near([best], [worse]) == pairs._near([best], [replace(better, second=far.second)]) == [best]


@pytest.mark.parametrize(
    ("single", "first_sd", "holds"),
    [
        (0.5, 0.1, True),
        (0.5, 0.5, False),  # the first one is worth nothing any more beside the second
        (0.98, 0.1, False),  # two images of one cause that explains nearly all alone
        (0.92, 0.1, True),  # of which they explain nine tenths
    ],
)
def test_each_of_a_pair_is_worth_its_name(single, first_sd, holds):
    def candidate(name: str, explained: float, **more: object) -> Candidate:
        told = SimpleNamespace(cause=SimpleNamespace(name=name), **more)
        misfit = Misfit(energy=5.0, mean=0.0, sd=1.0)
        return Candidate(refit=told, gained=100, predicted=100, misfit=misfit, explained=explained, settled=True,
                         plausible=True)  # fmt: skip

    joint = SimpleNamespace(theta=np.array([1.0]), sd=np.array([first_sd]))
    first, second = candidate("a", 0.9), candidate("b", 0.93, apart=lambda: (joint, None))
    alone = SimpleNamespace(candidates=[candidate("c", single)])
    both = pairs._Pair(first=first, second=second, found=None, model=None)
    assert (pairs._explain(first, second, alone) and both.needs_both) == holds
    assert not pairs._explain(first, replace(second, certain=False), alone)
    imitated = replace(second, testable=False)  # by another material: more has to be explained
    assert pairs._explain(first, imitated, alone) == pairs._explain(first, second, alone)
    for one in (replace(second, explained=0.75), replace(imitated, explained=0.75)):
        assert pairs._explain(first, one, SimpleNamespace(candidates=[])) == one.testable


def test_what_all_pairs_have_in_common_is_named_and_the_rest_is_ambiguous(filmed, model):  # noqa: F811
    """Two hidden forces at places so near that the data cannot choose, each beside the camera's wrong scale."""
    wrong = refit(filmed, model, np.zeros(len(model.prior)))
    modes = model.basis.field.modes[:, :12]
    causes = [HiddenForce(), OtherForce(), CameraScale()]
    alone = replace(look(wrong, model, NOISE**2, modes, causes, lambda text: None), verdict=unexplained(()))
    said = pairs.two_at_once(alone, lambda c: (model, NOISE**2), modes, causes, lambda text: None, None)
    assert said is not None
    first, second = said
    assert (first.verdict.kind, [c.name for c in first.verdict.causes]) == ("named", ["camera_scale"])
    assert second.verdict.kind == "ambiguous"
    assert {c.name for c in second.verdict.causes} == {"hidden_force", "other_force"}
    assert second.experiment is not None
    parts = {part.cause.name: part for part in second.extended.apart()}
    assert parts["camera_scale"].theta[0] == pytest.approx(SCALE[0], abs=4 * parts["camera_scale"].sd[0])
    assert first.verdict.causes[0].refit.theta[0] == parts["camera_scale"].theta[0]


def test_where_each_of_two_has_a_twin_it_is_one_of_each(filmed, model):  # noqa: F811
    wrong = refit(filmed, model, np.zeros(len(model.prior)))
    modes = model.basis.field.modes[:, :12]
    causes = [HiddenForce(), OtherForce(), CameraScale(), OtherScale()]
    alone = replace(look(wrong, model, NOISE**2, modes, causes, lambda text: None), verdict=unexplained(()))
    said = pairs.two_at_once(alone, lambda c: (model, NOISE**2), modes, causes, lambda text: None, None)
    assert said is not None
    assert [r.verdict.kind for r in said] == ["ambiguous", "ambiguous"]
    sides = {frozenset(c.name for c in r.verdict.causes) for r in said}
    assert sides == {frozenset(("hidden_force", "other_force")), frozenset(("camera_scale", "other_scale"))}
    assert all(r.experiment is not None and r.extended is None for r in said)


def test_with_more_the_better_refit_of_a_cause_counts(filmed, model, place):  # noqa: F811
    wrong, modes = refit(filmed, model, np.zeros(len(model.prior))), model.basis.field.modes[:, :12]
    elsewhere, force = list(HiddenForce().places(filmed))[9], np.array(FORCE)
    at = elsewhere, place[0]
    far, there = (refit(filmed, model, wrong.coefficients, cause=HiddenForce(), place=p, theta=force) for p in at)
    first = look(wrong, model, NOISE**2, modes, [], lambda text: None)
    once = with_more(first, [far], wrong, model, NOISE**2, modes)
    for more in ([there], [far, there], [there, far]):
        assert with_more(once, more, wrong, model, NOISE**2, modes).candidates[0].refit.place is place[0]
    assert with_more(once, [there], wrong, model, NOISE**2, modes).candidates[0].gained > once.candidates[0].gained
    over = replace(model, effort=Effort(most=1.0, spent=2.0))  # others did not get the looks that they needed
    verdicts = (with_more(once, [there], wrong, given, NOISE**2, modes).verdict for given in (model, over))
    assert [v.kind for v in verdicts] == ["named", "unexplained"]
