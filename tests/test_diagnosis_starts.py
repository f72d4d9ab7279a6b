"""Beside which causes a second one is looked for."""

from dataclasses import replace

import numpy as np
import pytest
from test_diagnosis_pairs import LASTING, pair, unexplained_by

from veo_ti.diagnosis import pairs
from veo_ti.diagnosis.leaders import Refitted


def test_a_cause_is_looked_for_beside_the_second_one_of_the_best_pair_too(monkeypatch):
    """`a` and `x` explain most alone, and `a` with `b` nearly all; but `c`, which nobody tried beside them, with `b`
    all of it."""
    first, better = pair("a", "b", 200, leaves=0.002), pair("b", "c", 400, leaves=0.001)
    b = replace(better.first, explained=0.7)
    starts = [replace(first.first, explained=0.9), replace(pair("x", "y", 10).first, explained=0.88)]
    alone = unexplained_by(*starts, b)
    seconds, asked = {"a": (first.second,), "x": (), "b": (better.second,)}, []

    def look(current, *given, **more):
        asked.append((current.cause.name, more["least"]))
        return replace(alone, candidates=seconds[current.cause.name], tried=Refitted(least=2.0))

    monkeypatch.setattr(pairs, "look", look)
    monkeypatch.setattr(pairs, "_explain", lambda *given: True)
    monkeypatch.setattr(pairs._Pair, "needs_both", True)
    monkeypatch.setattr(pairs._Pair, "alone", lambda self, known, say: [])
    said = pairs.two_at_once(alone, lambda c: (LASTING, 1.0), None, [b], str, None)
    assert asked == [("a", np.inf), ("x", 2.0), ("b", 2.0)]  # each told what the pairs so far leave
    assert [r.verdict.causes[0].name for r in said] == ["b", "c"]


def test_no_further_start_is_tried_where_the_first_two_found_no_second_cause(monkeypatch):
    starts = tuple(replace(pair(n, "y", 10).first, explained=e) for n, e in (("a", 0.9), ("b", 0.89), ("c", 0.88)))
    alone, nothing, asked = unexplained_by(*starts), unexplained_by(), []
    monkeypatch.setattr(pairs, "look", lambda current, *_, **more: asked.append(current.cause.name) or nothing)
    assert pairs.two_at_once(alone, lambda c: (LASTING, 1.0), None, [starts[0]], str, None) is None
    assert asked == ["a", "b"]


@pytest.mark.parametrize(("explained", "tried"), [((0.4, 0.35), ["a"]), ((0.6, 0.4), ["a"]), ((0.25, 0.2), [])])
def test_where_none_explains_half_a_second_is_looked_for_beside_the_best_one(explained, tried, monkeypatch):
    """Two that act against each other may each explain little alone."""
    starts = [replace(pair(n, "y", 10).first, explained=e) for n, e in zip("ab", explained, strict=True)]
    alone, nothing, asked = unexplained_by(*starts), unexplained_by(), []
    monkeypatch.setattr(pairs, "look", lambda current, *_, **more: asked.append(current.cause.name) or nothing)
    assert pairs.two_at_once(alone, lambda c: (LASTING, 1.0), None, [starts[0]], str, None) is None
    assert asked == tried


@pytest.mark.parametrize(("both", "tried"), [("by", ["b"]), ("ab", ["a", "b"]), ("", [])])
def test_two_that_promise_far_more_together_are_starts_however_little_they_explain_alone(both, tried, monkeypatch):
    """Seed 5141: a load that came early and a drag hid each other; alone they explained 0.05 and 0.21."""
    starts = [replace(pair(n, "y", 10).first, explained=e) for n, e in (("a", 0.21), ("b", 0.19))]
    alone, nothing, asked = replace(unexplained_by(*starts), both=frozenset(both)), unexplained_by(), []
    monkeypatch.setattr(pairs, "look", lambda current, *_, **more: asked.append(current.cause.name) or nothing)
    assert pairs.two_at_once(alone, lambda c: (LASTING, 1.0), None, [starts[0]], str, None) is None
    assert asked == tried


@pytest.mark.parametrize(("leaves", "tried"), [(0.09, ["a", "x", "b"]), (0.11, ["a", "x"])])
def test_one_is_also_looked_for_beside_the_second_one_of_a_pair_that_explains_too_little(leaves, tried, monkeypatch):
    """Seed 5145: a creeping material with a camera's scale left 4 %; the drag beside the scale was not looked for."""
    first = pair("a", "b", 200)
    second = replace(first.second, explained=1 - leaves / 0.4)
    starts = [replace(first.first, explained=0.6), *(replace(pair(n, "y", 10).first, explained=0.58) for n in "xb")]
    alone, asked = unexplained_by(*starts), []

    def look(current, *given, **more):
        asked.append(current.cause.name)
        return replace(alone, candidates=(second,) if asked == ["a"] else (), tried=Refitted(least=2.0))

    monkeypatch.setattr(pairs, "look", look)
    assert pairs.two_at_once(alone, lambda c: (LASTING, 1.0), None, starts, str, None) is None
    assert asked == tried
