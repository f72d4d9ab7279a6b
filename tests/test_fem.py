"""The finite-element oracle is itself right: derivatives, patch test, beam theory, closed forms, convergence."""

import fem
import fem_scenes
import numpy as np
import pytest
from make_example import plush_jet, plush_mesh

MU, LAM = 1.3, 2.1


def wavy_body(fixed: fem.Field) -> fem.FemBody:
    """A box whose inner vertices are moved, so that no element is a cuboid."""
    mesh = fem.box_mesh((0, 0, 0), (1, 1, 1), (3, 2, 2))
    inside = np.setdiff1d(np.arange(mesh.p.shape[1]), mesh.boundary_nodes())
    p = mesh.p.copy()
    p[:, inside] += np.random.default_rng(0).uniform(-0.08, 0.08, (3, len(inside)))
    return fem.FemBody.build(type(mesh)(p, mesh.t), fem_scenes.constant(MU), fem_scenes.constant(LAM), fixed)


def loose(x: np.ndarray) -> np.ndarray:
    return np.zeros(len(x), bool)


def random_state(body: fem.FemBody, seed: int) -> np.ndarray:
    """A strained, rotated, non-symmetric displacement with J > 0."""
    random = np.random.default_rng(seed)
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    bend = 0.3 * np.sin(body.nodes @ random.normal(size=(3, 3)))
    return (body.nodes + bend) @ turn.T - body.nodes


def taylor_rate(value, derivative, x: np.ndarray, way: np.ndarray) -> float:
    """Order of the remainder |value(x + h w) - value(x) - h derivative| in h."""
    remainder = [np.linalg.norm(value(x + h * way) - value(x) - h * derivative) for h in (1e-2, 1e-3)]
    return float(np.log10(remainder[0] / remainder[1]))


@pytest.mark.parametrize("seed", [1, 2])
def test_internal_force_is_the_derivative_of_the_energy(seed):
    body = wavy_body(loose)
    u, way = random_state(body, seed), np.random.default_rng(seed + 10).normal(size=body.nodes.shape) * 0.1
    slope = (fem.internal_force(body, u) * way).sum()
    assert taylor_rate(lambda v: fem.energy(body, v), slope, u, way) > 1.9


@pytest.mark.parametrize("seed", [1, 2])
def test_stiffness_is_the_derivative_of_the_internal_force(seed):
    body = wavy_body(loose)
    u, way = random_state(body, seed), np.random.default_rng(seed + 10).normal(size=body.nodes.shape) * 0.1
    slope = (fem.stiffness(body, u) @ way.ravel()).reshape(u.shape)
    assert taylor_rate(lambda v: fem.internal_force(body, v), slope, u, way) > 1.9


def test_energy_of_an_affine_stretch_is_its_closed_form():
    body = wavy_body(loose)
    F = np.array([[1.2, 0.3, 0.0], [-0.1, 0.9, 0.2], [0.1, 0.0, 1.1]])
    J = np.linalg.det(F)
    psi = MU / 2 * ((F**2).sum() - 3) - MU * np.log(J) + LAM / 2 * (J - 1) ** 2
    assert fem.energy(body, body.nodes @ (F - np.eye(3)).T) == pytest.approx(psi, rel=1e-12)


def test_patch_of_skewed_elements_stays_affine():
    body = wavy_body(lambda x: ((x < 1e-9) | (x > 1 - 1e-9)).any(1))
    exact = body.nodes @ np.array([[0.1, 0.3, 0.0], [-0.2, -0.1, 0.1], [0.0, 0.1, 0.2]]).T
    bumpy = exact + 0.01 * ~body.fixed * np.sin(20 * body.nodes)
    assert np.abs(fem.solve(body, start=bumpy) - exact).max() < 1e-9


@pytest.mark.parametrize("stress", [-0.5, 0.4, 2.0])
def test_uniaxial_tension_is_its_closed_form(stress):
    body = wavy_body(lambda x: x < 1e-9)
    load = fem.surface_load(body.basis, lambda x, n: stress * (n[:, :1] > 0.5) * [1.0, 0, 0])
    a, b = fem_scenes.uniaxial_stretch(stress, MU, LAM)
    u = fem.solve(body, nodal_force=load, steps=2)
    assert np.abs(u - body.nodes * [a - 1, b - 1, b - 1]).max() < 1e-8


