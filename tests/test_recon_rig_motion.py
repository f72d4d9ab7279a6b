"""The rig's stored motions: what an independent solver of elasticity and closed forms say about them."""

import numpy as np
import pytest
from skfem import Basis, ElementTetP2, MeshTet, MeshTet2

from recon.rig.body import edges_of, six
from recon.rig.jet import Stream, stream_forces
from recon.rig.motion import SHAPES, Motion, load_motion
from recon.rig.replay import FPS, Replay, ringing


@pytest.fixture(scope="module")
def motions():
    return {shape: load_motion(shape) for shape in SHAPES}


def elements(motion: Motion) -> tuple[Basis, np.ndarray]:
    """The stored body in scikit-fem, and scikit-fem's number of each stored node."""
    body, (edges, _) = motion.body, edges_of(motion.body.tetrahedra)
    corners = len(body.nodes) - len(edges)
    plain = MeshTet(np.ascontiguousarray(body.nodes[:corners].T), np.ascontiguousarray(body.tetrahedra.T))
    number = {tuple(edge): i for i, edge in enumerate(edges.tolist())}
    middles = np.array([number[tuple(e)] for e in np.sort(plain.edges.T, axis=1).tolist()])
    nodes = np.concatenate([body.nodes[:corners], body.nodes[corners + middles]])
    basis = Basis(MeshTet2(np.ascontiguousarray(nodes.T), plain.t), ElementTetP2(), intorder=5)
    place = np.empty(basis.N, int)
    place[:corners], place[corners + middles] = basis.nodal_dofs[0], basis.edge_dofs[0]
    np.testing.assert_allclose(basis.doflocs.T[place], body.nodes, atol=1e-12)
    return basis, place


@pytest.mark.parametrize("shape", SHAPES)
def test_loads_and_reaction_cancel(motions, shape):
    """Newton's third law between what the finite elements found at the ground and loads computed anew."""
    motion = motions[shape]
    replay, checked = Replay.of(motion, motion.frames), 0
    for frame in range(1, motion.frames, 7):
        load = (replay.jet(frame) + replay.lines(frame)).sum(axis=0)
        if np.linalg.norm(load) > 0.05 * motion.force:
            assert np.linalg.norm(load + motion.reaction[frame]) < 0.02 * np.linalg.norm(load)
            checked += 1
    assert checked >= 6


@pytest.mark.parametrize("shape", SHAPES)
def test_virtual_work_of_the_stress_is_that_of_the_loads(motions, shape):
    """int P : grad v = sum f . v for smooth v that vanish at the ground; stress by scikit-fem's gradients."""
    motion = motions[shape]
    body, replay, checked = motion.body, Replay.of(motion, motion.frames), 0
    basis, place = elements(motion)
    mu, lam = (interpolated(basis, place, values) for values in (motion.mu, motion.lam))
    height = np.ptp(body.nodes[:, 2])
    rise = np.clip(body.nodes[:, 2] - body.nodes[motion.held, 2].max(), 0, None) / height
    for frame in range(2, motion.frames, 4):
        force = replay.jet(frame) + replay.lines(frame)
        if np.linalg.norm(force.sum(axis=0)) < 0.2 * motion.force:
            continue
        u = replay.nodes(frame) - body.nodes
        F = np.eye(3) + gradient(basis, place, u)
        J, H = np.linalg.det(F), np.linalg.inv(F).swapaxes(-1, -2)
        P = mu[..., None, None] * (F - H) + (lam * (J - 1) * J)[..., None, None] * H
        work = (basis.dx[..., None, None] * P * gradient(basis, place, rise[:, None] ** 2)).sum(axis=(0, 1, 3))
        scale = (np.linalg.norm(force, axis=1) * rise**2).sum()
        # What is left is the rounding of the stored modes: short waves, which strain thin parts the most.
        assert np.linalg.norm(work - rise**2 @ force) < 0.03 * scale, frame
        checked += 1
    assert checked >= 9


