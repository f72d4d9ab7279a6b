"""What is off in one load case, and what smoothing over time makes of a motion: against closed forms."""

from types import SimpleNamespace

import numpy as np
import pytest

from veo_ti.diagnosis.causes.cases import LoadCase, cases
from veo_ti.diagnosis.causes.measurement import TemporalSmoothing

UP, ASIDE = np.array([0, 0, 1.0]), np.array([1.0, 0, 0])


def under(course: list[np.ndarray]) -> SimpleNamespace:
    """A scene of two points that share a load."""
    forces = np.stack([np.repeat(f[None] / 2, 2, axis=0) for f in course])
    return SimpleNamespace(forces=forces, time=0.1 * np.arange(len(course)), jet=None)


def test_a_case_ends_where_the_load_does_or_comes_from_elsewhere():
    none = np.zeros(3)
    scene = under([none, UP, 2 * UP, none, 0.01 * UP, UP, 2 * UP, 2 * ASIDE, ASIDE, none])
    assert cases(scene) == [(1, 3), (5, 7), (7, 9)]
    assert cases(under([none, UP, UP])) == [(1, 3)]
    assert cases(under([none, none])) == []


def test_one_case_is_scaled_and_no_other():
    scene = under([np.zeros(3), UP, 2 * UP, np.zeros(3), ASIDE, np.zeros(3)])
    loads = LoadCase().loads(scene, np.array([0.5]), (1, 3))[0]
    assert loads.sum(axis=1) == pytest.approx(np.array([0 * UP, 1.5 * UP, 3 * UP, 0 * UP, ASIDE, 0 * UP]))
    assert LoadCase().near(scene, (1, 3)) == [(4, 5)]


@pytest.mark.parametrize(("course", "testable"), [([0, 1, 2, 0, 1], True), ([0, 1, 2, 1], False), ([0, 0], False)])
def test_a_single_case_is_as_strong_as_the_object_is_stiff(course, testable):
    assert (LoadCase().untestable(under([c * UP for c in course])) is None) == testable


@pytest.mark.parametrize("wave", [1, 3, 6])
def test_smoothing_weakens_each_wave_as_diffusion_does(wave):
    """Over n frames between ends over which nothing flows, cos(pi k (i + 1/2) / n) by exp(-v (1 - cos(pi k / n)))."""
    n, frame, variance = 20, 0.05, 1.7
    course = np.cos(np.pi * wave * (np.arange(n) + 0.5) / n)
    x = np.arange(6.0).reshape(2, 3)
    y = x + (course - course[0])[:, None, None] * np.ones((1, 2, 3))
    scene = SimpleNamespace(time=frame * np.arange(n), interval=frame, y=y, cloud=SimpleNamespace(x=x))
    seen = TemporalSmoothing().change(scene, np.array([variance * frame**2]), None).observe(y, np.arange(n))
    weaker = np.exp(-variance * (1 - np.cos(np.pi * wave / n)))
    assert seen - x == pytest.approx(weaker * (y - x))
    further = TemporalSmoothing().carried(scene, np.array([variance * frame**2]), None)
    assert y - x + further(y - x, np.arange(n), None) == pytest.approx(seen - x)
