"""Fixed points against linear maps whose solution is known."""

import numpy as np
import pytest

from sim.fixed_point import MixingOptions, fixed_point


def linear_map(factor, size=6, seed=0):
    """G(x) = A x + b per frame with spectral norm `factor`, and its fixed points."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(2, size, size))
    A *= factor / np.linalg.norm(A, ord=2, axis=(1, 2), keepdims=True)
    b = rng.normal(size=(2, size))
    solution = np.linalg.solve(np.eye(size) - A, b[..., None])[..., 0]
    return lambda x: np.einsum("tij,tj->ti", A, x) + b, solution


def test_mixing_finds_the_fixed_points_where_plain_iteration_is_slow():
    image, solution = linear_map(0.95)
    mixed, plain = (
        fixed_point(image, np.zeros((2, 6)), MixingOptions(tolerance=1e-9, iterations=500, memory=m)) for m in (6, 0)
    )
    assert mixed.settled.all() and plain.settled.all()
    assert mixed.iterations < 20 < plain.iterations
    np.testing.assert_allclose(mixed.x, solution, atol=1e-7)


def test_state_without_an_image_is_approached_half_way():
    image, solution = linear_map(0.5)
    start = np.full((2, 6), 0.1)
    bounded = fixed_point(
        lambda x: np.where(np.abs(x - solution).max() > np.abs(start - solution).max() * 0.9 + 0.1, np.nan, image(x)),
        solution + 0.05,
        MixingOptions(tolerance=1e-9),
    )
    np.testing.assert_allclose(bounded.x, solution, atol=1e-8)


def test_start_without_an_image_ends_at_once_unsettled():
    found = fixed_point(lambda x: np.full_like(x, np.nan), np.ones((2, 3)), MixingOptions(tolerance=1e-9))
    assert not found.settled.any() and found.iterations == 1
    np.testing.assert_array_equal(found.x, np.ones((2, 3)))


def test_limit_returns_the_best_state_unsettled():
    image, solution = linear_map(0.9)
    found = fixed_point(image, solution + 1.0, MixingOptions(tolerance=1e-12, iterations=3, memory=0))
    assert not found.settled.any() and found.iterations == 3
    np.testing.assert_allclose(np.abs(image(found.x) - found.x).max(axis=1), found.change)


def test_settled_frame_waits_for_the_others():
    found = fixed_point(lambda x: x * [[0.0], [0.5]], np.ones((2, 1)), MixingOptions(tolerance=1e-6, memory=0))
    assert found.settled.all() and found.x[0] == 0.0


@pytest.mark.parametrize("name", ["tolerance", "iterations"])
def test_option_that_is_not_positive_is_named(name):
    with pytest.raises(ValueError, match=f"{name} must be positive"):
        MixingOptions(**({"tolerance": 1.0} | {name: 0}))
