"""What is known of a diagnosis before its long part: kept when that is interrupted, or all that is asked for."""

import json

import pytest
from test_diagnosis_report import HIDDEN, observation

from veo_ti import cli
from veo_ti.diagnosis import run
from veo_ti.diagnosis.causes import CATALOGUE


@pytest.fixture
def command(tmp_path):
    observation(HIDDEN, frames=8).save(tmp_path / "box.npz")
    return ["diagnose", str(tmp_path / "box.npz"), "--modes", "4", "--out", str(tmp_path / "out")]


def said(folder):
    return json.loads((folder / "out" / "diagnosis.json").read_text(encoding="utf-8"))


def test_an_interrupted_search_for_more_leaves_the_first_look(command, tmp_path, monkeypatch):
    def interrupted(first, start, others, say):
        say("another look")
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "_rounds", interrupted)
    assert cli.main(command) == 130
    found = said(tmp_path)
    assert not found["finished"] and len(found["rounds"]) == 1
    assert found["rounds"][0]["refitted"][0]["name"] == "hidden_force"


@pytest.mark.parametrize(("flag", "causes"), [("--second", len(CATALOGUE) // 2), ("--no-second", 0)])
def test_no_second_cause_is_looked_for_unasked(flag, causes, command, tmp_path, monkeypatch):
    beside = []
    monkeypatch.setattr(run, "_rounds", lambda first, start, others, say: beside.append(others) or [first])
    assert cli.main([*command, flag]) == 0
    assert said(tmp_path)["finished"] and len(beside[0]) >= causes and bool(beside[0]) == bool(causes)
