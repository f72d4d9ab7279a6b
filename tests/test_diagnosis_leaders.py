"""Which causes are worth a refit."""

from types import SimpleNamespace

import numpy as np
import pytest

from veo_ti.diagnosis import leaders, looks
from veo_ti.diagnosis.effort import Effort
from veo_ti.diagnosis.leaders import as_likely, hiding, leaders_of, likeliest, look_alikes, waiting
from veo_ti.diagnosis.placing import Spot


def scores(*given: tuple[str, float, float], explained: float = 1.0) -> list[SimpleNamespace]:
    return [SimpleNamespace(name=name, log_bayes=nats, keep=keep, explained=explained) for name, nats, keep in given]


def names(found: list[SimpleNamespace]) -> str:
    return "".join(score.name for score in found)


def test_leaders_come_near_the_best_and_others_wait():
    first, others = leaders_of(scores(("a", 100, 1), ("b", 70, 1), ("c", 50, 1), ("d", 45, 1), ("e", 20, 1)), 0.05)
    assert names(first) == "ab" and names(others) == "cd"


def test_what_the_nuisances_imitate_or_no_evidence_speaks_for_is_not_refitted():
    first, others = leaders_of(scores(("a", 100, 0.04), ("b", 1.4, 1), ("c", 90, 0.06)), 0.05)
    assert names(first) == "c" and not others
    assert leaders_of([], 0.05) == ([], [])


def test_what_the_nuisances_imitate_stands_beside_the_leaders_where_as_much_speaks_for_it():
    """Else what is named is only what they imitate less: a tether was taken for fibres (seed 2723)."""
    every = scores(("a", 126, 0.07), ("b", 125, 0.04), ("c", 95, 0.03), ("d", 50, 0.5))
    assert names(as_likely(every, leaders_of(every, 0.05)[0], 0.05)) == "b"
    assert not as_likely(every[1:3], [], 0.05)


def test_what_promises_to_explain_hardly_anything_is_not_refitted():
    """However sure it is: the best of those that promise enough leads."""
    first, others = leaders_of([*scores(("a", 500, 1), explained=0.2), *scores(("b", 100, 1), explained=0.3)], 0.05)
    assert names(first) == "b" and not others


def test_beside_a_cause_those_are_likeliest_for_which_nearly_as_much_speaks():
    """Seed 5102: beside a drag a creeping material promised a third of what was left; a late load nothing."""
    every = [*scores(("a", 237, 0.3), explained=0.29), *scores(("b", 202, 0.4), ("c", 202, 0.04), explained=-0.1)]
    few = scores(("d", 195, 0.4), ("e", 194, 0.3), ("f", 135, 0.4), explained=0.1)
    assert names(likeliest([*every, *few], 0.05)) == "abd"
    assert not likeliest(scores(("a", 19, 1)), 0.05) and not likeliest([], 0.05)


def test_at_most_three_wait():
    others = leaders_of(scores(("a", 100, 1), *((name, 40, 1) for name in "bcdefg")), 0.05)[1]
    assert names(others) == "cde"


def test_all_could_be_next_that_promise_enough_and_were_not_tried():
    """Those that the nuisances imitate, too: a softening was not asked where nothing explained enough (11365)."""
    every = [*scores(("a", 100, 1), *((name, 40, 1) for name in "bcdefg"), ("h", 20, 1), ("i", 50, 0.04)),
             *scores(("j", 50, 1), explained=0.2)]  # fmt: skip
    statistics = SimpleNamespace(together=lambda one, other, noise: 1.0)
    assert names(waiting(every, hiding(statistics, None, every, 0.05), ["a", "c"])) == "bdefgi"
    assert not hiding(statistics, None, [], 0.05) and not waiting([], (), [])


@pytest.mark.parametrize(("both", "found"), [(0.6, "bc"), (0.5, "b")])
def test_two_that_hide_each_other_wait_where_they_promise_far_more_together(both, found):
    """`c` and `d` promise too little alone; one that the nuisances imitate is not asked."""
    hidden = scores(("c", 9, 1), ("d", 8, 1), ("e", 9, 0.01), explained=0.1)
    every = [*scores(("a", 100, 1), ("b", 50, 1), explained=0.3), *hidden]
    asked = []

    def together(one, other, noise):
        asked.append((one.name + other.name, noise))
        return both if one.name + other.name == "cd" else 0.35

    two = hiding(SimpleNamespace(together=together), "noise", every, 0.05)
    assert names(waiting(every, two, ["a", "d"])) == found
    assert asked == [(pair, "noise") for pair in ("ab", "ac", "ad", "bc", "bd", "cd")]


