"""Every energy term against finite differences of its own value: gradient, Hessian, subsets of frames."""

import numpy as np
import pytest
from clouds import block, bowl_mesh, box_mesh, rotation

from sim import runtime
from sim.cloud import RestCloud
from sim.join import join_clouds, part_slices
from sim.terms.contact import Contact
from sim.terms.handles import Handles, Strings
from sim.terms.loads import AppliedForce, gravity_change
from sim.terms.pair import SurfaceContact
from sim.terms.shapes import Box, Capsule, Mesh, Plane, Sphere

FRAMES, POINTS = 3, 40
SHAPES = {
    "plane": Plane(normal=np.array([1.0, 2.0, -3.0])),
    "sphere": Sphere(radius=0.8),
    "capsule": Capsule(radius=0.7, axis=np.array([0.2, 0.5, 0.1])),
    "box": Box(half=np.array([0.6, 0.9, 0.7])),
    "mesh": Mesh(vertices=box_mesh((0.6, 0.9, 0.7))[0], faces=box_mesh((0.6, 0.9, 0.7))[1]),
    "bowl": Mesh(vertices=bowl_mesh()[0], faces=bowl_mesh()[1]),
}


@pytest.fixture(autouse=True, scope="module")
def taichi():
    """Products of blocks run in a kernel."""
    runtime.ensure()


def contact(shape, rng):
    turns = np.stack([rotation(a) for a in (0.0, 0.7, -2.0)])
    position = rng.normal(0, 0.1, (FRAMES, 3))
    return Contact(shape=shape, volume=rng.uniform(0.5, 2, POINTS), alpha=3.0, position=position, rotation=turns)


def touching_blocks():
    """Two blocks that enter each other by up to a third of the spacing, no face parallel to another."""
    corners = [(0, 0, 0), (0.3, 0.2, 1)]
    a, b = (RestCloud.build(block((4, 4, 4), (1, 1, 1), corner, seed=seed)) for seed, corner in enumerate(corners))
    cloud = join_clouds(a, b)
    first, second = part_slices(a, b)
    y = np.repeat(cloud.x[None], FRAMES, axis=0)
    for t in range(FRAMES):
        turn = rotation(0.1 * (t + 1))
        y[t, second] = (y[t, second] - [0.8, 0.7, 1.5]) @ turn.T + [0.8, 0.7, 1.4]
    return SurfaceContact.between(cloud, first, second, 5.0), y + np.random.default_rng(3).normal(0, 0.01, y.shape)


def terms():
    rng = np.random.default_rng(0)
    y = rng.uniform(-1, 1, (FRAMES, POINTS, 3))
    cases = {name: (contact(shape, rng), y) for name, shape in SHAPES.items()}
    cases["force"] = (AppliedForce(force=rng.normal(size=y.shape)), y)
    cases["one force"] = (AppliedForce(force=rng.normal(size=y[:1].shape)), y)
    cases["gravity"] = (gravity_change(rng.uniform(1, 2, POINTS), rng.normal(size=(FRAMES, 3))), y)
    some = rng.choice(POINTS, 7, replace=False)
    cases["handles"] = (Handles(points=some, targets=rng.normal(size=(FRAMES, 7, 3)), alpha=rng.uniform(1, 2, 7)), y)
    some_taut = rng.uniform(0.5, 2.0, 7)
    cases["strings"] = (Strings(points=some, anchor=np.ones(3), length=some_taut, alpha=rng.uniform(1, 2, 7)), y)
    (there, back), y = touching_blocks()
    return cases | {"pair": (there, y), "pair, other way": (back, y)}


CASES = terms()


def push(y, seed=1):
    return np.random.default_rng(seed).normal(size=y.shape)


@pytest.mark.parametrize("case", CASES)
def test_case_is_not_idle(case):
    term, y = CASES[case]
    assert (np.abs(term.gradient(y)).max(axis=(1, 2)) > 1e-3).all()


