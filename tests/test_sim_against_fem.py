"""The simulator in its two modes beside finite elements: a cantilever bent by 8, 22, 41 % and a two-material block."""

import numpy as np
import pytest
from fem_ratios import SAMPLINGS, block_ratio, cantilever_ratios


@pytest.mark.parametrize("kind", SAMPLINGS)
def test_cantilever_is_within_two_percent_of_finite_elements(kind):
    ratios = cantilever_ratios(kind, "consistent")
    assert np.abs(ratios - 1).max() < 0.02, f"tip over FEM at 8, 22, 41 %: {ratios.round(4)}"


def test_cantilever_of_the_papers_plain_scheme_is_too_soft():
    ratios = cantilever_ratios("poisson", "paper")
    # On a regular grid its neighbours are the grid's axes and the error is 4 %; on real clouds it is this.
    assert (ratios > 1.3).all(), f"tip over FEM at 8, 22, 41 %: {ratios.round(4)}"


@pytest.mark.parametrize("axis", [0, 2])
def test_two_material_block_is_within_two_percent_of_finite_elements(axis):
    ratio, worst = block_ratio(axis, "consistent")
    assert abs(ratio - 1) < 0.02, f"pulled face over FEM: {ratio:.4f}"
    assert worst < 0.03, f"worst point: {worst:.4f} of the largest motion"


def test_two_material_block_of_the_papers_plain_scheme_is_too_soft():
    ratio, _ = block_ratio(0, "paper")
    assert ratio > 1.15, f"pulled face over FEM: {ratio:.4f}"
