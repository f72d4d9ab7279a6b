"""A name beside which something else is wrong that nothing explains."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from test_diagnosis_pairs import LASTING, pair, unexplained_by

from veo_ti.diagnosis import run
from veo_ti.diagnosis.causes.loads import HiddenForce
from veo_ti.diagnosis.causes.material import StrainStiffening
from veo_ti.diagnosis.verdict import Verdict, either, named, nothing


def left_by(name: str, explained: float):
    """A candidate that leaves clear misfit."""
    found = pair(name, "y", 10).first
    return replace(found, explained=explained, misfit=replace(found.misfit, energy=100.0))


@pytest.mark.parametrize(
    ("other", "second", "kind", "names"),
    [
        (0.96, "unexplained", "ambiguous", ["a", "b"]),  # nearly all as well: what else is wrong may be beside either
        (0.94, "unexplained", "named", ["a"]),  # too little to be a name itself
        (0.96, "no_misfit", "named", ["a"]),
    ],
)
def test_what_explains_nearly_all_as_well_may_be_it(other, second, kind, names, monkeypatch):
    """`a` explains more than `b`, which was not refitted at first."""
    a, b = left_by("a", 0.99), left_by("b", other)
    first = replace(unexplained_by(a), verdict=named(a))
    start = SimpleNamespace(given=(), beside=None, modes=None, model=LASTING)
    more = replace(unexplained_by(), verdict=Verdict(kind=second, causes=(), sentence=""))
    monkeypatch.setattr(run, "_second", lambda *given: more)
    monkeypatch.setattr(run, "widened", lambda found, *given: replace(found, candidates=(a, b)))
    monkeypatch.setattr(run, "two_at_once", lambda *given, but: None)  # no pair is found
    verdict = run._rounds(first, start, [], str)[0].verdict
    assert (verdict.kind, [c.name for c in verdict.causes]) == (kind, names)


@pytest.mark.parametrize(
    ("explained", "energy", "second", "kind"),
    [
        (0.97, 100.0, "unexplained", "unexplained"),  # seed 2892: a soft spot that wanders passed for a drift
        (0.99, 100.0, "unexplained", "named"),  # little
        (0.97, 15.0, "unexplained", "named"),  # not clear
        (0.97, 100.0, "named", "named"),  # something else that is known
    ],
)
def test_what_leaves_clearly_more_than_a_little_that_nothing_explains_is_no_name(
    explained, energy, second, kind, monkeypatch
):
    a = left_by("a", explained)
    a = replace(a, misfit=replace(a.misfit, energy=energy))
    first = replace(unexplained_by(a), verdict=named(a), extended=a.refit)
    more = replace(unexplained_by(), verdict=Verdict(kind=second, causes=(), sentence=""))
    monkeypatch.setattr(run, "_second", lambda *given: more)
    monkeypatch.setattr(run, "widened", lambda found, *given: found)
    found = run._rounds(first, SimpleNamespace(given=(), beside=None, modes=None, model=LASTING), [], str)
    assert found[0].verdict.kind == kind
    assert (len(found), found[0].extended) == ((2, a.refit) if kind == "named" else (1, None))


@pytest.mark.parametrize(("converged", "energy", "kind"), [
    (False, 100.0, "unexplained"), (True, 100.0, "named"), (False, 15.0, "named"),
])  # fmt: skip
def test_what_a_fit_leaves_that_did_not_end_is_not_little(converged, energy, kind, monkeypatch):
    """Seed 7741: a tilt left 0.4 % of a body that its own weight had folded, clearly, and nothing explained that."""
    a = left_by("a", 0.99)
    a = replace(a, refit=SimpleNamespace(**vars(a.refit) | {"converged": converged}))
    a = replace(a, misfit=replace(a.misfit, energy=energy))
    first = replace(unexplained_by(a), verdict=named(a), extended=a.refit)
    more = replace(unexplained_by(), verdict=Verdict(kind="unexplained", causes=(), sentence=""))
    monkeypatch.setattr(run, "_second", lambda *given: more)
    monkeypatch.setattr(run, "widened", lambda found, *given: found)
    found = run._rounds(first, SimpleNamespace(given=(), beside=None, modes=None, model=LASTING), [], str)
    assert found[0].verdict.kind == kind


@pytest.mark.parametrize(
    ("explained", "energy", "visible", "kind"),
    [
        (0.993, 21.0, True, "unexplained"),  # seed 9385: a snap dome passed for a stiffening
        (0.983, 6.0, True, "named"),  # not clear: a stiffening that was there
        (0.997, 21.0, True, "named"),  # as little as our own error of its effect
        (0.993, 21.0, False, "named"),  # or of the motion, where the points are too few for the body
    ],
)
def test_a_plain_law_that_leaves_more_than_noise_is_no_name(explained, energy, visible, kind, monkeypatch):
    """Beside it a change of the material would take up what is off about it. What else is wrong is below our error."""
    a = left_by("a", explained)
    a = replace(a, misfit=replace(a.misfit, energy=energy), visible=visible)
    a = replace(a, refit=SimpleNamespace(**vars(a.refit) | {"cause": StrainStiffening()}))
    first = replace(unexplained_by(a), verdict=named(a), extended=a.refit)
    more = replace(unexplained_by(), verdict=nothing())
    monkeypatch.setattr(run, "look", lambda *given, **more_given: more)
    monkeypatch.setattr(run, "widened", lambda found, *given: found)
    start = SimpleNamespace(given=(), beside=lambda found: (LASTING, 1.0), modes=None, model=LASTING)
    assert run._rounds(first, start, [HiddenForce()], str)[0].verdict.kind == kind


@pytest.mark.parametrize(("beside", "kind"), [(None, "named"), ("unexplained", "unexplained")])
def test_what_was_not_refitted_at_first_takes_the_place_of_what_leaves_something_that_nothing_explains(
    beside, kind, monkeypatch
):
    """Seed 7083: a drag promised half of what a creeping material did. Once all are refitted there are no others."""
    a, b = left_by("a", 0.97), left_by("b", 0.975)
    first = replace(unexplained_by(a), verdict=named(a), extended=a.refit)
    seen, wide = [], []

    def second(found, *given):
        seen.append(found.name)
        if found.name == "b" and beside is None:
            return None
        return replace(unexplained_by(), verdict=Verdict(kind="unexplained", causes=(), sentence=""))

    def widened(found, *given):
        wide.append(found)
        return replace(found, candidates=(b,), verdict=named(b), extended=b.refit)

    monkeypatch.setattr(run, "_second", second)
    monkeypatch.setattr(run, "widened", widened)
    found = run._rounds(first, SimpleNamespace(given=(), beside=None, modes=None, model=LASTING), [], str)
    assert seen == ["a", "b"] and len(wide) == 1
    assert found[0].verdict.kind == kind and (found[0].extended is b.refit) == (kind == "named")


@pytest.mark.parametrize("explains", [True, False])
def test_before_two_at_once_all_that_promise_something_are_refitted(explains, monkeypatch):
    """Seed 7107: a creeping material or a late load left clear misfit, and a drag, of which neither is the image, was
    not tried."""
    a, b, c = left_by("a", 0.96), left_by("b", 0.9), left_by("c", 0.9999)
    first, asked = replace(unexplained_by(a, b), verdict=either((a, b))), []

    def widened(found, *given):
        asked.append("others")
        return replace(found, candidates=(c, a, b), verdict=named(c)) if explains else found

    monkeypatch.setattr(run, "_second", lambda *given: None)
    monkeypatch.setattr(run, "widened", widened)
    monkeypatch.setattr(run, "two_at_once", lambda *given, but: asked.append("two"))
    found = run._rounds(first, SimpleNamespace(given=(), beside=None, modes=None, model=LASTING), [a.refit.cause], str)
    assert asked == (["others"] if explains else ["others", "two"])
    assert [one.name for one in found[0].verdict.causes] == (["c"] if explains else ["a", "b"])


@pytest.mark.parametrize(
    ("explained", "energy", "better", "kind", "names", "exact"),
    [
        (0.994, 9.0, 0.9999, "named", ["b"], False),  # seed 9084: a drag was called a creeping material
        (0.994, 9.0, None, "named", ["a"], False),
        (0.994, 3.0, 0.9999, "named", ["a"], False),  # it leaves noise
        (0.998, 9.0, 0.9999, "named", ["a"], False),  # or what our own error of it may be,
        (0.998, 9.0, 0.9999, "named", ["b"], True),  # which is less of a steady force;
        (0.9997, 9.0, 0.9999, "named", ["a"], True),  # not none
        (0.994, 9.0, 0.994, "ambiguous", ["a", "b"], False),
    ],
)
def test_others_are_refitted_too_where_a_name_leaves_more_than_noise(
    explained, energy, better, kind, names, exact, monkeypatch
):
    """Though there is nothing to look for in what it leaves."""
    a, b = left_by("a", explained), left_by("b", better or 0.0)
    a = replace(a, misfit=replace(a.misfit, energy=energy))
    a.refit.cause.exact = exact
    first = replace(unexplained_by(a), verdict=named(a), extended=a.refit)
    then = {"named": named(b), "ambiguous": either((a, b))}[kind] if better else named(a)
    monkeypatch.setattr(run, "_second", lambda *given: None)
    monkeypatch.setattr(run, "widened", lambda found, *given: replace(found, candidates=(a, b), verdict=then))
    start = SimpleNamespace(given=(), beside=None, modes=None, model=LASTING)
    for causes in ([a.refit.cause], []):  # the latter where no second look was asked for
        found = run._rounds(first, start, causes, str)
        told = [c.name for c in found[0].verdict.causes]
        assert (found[0].verdict.kind, told) == ((kind, names) if causes else ("named", ["a"]))


@pytest.mark.parametrize(
    ("exact", "energy", "found", "names"),
    [
        (True, 100.0, True, ["b", "c"]),  # seed 5083: a tilt and a force looked like another force
        (True, 100.0, False, ["a"]),  # noise that neighbours share, as it seems
        (False, 100.0, True, ["a"]),
        (True, 15.0, True, ["a"]),  # not clear
    ],
)
def test_what_an_exact_cause_leaves_evenly_and_clearly_may_be_that_of_two_others(
    exact, energy, found, names, monkeypatch
):
    a, b, c = left_by("a", 0.998), left_by("b", 0.98), left_by("c", 0.9)
    a = replace(a, misfit=replace(a.misfit, energy=energy))
    a.refit.cause.exact = exact
    first = replace(unexplained_by(a), verdict=named(a), extended=a.refit)
    more = replace(unexplained_by(), verdict=Verdict(kind="no_misfit", causes=(), sentence=""))
    both = tuple(replace(unexplained_by(one), verdict=named(one)) for one in (b, c))
    monkeypatch.setattr(run, "_second", lambda *given: more)
    monkeypatch.setattr(run, "widened", lambda found, *given: replace(found, candidates=(a, b), verdict=named(a)))
    monkeypatch.setattr(run, "two_at_once", lambda *given, but: both if found else None)
    start = SimpleNamespace(given=(), beside=None, modes=None, model=LASTING)
    rounds = run._rounds(first, start, [a.refit.cause], str)
    assert [one.name for r in rounds for one in r.verdict.causes] == names
