"""Two causes at once of which one does without the other, once it is where it is beside that."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_diagnosis_experiment import model, scene  # noqa: F401
from test_diagnosis_pairs import FORCE, LASTING, SCALE, both, filmed, pair, place, unexplained_by  # noqa: F401

from veo_ti.diagnosis import pairs
from veo_ti.diagnosis.causes.beside import Beside
from veo_ti.diagnosis.causes.loads import HiddenForce
from veo_ti.diagnosis.causes.measurement import CameraScale
from veo_ti.diagnosis.misfit import Misfit
from veo_ti.diagnosis.refit import refit
from veo_ti.diagnosis.verdict import named


@pytest.mark.parametrize(
    ("alone_there", "leaves", "names"),
    [
        (197.0, 0.03, ["a"]),  # both together are worth 200 nats: no more than one alone
        (180.0, 0.03, ["a", "b"]),
        (180.0, 0.0027, ["a"]),  # more, but only a quarter of what one leaves alone
    ],
)
def test_where_one_of_two_only_had_to_move_it_is_named_alone(alone_there, leaves, names, monkeypatch):
    """Refitted alone where it is beside the other; the pair leaves 0.2 %."""
    two = pair("a", "b", 200, leaves=0.002**2)
    first, second = replace(two.first, explained=0.8), replace(two.second, explained=0.99)
    moved = SimpleNamespace(evidence=lambda s2: alone_there)
    there = replace(first, explained=1 - leaves, misfit=Misfit(energy=15.0, mean=0.0, sd=1.0))
    alone, single = unexplained_by(first), replace(unexplained_by(there), verdict=named(there))
    monkeypatch.setattr(pairs, "look", lambda *given, **more: replace(alone, candidates=(second,)))
    monkeypatch.setattr(pairs, "_borne_out", lambda part: 20.0)
    monkeypatch.setattr(pairs._Pair, "alone", lambda self, known, say: [moved])
    second.refit.apart = lambda: (None, None)
    said = pairs.two_at_once(alone, lambda c: (LASTING, 1.0), None, [second], str, lambda more: single)
    assert [r.verdict.causes[0].name for r in said] == names


@pytest.mark.parametrize(("scale", "alone"), [(SCALE, []), (0 * SCALE, ["hidden_force"])])
def test_what_does_without_the_other_is_refitted_alone_where_it_is(scale, alone, scene, filmed, model, place):  # noqa: F811
    """And explains as much, unless the other one is surely there or it was refitted at that place."""
    shown = CameraScale().change(scene, SCALE - scale, None).observe(scene.y, np.arange(len(scene.y))) - scene.y
    filmed = replace(filmed, target=replace(filmed.target, y=filmed.target.y - shown))
    wrong, two = refit(filmed, model, np.zeros(len(model.prior))), Beside(CameraScale(), HiddenForce())
    joint = refit(filmed, model, wrong.coefficients, cause=two, place=place[::-1], theta=np.array([*scale, *FORCE]))
    second = replace(pair("a", "b", 0.0).second, refit=joint)
    first, there = replace(second, refit=wrong), SimpleNamespace(s2=model.s2)
    found = pairs._Pair(first=first, second=second, found=there, model=model)
    camera, force = (replace(second, refit=part) for part in joint.apart())
    elsewhere = replace(force, refit=replace(force.refit, place=list(HiddenForce().places(filmed))[9]))
    fits = found.alone([camera, elsewhere], str)
    assert [one.cause.name for one in fits] == alone
    assert found.alone([camera, force], str) == []
    for one in fits:
        assert one.evidence(model.s2) > joint.evidence(model.s2)
