"""Which causes are worth a refit."""

from types import SimpleNamespace

from veo_ti.diagnosis.leaders import leaders_of


def scores(*given: tuple[str, float, float]) -> list[SimpleNamespace]:
    return [SimpleNamespace(name=name, log_bayes=nats, keep=keep) for name, nats, keep in given]


def names(found: list[SimpleNamespace]) -> str:
    return "".join(score.name for score in found)


def test_leaders_come_near_the_best_and_others_wait():
    first, others = leaders_of(scores(("a", 100, 1), ("b", 70, 1), ("c", 50, 1), ("d", 45, 1), ("e", 20, 1)), 0.05)
    assert names(first) == "ab" and names(others) == "cd"


def test_what_the_nuisances_imitate_or_no_evidence_speaks_for_is_not_refitted():
    first, others = leaders_of(scores(("a", 100, 0.04), ("b", 1.4, 1), ("c", 90, 0.06)), 0.05)
    assert names(first) == "c" and not others
    assert leaders_of([], 0.05) == ([], [])


def test_at_most_three_wait():
    others = leaders_of(scores(("a", 100, 1), *((name, 40, 1) for name in "bcdefg")), 0.05)[1]
    assert names(others) == "cde"
