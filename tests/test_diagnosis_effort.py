"""How much a diagnosis computes is counted and bounded, and what it had no effort for it does not say."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_diagnosis_experiment import model, scene  # noqa: F401
from test_diagnosis_pairs import pair, unexplained_by
from test_diagnosis_refit import measured  # noqa: F401
from test_diagnosis_report import CAUSES, HIDDEN, OPTIONS, observation
from test_diagnosis_unsure import left_by

from veo_ti import cli
from veo_ti.diagnosis import pairs, run
from veo_ti.diagnosis import refit as refits
from veo_ti.diagnosis.effort import LINEARISATION, Effort
from veo_ti.diagnosis.facts import facts
from veo_ti.diagnosis.run import diagnose
from veo_ti.diagnosis.sentence import sentence
from veo_ti.diagnosis.verdict import Verdict, named
from veo_ti.identification import identify

NEVER = {"seconds"}  # twice the same


@pytest.fixture(scope="module")
def identified():
    return identify(observation(HIDDEN), options=OPTIONS)


@pytest.fixture(scope="module")
def whole(identified):
    return diagnose(identified, CAUSES)


def same(found, other):
    told, others = facts(found), facts(other)
    return all(told[key] == others[key] for key in told.keys() - NEVER)


def test_what_is_enough_changes_nothing(identified, whole):
    assert whole.finished and [c.name for c in whole.named] == ["hidden_force"]
    assert same(whole, diagnose(identified, CAUSES, effort=whole.steps + 1))


def test_nothing_is_named_before_every_leader_had_its_looks(identified, whole):
    first = diagnose(identified, CAUSES, second=False).steps
    for effort in (1, first / 2, first):
        found = diagnose(identified, CAUSES, effort=effort)
        assert found.steps <= first and not found.named and not found.finished
        assert facts(found)["sentence"].endswith("What else may be wrong was not looked for to the end.")
        assert {c.name for c in found.rounds[0].candidates} & {"hidden_force"}  # the nearest is told


@pytest.mark.parametrize(("explained", "kind"), [(0.97, "unexplained"), (0.99, "named")])
def test_what_a_name_leaves_that_nobody_could_look_at_may_hold_a_better_one(explained, kind, monkeypatch):
    """The effort ends in the second look; nothing that it said counts."""
    found, said = left_by("a", explained), Verdict(kind="named", causes=(), sentence="")
    first = replace(unexplained_by(found), verdict=named(found), extended=found.refit)
    monkeypatch.setattr(run, "_second", lambda *given: replace(unexplained_by(), verdict=said))
    spent = SimpleNamespace(model=SimpleNamespace(effort=Effort(most=1.0, spent=1.0)))
    rounds = run._rounds(first, spent, [], str)
    assert [r.verdict.kind for r in rounds] == [kind]


def test_no_pair_is_begun_without_effort(monkeypatch):
    start = pair("a", "b", 200).first
    monkeypatch.setattr(pairs, "look", None)  # nobody calls it
    spent = SimpleNamespace(effort=Effort(most=1.0, spent=1.0))
    assert pairs.two_at_once(unexplained_by(start), lambda c: (spent, 1.0), None, [start], str, None) is None


def test_effort_is_positive(tmp_path, capsys):
    observation(HIDDEN, frames=4).save(tmp_path / "box.npz")
    assert cli.main(["diagnose", str(tmp_path / "box.npz"), "--out", str(tmp_path), "--effort", "0"]) != 0
    assert "effort must be positive; got 0" in capsys.readouterr().err


@pytest.mark.parametrize("short", [False, True])
def test_a_fit_that_creeps_ends(measured, model, monkeypatch, short):  # noqa: F811
    """Where every step brings a two-hundredth of the cost, a few tell enough: whole ones, which promise far more, or
    short ones, which do not, and for which old fingerprints serve, but not to the end."""
    costs = []

    def creeping(end, cost, care, least, *, fresh):
        costs.append(cost)
        return (end.state, 0.995 * cost), short, care

    monkeypatch.setattr(refits, "_lower", creeping)
    alone = replace(model, s2=1e-2 * model.s2, effort=Effort())
    found = refits.refit(measured, alone, np.zeros(len(model.prior)))
    assert not found.converged and found.short > 0.1 * costs[0]
    assert 2 <= len(costs) < 5
    if short:
        assert 2 * LINEARISATION <= alone.effort.spent < 3 * LINEARISATION


@pytest.mark.parametrize(("promised", "said"), [(0.05, False), (0.3, True)])
def test_a_name_whose_fit_still_promised_much_says_so(promised, said, whole):
    """Seed 9543: fibres were named rightly, and of the stiffness 3.0 an interval from 0.5 to 2.0 was told."""
    first = whole.rounds[0]
    best = first.verdict.causes[0]
    fit = replace(best.refit, converged=False, short=promised * best.gained)
    verdict = replace(first.verdict, causes=(replace(best, refit=fit),))
    found = replace(whole, rounds=(replace(first, verdict=verdict), *whole.rounds[1:]))
    assert ("less sure than said" in sentence(found)) == said