def test_what_can_do_most_of_what_the_best_one_does_is_refitted_too():
    """Unless it was, the nuisances imitate it, or no evidence speaks for it."""
    every = scores(("a", 100, 1), ("b", 70, 1), ("c", 20, 1), ("d", 15, 0.04), ("e", 1, 1), ("f", 50, 1))
    likeness = {"b": 0.9, "c": 0.8, "d": 0.9, "e": 0.9, "f": 0.5}
    statistics = SimpleNamespace(likeness=lambda one, other: likeness[other.name] if one.name == "a" else 0.0)
    assert names(look_alikes("a", statistics, every, 0.05, ["a", "b"])) == "c"
    assert names(look_alikes("a", statistics, every, 0.05, ["a"])) == "bc"
    assert not look_alikes("b", statistics, every, 0.05, ["a", "b"])


@pytest.mark.parametrize(("other_leaves", "beside", "asked"), [
    (2.0, None, True), (2.0, "another", False), (40.0, None, False), (9.5, None, True),
])  # fmt: skip
def test_another_law_is_fitted_where_it_may_matter(other_leaves, beside, asked, monkeypatch):
    """`a` obeys one of two laws, by the first of which it leaves 8 times the noise; the other law leaves only noise.

    Not beside another cause, nor where something else leaves far less.
    """
    left, asked_for = {("a", "first"): 8.0, ("a", "second"): 1.0, ("b", None): other_leaves}, []
    if other_leaves == 40.0:  # a leaves least, and that is noise
        left[("a", "first")] = 1.0

    def cause(name, *laws):
        return SimpleNamespace(name=name, laws=lambda scene: laws)

    def looked_at(found, current, model, floor, modes, say, beside):
        asked_for.append([(s.name, s.place) for s in found])
        tried = [SimpleNamespace(result=SimpleNamespace(cause=s.cause, place=s.place), left=left[s.name, s.place],
                                 model=SimpleNamespace(s2=1.0, effort=Effort())) for s in found]  # fmt: skip
        return tried, 1.0

    def scores_of(current, model, floor, modes, tries):
        return None, [SimpleNamespace(name=one.name, cause=one, place=place) for one, (place,) in tries]

    monkeypatch.setattr(leaders, "_looked_at", looked_at)
    monkeypatch.setattr(leaders, "_narrowed", lambda found, *_: found)
    monkeypatch.setattr(leaders, "beyond", lambda tried, *_: tried)
    monkeypatch.setattr(leaders, "scores_of", scores_of)
    given = [SimpleNamespace(name=c.name, cause=c, place=place) for c, place in (
        (cause("a", "first", "second"), "first"), (cause("b"), None))]  # fmt: skip
    current = SimpleNamespace(cause=beside, scene=None)
    found = leaders.refitted(given, current, None, 1.0, None, print)
    assert (asked_for[1:] == [[("a", "second")]]) == asked and len(asked_for) == 1 + asked
    assert [(r.cause.name, r.place) for r in found.refits] == [("a", "second" if asked else "first"), ("b", None)]