def interpolated(basis: Basis, place: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Nodal values in the stored order at the points of integration, (E, Q)."""
    back = np.empty(basis.N)
    back[place] = values
    return np.asarray(basis.interpolate(back))


def gradient(basis: Basis, place: np.ndarray, u: np.ndarray) -> np.ndarray:
    """grad u (E, Q, C, 3) of nodal values (N, C) in the stored order."""
    back = np.empty(u.shape)
    back[place] = u
    return np.stack([np.asarray(basis.interpolate(column).grad) for column in back.T]).transpose(2, 3, 0, 1)


def test_firm_parts_keep_their_volume(motions):
    """The plush's head is nearly incompressible, its ears are not: the volume of tetrahedra says so."""
    motion = motions["plush"]
    frame = int(np.abs(motion.reaction).sum(axis=1).argmax())
    corner = motion.body.tetrahedra
    before, after = (volumes(nodes[corner]) for nodes in (motion.body.nodes, Replay.of(motion, 96).nodes(frame)))
    head = (motion.lam / motion.mu)[corner].min(axis=1) > 5
    assert head.sum() > 200 and abs(after[head].sum() / before[head].sum() - 1) < 2e-3
    assert np.isclose(before.sum(), after.sum(), rtol=0.02)


def volumes(corner: np.ndarray) -> np.ndarray:
    return np.linalg.det(corner[:, 1:] - corner[:, :1]) / 6


@pytest.mark.parametrize("shape", SHAPES)
def test_motion_is_worth_filming(motions, shape):
    motion = motions[shape]
    replay = Replay.of(motion, motion.frames)
    moved = np.array([np.linalg.norm(replay.nodes(f) - motion.body.nodes, axis=1).max() for f in range(motion.frames)])
    assert moved[0] < 1e-6 and 0.015 < moved.max() < 0.08 and (moved > 0.003).mean() > 0.4
    assert np.abs(motion.course @ motion.modes[:, motion.held].reshape(len(motion.modes), -1)).max() < 1e-9
    assert motion.mu.max() / motion.mu.min() > 2.5 and replay.jet(0).any() == 0
    assert np.abs(replay.jet(45)).sum() > 0 or np.abs(replay.jet(62)).sum() > 0


def test_more_frames_than_stored_lie_between_them(motions):
    motion = motions["pillow"]
    twice = Replay.of(motion, 2 * motion.frames - 1)
    stored = Replay.of(motion, motion.frames)
    np.testing.assert_allclose(twice.nodes(20), stored.nodes(10), atol=1e-12)
    np.testing.assert_allclose(twice.nodes(21), (stored.nodes(10) + stored.nodes(11)) / 2, atol=1e-12)
    few = Replay.of(motion, 5)
    assert few.at.tolist() == [0, 24, 48, 71, 95]


def test_inertia_rings_as_a_damped_oscillator(motions):
    """One vibration alone, its goal rising in one frame and held: against the closed form for a ramp."""
    motion, w, c = motions["plush"], 2 * np.pi * 4.0, 0.03
    course = np.zeros((60, 1))
    course[3:] = 1.0
    one = {"modes": motion.modes[:1], "mass": np.eye(1), "stiffness": np.eye(1) * w**2, "course": course}
    small = Motion(**{**vars(motion), **one})
    q = ringing(small, course)[:, 0]
    t, h, wd = np.arange(60) / FPS - 2 / FPS, 1 / FPS, w * np.sqrt(1 - c * c)

    def ramp(s):
        """Response to a goal that rises at the rate 1 from s = 0."""
        s = np.maximum(s, 0)
        wave = np.exp(-c * w * s) * (2 * c / w * np.cos(wd * s) + (2 * c * c - 1) / wd * np.sin(wd * s))
        return s - 2 * c / w + wave

    np.testing.assert_allclose(q, (ramp(t) - ramp(t - h)) / h, atol=2e-3)


def test_stream_is_blocked_by_what_stands_before():
    """Two plates across the stream: the far one gets nothing, the near one what the Gaussian gives in closed form."""
    ticks = np.linspace(-0.1, 0.1, 81)
    grid = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    corner = (np.arange(80)[:, None] * 81 + np.arange(80)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + 82], 1), np.stack([corner, corner + 82, corner + 81], 1)]
    )
    near, far = (np.concatenate([grid, np.full((len(grid), 1), z)], axis=1) for z in (0.3, 0.4))
    points, area = np.concatenate([near, far]), np.tile([0, 0, -((0.2 / 80) ** 2)], (2 * len(grid), 1))
    stream = Stream(position=np.zeros(3), direction=np.array([0, 0, 1.0]), force=2.0, footprint=0.02)
    force = stream_forces(stream, points, area, points, np.concatenate([faces, faces + len(grid)]))
    np.testing.assert_allclose(force[: len(grid)].sum(axis=0), [0, 0, 2.0], atol=1e-3)
    assert np.abs(force[len(grid) :]).max() == 0
    away = stream_forces(stream, points, -area, points, faces)
    assert np.abs(away).max() == 0


def test_body_interpolates_quadratics_and_keeps_forces(motions):
    body = motions["dinosaur"].body
    rng = np.random.default_rng(0)
    corner = body.nodes[body.tetrahedra[rng.integers(len(body.tetrahedra), size=300)]]
    points = np.einsum("mk,mkj->mj", rng.dirichlet(np.ones(4), 300), corner)
    np.testing.assert_allclose(body.interpolation(points) @ body.nodes, points, atol=2e-6)
    x, area = body.skin_points(body.nodes)
    assert np.abs(area.sum(axis=0)).max() < 1e-12  # closed
    assert (x * area).sum() / 3 == pytest.approx(elements(motions["dinosaur"])[0].dx.sum(), rel=1e-9)
    force = rng.normal(size=x.shape)
    for spread in (body.consistent, body.lumped):
        np.testing.assert_allclose((spread @ force).sum(axis=0), force.sum(axis=0), atol=1e-9)
    assert body.lumped.min() >= 0
    moment = np.cross(x, force).sum(axis=0)
    np.testing.assert_allclose(np.cross(body.nodes, body.consistent @ force).sum(axis=0), moment, atol=1e-9)
    np.testing.assert_allclose(six(np.eye(3)), np.eye(3, 6), atol=1e-15)


@pytest.mark.parametrize("shape", ["plush", "leaf"])
def test_points_beside_the_body_move_like_it(motions, shape):
    """Where the curved skin has no place for them, the search for one ends instead of running away."""
    body = motions[shape].body
    random = np.random.default_rng(0)
    points = body.nodes[random.integers(0, len(body.nodes), 20_000)] + 6e-3 * random.normal(size=(20_000, 3))
    wave = np.sin(body.nodes / 0.1)
    assert np.abs(body.interpolation(points) @ wave).max() < 2