@pytest.mark.parametrize("case", CASES)
def test_gradient_is_the_slope_of_the_value(case):
    term, y = CASES[case]
    p, step = push(y), 1e-6
    slope = (term.value(y + step * p) - term.value(y - step * p)) / (2 * step)
    expected = (term.gradient(y) * p).sum(axis=(1, 2))
    np.testing.assert_allclose(slope, expected, rtol=1e-6, atol=1e-8 * np.abs(term.gradient(y)).sum())


@pytest.mark.parametrize("case", CASES)
def test_tangent_is_the_slope_of_the_gradient(case):
    term, y = CASES[case]
    p, step = push(y), 1e-7
    slope = (term.gradient(y + step * p) - term.gradient(y - step * p)) / (2 * step)
    tangent = term.tangent(y)
    expected = np.zeros_like(y) if tangent is None else tangent.product(p)
    np.testing.assert_allclose(slope, expected, atol=1e-6 * np.abs(expected).max() + 1e-7)


@pytest.mark.parametrize("case", [name for name in CASES if CASES[name][0].tangent(CASES[name][1]) is not None])
def test_blocks_are_the_part_of_the_tangent_that_couples_no_points(case):
    term, y = CASES[case]
    tangent, n = term.tangent(y), y.shape[1]
    for i in np.argsort(-np.abs(term.gradient(y)).sum(axis=(0, 2)))[:5]:
        for c in range(3):
            p = np.zeros_like(y)
            p[:, i, c] = 1.0
            np.testing.assert_allclose(tangent.product(p)[:, i], tangent.blocks[:, i, :, c], atol=1e-12, err_msg=str(n))


@pytest.mark.parametrize("case", [*SHAPES, "strings", "pair", "pair, other way"])
def test_projected_tangent_is_positive_and_leaves_other_frames_exact(case):
    term, y = CASES[case]
    project = np.array([True, False, True])
    projected, exact, p = term.tangent(y, project), term.tangent(y), push(y)
    np.testing.assert_allclose(projected.product(p)[1], exact.product(p)[1], atol=1e-12)
    columns = np.stack([projected.product(one)[0].ravel() for one in _units(y)])
    assert np.linalg.eigvalsh(columns).min() >= -1e-10 * np.abs(columns).max()


def _units(y):
    for n in range(y[0].size):
        p = np.zeros_like(y)
        p[0].flat[n] = 1.0
        yield p


@pytest.mark.parametrize("case", CASES)
def test_chosen_frames_are_the_frames_of_the_whole(case):
    term, y = CASES[case]
    index = np.array([2, 0])
    part = term.frames(index)
    np.testing.assert_array_equal(part.value(y[index]), term.value(y)[index])
    np.testing.assert_array_equal(part.gradient(y[index]), term.gradient(y)[index])


def test_handle_that_was_not_seen_does_not_pull():
    seen = np.array([[True, False], [False, False]])
    handles = Handles.relative(np.array([0, 3]), np.ones((2, 2, 3)), mu=2.0, spacing=0.5, seen=seen, factor=10.0)
    pull = handles.gradient(np.zeros((2, 4, 3)))
    np.testing.assert_allclose(pull[0, 0], -2 * 10.0)  # 2 alpha (y - x*) with alpha = 10 * 2 * 0.5
    assert np.count_nonzero(pull) == 3


def test_string_pulls_towards_its_anchor_and_never_pushes():
    """One of length 2 [m] from the origin, along (0.6, 0.8, 0): taut from there on, slack before."""
    string = Strings(points=np.array([1]), anchor=np.zeros(3), length=np.array([2.0]), alpha=np.array([3.0]))
    way = np.array([0.6, 0.8, 0.0])
    y = np.zeros((3, 2, 3))
    y[:, 1] = np.array([[1.5], [2.0], [2.5]]) * way
    np.testing.assert_allclose(string.gradient(y)[:, 1], [0 * way, 0 * way, 2 * 3.0 * 0.5 * way], atol=1e-12)
    np.testing.assert_allclose(string.value(y), [0.0, 0.0, 3.0 * 0.5**2])
    assert not string.gradient(y)[:, 0].any()