@pytest.mark.parametrize(("leaves", "rough", "followed"), [
    (1.9, 0.0, ["place", "beyond"]), (4.0, 0.0, ["place"]), (6.0, 0.0, []), (6.0, 1.5, ["place"]),
])  # fmt: skip
def test_what_leaves_far_more_than_those_before_gets_no_second_look(leaves, rough, followed, monkeypatch):
    """Neither at another place nor, sooner, beyond the first order, unless it is little of what was wrong; those before
    stay, and the best of them counts."""
    begun, cause = [], SimpleNamespace(name="late")
    before = leaders.Refitted(refits=("first",), s2=1.0, least=1.0, rough=rough)
    result = SimpleNamespace(place="here", cause=cause, evidence=lambda s2: 0.0, coefficients=0.0, theta=0.0)
    result.cost, result.short = 1.0, 0.0
    result.without = None
    late = leaders.Tried(result=result, left=leaves, model=SimpleNamespace(s2=9.0, effort=Effort()), fine=False)
    here, there = (Spot(place=place, coefficients=0.0, theta=0.0) for place in ("here", "there"))
    shown = property(lambda tried: there if tried.roams > 1 else here)
    for name, value in {"tuned": result, "spot": shown, "following": None, "staying": 0}.items():
        monkeypatch.setattr(leaders.Tried, name, value)
    monkeypatch.setattr(leaders, "_narrowed", lambda found, *_: found)
    monkeypatch.setattr(leaders, "tried_once", lambda *_: None)
    monkeypatch.setattr(leaders, "cost_under", lambda *_: 1.0)
    monkeypatch.setattr(leaders.Tried, "of", lambda *_, **more: late)
    monkeypatch.setattr(looks, "_begun", lambda *_: (begun.append("place"), None, None))
    monkeypatch.setattr(looks, "refit", lambda *_, **more: None)
    monkeypatch.setattr(leaders, "beyond", lambda tried, *_: begun.append("beyond") or tried)
    given = [SimpleNamespace(cause=SimpleNamespace(name="late", laws=lambda scene: ()))]
    current = SimpleNamespace(cause="another", scene=None)
    found = leaders.refitted(given, current, SimpleNamespace(s2=9.0, effort=Effort()), 1.0, None, str, beside=before)
    assert begun == followed
    assert found.refits == ("first", result) and found.s2 == 1.0 and found.least == 1.0


@pytest.mark.parametrize("before", [None, 1.0])
def test_a_fit_is_given_up_that_promises_far_less_than_another_reached(before, monkeypatch):
    """One of these, or one before, at what that costs under the model that they are fitted with."""
    asked, costs = [], {"a": 40.0, "b": 4.0, "c": 9.0}

    def tried_once(found, current, model, say, most):
        asked.append(most / 4.0)
        return SimpleNamespace(cost=costs[found.name])

    monkeypatch.setattr(leaders, "tried_once", tried_once)
    monkeypatch.setattr(leaders, "cost_under", lambda model, refit: before)
    monkeypatch.setattr(leaders.Tried, "of", lambda result, *_, fine: SimpleNamespace(result=result, left=1.0))
    monkeypatch.setattr(leaders, "looked", lambda tried, *_: tried)
    model, others = SimpleNamespace(s2=1.0), leaders.Refitted(refits=() if before is None else ("first",))
    tried, _ = leaders._looked_at(scores(*((n, 1, 1) for n in "abc")), None, model, 1.0, None, str, others)
    if before is None:
        assert asked[0] == np.inf and asked[1] == 10 * asked[2] and asked[2] > 2
    else:
        assert asked == 3 * [asked[0]] and 4 * asked[0] > 2 * before
    assert [one.result.cost for one in tried] == list(costs.values())


def test_what_leaves_least_is_looked_at_first_and_the_others_are_held_against_what_it_then_leaves(monkeypatch):
    """In every round; the answer keeps the order of the leaders."""
    lefts, asked = {"a": 3.0, "b": 1.0, "c": 2.0}, []

    def looked(tried, least, enough, modes, say):
        asked.append((tried.result.name, least))
        falls = tried.result.name == "b" and tried.left == 1.0
        return SimpleNamespace(result=tried.result, left=0.1, model=SimpleNamespace(s2=5.0)) if falls else tried

    monkeypatch.setattr(leaders, "tried_once", lambda found, *_: SimpleNamespace(cost=1.0, name=found.name))
    monkeypatch.setattr(leaders.Tried, "of", lambda r, *_, fine: SimpleNamespace(result=r, left=lefts[r.name]))
    monkeypatch.setattr(leaders, "looked", looked)
    given = scores(*((name, 1, 1) for name in lefts))
    tried, reached = leaders._looked_at(given, None, SimpleNamespace(s2=9.0), 1.0, None, str, leaders.Refitted())
    assert asked == [("b", 1.0), ("c", 0.1), ("a", 0.1), ("b", 0.1), ("c", 0.1), ("a", 0.1)]
    assert [one.result.name for one in tried] == list("abc") and reached == 0.1