def timoshenko_error(width: float, poisson: float) -> float:
    """Relative excess of the finite-element tip over q L^4 / 8 E I + q L^2 / 2 k G A, k = 5/6, at a small load."""
    gravity, G = 1e-5 * (width / 0.2) ** 2, 1 / (2 * (1 + poisson))
    mu, lam = fem_scenes.lame_fields(fem_scenes.constant(1.0), poisson)
    size, cells = (1.0, width, width), (24, 2, 2)
    scene = fem_scenes.clamped_box(size=size, cells=cells, mu=mu, lam=lam, body_force=(0, 0, -gravity))
    beam = gravity * (12 / (8 * width**2) + 1 / (2 * (5 / 6) * G))
    return float(-scene.tip[2] / beam - 1)


@pytest.mark.parametrize("width", [0.2, 0.1])
def test_small_deflection_is_that_of_timoshenko(width):
    assert abs(timoshenko_error(width, 0.0)) < 0.001


def test_a_clamp_that_forbids_contraction_stiffens_in_proportion_to_the_width():
    wide, slender = timoshenko_error(0.2, 0.3), timoshenko_error(0.1, 0.3)
    assert -0.03 < wide < slender < 0
    assert slender / wide == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize(("gravity", "tip"), [(2e-3, 0.0762), (6e-3, 0.2216), (1.2e-2, 0.4059)])
def test_large_deflections_agree_with_an_earlier_independent_solution(gravity, tip):
    assert -fem_scenes.cantilever(gravity).tip[2] == pytest.approx(tip, rel=0.005)


def test_cantilever_converges_under_refinement():
    coarse, middle, fine = (fem_scenes.cantilever(6e-3, cells).tip[2] for cells in [(6, 1, 1), (12, 2, 2), (20, 3, 3)])
    assert abs(middle - fine) < 0.3 * abs(coarse - fine)
    assert abs(middle - fine) < 0.003 * abs(fine)


@pytest.mark.parametrize("axis", [0, 2])
def test_two_material_block_converges_under_refinement(axis):
    x = np.random.default_rng(3).uniform([0, -0.25, -0.25], [1, 0.25, 0.25], (300, 3))
    coarse, fine = (fem_scenes.two_material_block(axis, cells=c).displacement(x) for c in [(4, 2, 2), (8, 4, 4)])
    assert np.linalg.norm(coarse - fine) < 0.015 * np.linalg.norm(fine)
    assert np.linalg.norm(fine, axis=1).max() > 0.2


def test_reactions_balance_the_load():
    scene = fem_scenes.two_material_block(0)
    held = scene.body.fixed[:, 0]
    reaction = fem.internal_force(scene.body, scene.u)[held].sum(0)
    assert reaction == pytest.approx(-scene.traction * 0.25, abs=1e-8)


def test_field_at_the_nodes_is_the_nodal_field():
    scene = fem_scenes.two_material_block(0)
    # The query is moved inwards by 1e-9 of the size so that boundary points are found.
    assert np.abs(scene.displacement(scene.body.nodes) - scene.u).max() < 1e-8


def test_lumping_keeps_volume_area_force_and_torque():
    mesh, jet = plush_mesh(), plush_jet()
    body = fem.FemBody.build(mesh, fem_scenes.constant(1), fem_scenes.constant(1), loose)
    hats = fem.hats(mesh)
    assert fem.volumes(hats).min() > 0
    assert fem.volumes(hats).sum() == pytest.approx(body.weights.sum(), rel=1e-12)
    assert np.abs(fem.area_vectors(hats).sum(0)).max() < 1e-12
    full, shared = (fem.surface_load(basis, jet.traction(5)) for basis in (body.basis, hats))
    assert shared.sum(0) == pytest.approx(full.sum(0), abs=1e-12)
    assert np.cross(mesh.p.T, shared).sum(0) == pytest.approx(np.cross(body.nodes, full).sum(0), abs=1e-12)


def test_vertices_of_the_refined_mesh_are_the_nodes():
    body = wavy_body(loose)
    assert np.abs(fem.hats(body.mesh.refined()).doflocs.T - body.nodes).max() < 1e-12


def test_an_impossible_load_is_refused():
    body = wavy_body(lambda x: x[:, 0] < 1e-9)
    with pytest.raises(RuntimeError, match="finite-element"):
        fem.solve(body, body_force=(-1e6, 0, 0))


def test_two_region_sequence_is_noisy_after_its_first_frame_only():
    clean, noisy = fem_scenes.two_region_sequence(0.0, 0), fem_scenes.two_region_sequence(0.05, 1)
    difference = noisy.points - clean.points
    assert np.abs(difference[0]).max() == 0
    assert difference[1:].std() == pytest.approx(0.05 * clean.spacing, rel=0.02)
    assert clean.mu_true.max() / clean.mu_true.min() == pytest.approx(5)
