"""Wrong input ends in one sentence that names the array, the rule and what was there instead."""

import numpy as np
import pytest

from sim.checks import as_array, require, some


def test_failed_requirement_is_one_sentence():
    with pytest.raises(ValueError, match=r"^mu must be positive; got -1.0$"):
        require(False, "mu", "be positive", -1.0)


def test_met_requirement_is_silent():
    require(True, "mu", "be positive", 1.0)


def test_array_comes_out_contiguous_and_cast():
    array = as_array("y", np.asfortranarray(np.ones((4, 3), np.float32)), (None, 3))
    assert array.flags.c_contiguous
    assert array.dtype == np.float64


@pytest.mark.parametrize("value", [np.zeros(3), np.zeros((2, 4)), np.zeros((1, 2, 3)), 0.0])
def test_wrong_shape_is_named(value):
    with pytest.raises(ValueError, match=r"^y must have shape \(any, 3\); got \("):
        as_array("y", value, (None, 3))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_first_value_that_is_not_finite_is_located(bad):
    y = np.zeros((4, 3))
    y[2, 1] = y[3, 0] = bad
    with pytest.raises(ValueError, match=r"^y must be finite; got 2 NaN or infinite values, the first at \(2, 1\)$"):
        as_array("y", y, (None, 3))


@pytest.mark.parametrize("value", ["stiff", [[1, 2, 3], [4, 5]], {"a": 1}])
def test_what_is_no_array_is_refused(value):
    with pytest.raises(ValueError, match=r"^y must be an array of float64; got (str|list|dict)$"):
        as_array("y", value, (None, 3))


def test_indices_are_listed_up_to_a_few():
    assert some(np.array([3, 17])) == "3, 17"
    assert some(np.arange(46)) == "0, 1, 2, 3, 4 and 41 more"
