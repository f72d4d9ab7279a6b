"""Lame parameters: conversions against closed forms, and what is refused."""

import numpy as np
import pytest

from sim.lame import Lame


def test_quarter_poisson_makes_both_parameters_equal():
    lame = Lame.from_young(5.0, 0.25)
    assert lame.mu == pytest.approx([2.0])
    assert lame.lam == pytest.approx([2.0])


@pytest.mark.parametrize("poisson", [0.01, 0.3, 0.499])
def test_young_and_poisson_survive_the_round_trip(poisson):
    lame = Lame.from_young(np.array([1.0, 2.5e5]), poisson)
    assert lame.young == pytest.approx([1.0, 2.5e5], rel=1e-12)
    assert lame.poisson == pytest.approx(poisson, rel=1e-12)


def test_young_is_the_slope_of_uniaxial_tension():
    mu, lam, strain = 1.3, 2.1, 1e-3
    stiffness = np.full((3, 3), lam) + 2 * mu * np.eye(3)
    lateral = np.linalg.solve(stiffness[1:, 1:], -stiffness[1:, 0] * strain)
    stress = stiffness[0] @ [strain, *lateral]
    lame = Lame(mu=mu, lam=lam)
    assert lame.young == pytest.approx(stress / strain)
    assert lame.poisson == pytest.approx(-lateral[0] / strain)


@pytest.mark.parametrize(
    ("mu", "lam", "sentence"),
    [
        ([1.0, -2.0], [1.0, 1.0], r"mu must be positive; got -2"),
        ([1.0], [0.0], r"lam must be positive; got 0"),
        ([1.0, np.nan], [1.0, 1.0], r"mu must be finite"),
        ([1.0, 2.0], [1.0], r"lam must have shape \(2\); got \(1,\)"),
    ],
)
def test_impossible_parameters_are_refused(mu, lam, sentence):
    with pytest.raises(ValueError, match=sentence):
        Lame(mu=mu, lam=lam)


@pytest.mark.parametrize("poisson", [-0.1, 0.0, 0.5, np.nan])
def test_poisson_ratio_outside_its_range_is_refused(poisson):
    with pytest.raises(ValueError, match=r"poisson must lie between 0 and 0\.5"):
        Lame.from_young(1.0, poisson)


def test_homogeneous_parameters_spread_over_the_points():
    spread = Lame(mu=2.0, lam=3.0).spread(4)
    assert (spread.mu == np.full(4, 2.0)).all()
    assert (spread.lam == np.full(4, 3.0)).all()


def test_per_point_parameters_of_another_length_are_refused():
    with pytest.raises(ValueError, match=r"mu must hold one value or one per point, 5; got 2"):
        Lame(mu=[1.0, 2.0], lam=[1.0, 2.0]).spread(5)
