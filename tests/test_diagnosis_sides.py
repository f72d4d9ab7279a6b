"""Pairs of causes of which each has one of some and one of others."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_diagnosis_pairs import pair

from veo_ti.diagnosis import pairs


@pytest.mark.parametrize(
    ("names", "sides"),
    [
        (["ab", "ac"], (["a"], ["b", "c"])),
        (["ab", "cb"], (["b"], ["a", "c"])),
        (["ab", "ad", "cd"], (["a", "c"], ["b", "d"])),
        (["ab", "cd", "ad"], (["a", "c"], ["b", "d"])),  # what joins them may come last
        (["ab", "cd"], None),
        (["ab", "bc", "ca"], None),
    ],
)
def test_sides_are_those_of_which_every_pair_has_one_each(names, sides):
    near = [pair(*two, 200.0, leaves=0.001) for two in names]
    assert pairs._sides(near) == sides


def test_where_much_is_left_it_need_not_be_one_of_those():
    assert pairs._sides([pair(*two, 200.0, leaves=0.02) for two in ("ab", "ad", "cd")]) is None


@pytest.mark.parametrize(
    ("names", "lawful", "told"),
    [
        (["ab", "ac"], "c", "ac"),
        (["ab", "ca"], "c", "ca"),  # whichever of the two was found first
        (["ab", "ac"], "bc", None),  # both, so that it tells nothing
        (["ab", "ac"], "a", None),  # what all have in common is named anyway
        (["ab", "cd"], "c", None),
    ],
)
def test_of_two_that_would_do_beside_another_the_one_that_obeys_a_law_is_told(names, lawful, told):
    def obeying(two: str) -> pairs._Pair:
        """Both causes with the parameters that they have together."""
        found = pair(*two, 200.0)
        chances = {name: 0.01 if name in lawful else 1.0 for name in two}
        parts = [
            SimpleNamespace(cause=SimpleNamespace(name=n, coincidence=lambda scene, theta, spread, n=n: chances[n]),
                            scene=None, theta=np.ones(1), spread=np.ones(1), worth=100.0)
            for n in two
        ]  # fmt: skip
        found.second.refit.apart = lambda: parts
        return found

    near = [obeying(two) for two in names]
    found = pairs._lawful(near)
    assert found is (near[names.index(told)] if told else None)
    if found:
        unsettled = replace(found, second=replace(found.second, settled=False))
        assert pairs._lawful([unsettled if p is found else p for p in near]) is None
