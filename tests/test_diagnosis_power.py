"""What a diagnosis says it would have seen, against what it sees."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from test_diagnosis_report import CAUSES, HIDDEN, OPTIONS, observation, sound  # noqa: F401

from veo_ti.diagnosis.facts import _hidden, facts
from veo_ti.diagnosis.run import diagnose
from veo_ti.identification import identify


@pytest.fixture(scope="module")
def smallest(sound) -> float:  # noqa: F811
    """Of a camera's scale."""
    (row,) = [c for c in facts(sound)["ranking"] if c["name"] == "camera_scale"]
    return row["parameters"][0]["smallest_detectable"]


@pytest.mark.parametrize("sign", [1, -1])
def test_an_effect_of_the_smallest_size_is_seen(smallest, sign):
    plain = observation(0 * HIDDEN)
    middle = plain.points[0].mean(axis=0)
    seen = middle + (1 + sign * smallest) * (plain.points - middle)
    seen[0] = plain.points[0]
    answer = diagnose(identify(replace(plain, points=seen), options=OPTIONS), CAUSES)
    assert [c.name for c in answer.named] == ["camera_scale"]
    assert answer.named[0].refit.theta[0] == pytest.approx(sign * smallest, rel=0.3)


def test_what_a_change_of_the_material_imitates_has_no_smallest_size(sound):  # noqa: F811
    (first, *rounds), (score, *others) = sound.rounds, sound.rounds[0].scores
    hidden = replace(first, scores=(replace(score, keep=0.04, log_bayes=100.0), *others))
    row = facts(replace(sound, rounds=(hidden, *rounds)))["ranking"][0]
    assert not row["testable"] and "imitates it: only 4%" in row["why_not"]
    assert all(p["smallest_detectable"] is None for p in row["parameters"])
    seen = SimpleNamespace(named=(SimpleNamespace(name=score.name),), baseline=sound.baseline)
    assert _hidden(seen, hidden.scores[0]) is None  # it leaves little where all others leave much, and is named
