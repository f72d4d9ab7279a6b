"""A diagnosis that was interrupted goes on where it stopped, and says what one that was not says."""

import json
from dataclasses import replace

import numpy as np
import pytest
from test_diagnosis_effort import identified  # noqa: F401
from test_diagnosis_experiment import NOISE, model, scene  # noqa: F401
from test_diagnosis_placing import creeping  # noqa: F401
from test_diagnosis_report import CAUSES, HIDDEN, OPTIONS, observation

from veo_ti import cli, kept
from veo_ti.diagnosis import leaders
from veo_ti.diagnosis.causes.history import Viscoelasticity
from veo_ti.diagnosis.checkpoints import Checkpoints
from veo_ti.diagnosis.effort import Effort
from veo_ti.diagnosis.fitted import Refit
from veo_ti.diagnosis.problem import Problem
from veo_ti.diagnosis.refit import _best_start, refit
from veo_ti.diagnosis.run import Diagnosis, diagnose
from veo_ti.identification import identify

ASKED = np.array([1.0, -2.0, 0.0])


def interrupted(*given):
    raise KeyboardInterrupt


def begun(monkeypatch, stop_at: int | None = None) -> list[str]:
    """The names of the fits that are begun from now on; the run is interrupted at one of them."""
    names: list[str] = []

    def start(problem: Problem, *given):
        names.append(problem.cause.name if problem.cause else "")
        if len(names) == stop_at:
            raise KeyboardInterrupt
        return _best_start(problem, *given)

    monkeypatch.setattr("veo_ti.diagnosis.refit._best_start", start)
    return names


def said(found: Diagnosis) -> list:
    return [
        (r.verdict.kind, [c.name for c in r.candidates], [c.gained for c in r.candidates],
         [c.refit.sd for c in r.candidates], [c.explained for c in r.candidates]) for r in found.rounds
    ]  # fmt: skip


@pytest.mark.parametrize("stop_at", [1, 2, 4])
def test_only_what_was_not_done_is_done_again(stop_at, identified, tmp_path, monkeypatch):  # noqa: F811
    whole_names = begun(monkeypatch)
    whole = diagnose(identified, CAUSES)
    with pytest.raises(KeyboardInterrupt):
        begun(monkeypatch, stop_at)
        diagnose(identified, CAUSES, checkpoints=tmp_path)
    names = begun(monkeypatch)
    resumed = diagnose(identified, CAUSES, checkpoints=tmp_path)
    assert names == whole_names[stop_at - 1 :]
    assert resumed.steps == pytest.approx(whole.steps, rel=0.05)
    for one, other in zip(said(resumed), said(whole), strict=True):
        assert one[:2] == other[:2]
        for a, b in zip(one[2:], other[2:], strict=True):
            for x, y in zip(a, b, strict=True):
                assert x == pytest.approx(y, rel=1e-3)
    assert [c.name for c in resumed.named] == ["hidden_force"]


def test_a_history_is_taken_up_again(creeping, model, tmp_path):  # noqa: F811
    """What a viscous material remembers belongs to its motion; it is not kept, but found again."""
    at = {"cause": Viscoelasticity(), "place": 1.2, "theta": np.array([0.5])}

    def fitted() -> tuple[Refit, Effort]:
        own = replace(model, checkpoints=Checkpoints(folder=tmp_path, key="this"), effort=Effort())
        return refit(creeping, own, np.zeros(len(model.prior)), **at), own.effort

    (first, spent), (again, also) = fitted(), fitted()
    assert spent.spent == also.spent > 10
    assert again.theta == first.theta and again.theta != 0.5
    assert again.sd == pytest.approx(first.sd, rel=1e-3)
    assert again.evidence(NOISE**2) == pytest.approx(first.evidence(NOISE**2), abs=0.05)
    assert again.scene.y == pytest.approx(first.scene.y, abs=NOISE / 100)


def test_another_measurement_begins_anew(identified, tmp_path, monkeypatch):  # noqa: F811
    diagnose(identified, CAUSES, second=False, checkpoints=tmp_path)
    other = identify(observation(1.1 * HIDDEN), options=OPTIONS)
    names = begun(monkeypatch)
    diagnose(other, CAUSES, second=False, checkpoints=tmp_path)
    assert len(names) >= 2 and names[0] == ""


@pytest.mark.parametrize(
    ("key", "name", "asked", "same"),
    [
        ("this", "a", ASKED, True),
        ("this", "a", ASKED + 1e-4, True),  # solves end with other last digits
        ("this", "a", ASKED + 1e-2, False),
        ("this", "a", ASKED[:2], False),
        ("this", "b", ASKED, False),
        ("that", "a", ASKED, False),
    ],
)
def test_what_is_kept_serves_the_same_fit_only(key, name, asked, same, tmp_path):
    first = Checkpoints(folder=tmp_path, key="this")
    assert first.next("a", ASKED) is None
    first.keep("a", ASKED, {"spent": np.array(2.0)})
    found = Checkpoints(folder=tmp_path, key=key).next(name, asked)
    assert (found is not None) == same and (found is None or found["spent"] == 2.0)


def test_what_another_version_kept_is_not_this_ones(tmp_path, monkeypatch):
    Checkpoints(folder=tmp_path, key=kept.key_of("this"), count=1).keep("drag", ASKED, {"y": ASKED})
    assert Checkpoints(folder=tmp_path, key=kept.key_of("this")).next("drag", ASKED) is not None
    monkeypatch.setattr(kept, "__version__", "0.0.9")
    assert Checkpoints(folder=tmp_path, key=kept.key_of("this")).next("drag", ASKED) is None


def test_a_damaged_checkpoint_is_none(tmp_path):
    (tmp_path / "checkpoint_fit_001.npz").write_bytes(b"PK no")
    assert Checkpoints(folder=tmp_path, key="this").next("a", ASKED) is None


def test_the_command_goes_on_and_leaves_no_checkpoints(tmp_path, monkeypatch):
    observation(HIDDEN, frames=8).save(tmp_path / "box.npz")
    command = ["diagnose", str(tmp_path / "box.npz"), "--modes", "4", "--out", str(tmp_path / "out")]
    monkeypatch.setattr(leaders, "looked", interrupted)
    assert cli.main(command) == 130
    assert list((tmp_path / "out").glob("checkpoint_fit_*.npz"))
    monkeypatch.undo()
    names = begun(monkeypatch)
    assert cli.main(command) == 0
    assert "" not in names  # no baseline is fitted again
    assert json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))["verdict"] == "named"
    assert not list((tmp_path / "out").glob("checkpoint_*"))
