"""Pairs of causes of which each has one of some and one of others."""

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
