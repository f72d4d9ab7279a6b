"""Contact with rigid shapes: distances against samples of the surface, and equilibria against balances of force."""

import numpy as np
import pytest
from clouds import block, bowl_mesh, box_mesh, rotation
from scipy.spatial import Delaunay, cKDTree

from sim.cloud import RestCloud
from sim.elastic import Elastic
from sim.energy import Energy
from sim.lame import Lame
from sim.newton import equilibrate
from sim.terms.contact import Contact, contact_alpha
from sim.terms.handles import Handles
from sim.terms.loads import AppliedForce
from sim.terms.shapes import Box, Capsule, Mesh, Plane, Sphere
from sim.terms.triangles import closest_shares

HALF = np.array([0.6, 0.9, 0.7])
LAME = Lame.from_young(5e4, 0.4)
MU = LAME.mu.item()


def mesh(made):
    vertices, faces = made
    return Mesh(vertices=vertices, faces=faces)


def points(count=400, seed=0):
    return np.random.default_rng(seed).uniform(-1.3, 1.3, (count, 3))


def on_triangles(vertices, faces, count):
    """Points spread over a surface."""
    rng = np.random.default_rng(1)
    a, b, c = (vertices[faces[:, n]] for n in range(3))
    size = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = rng.choice(len(faces), count, p=size / size.sum())
    share = rng.dirichlet((1, 1, 1), count)
    return np.einsum("pk,pkc->pc", share, vertices[faces[chosen]])


def within_bowl(p):
    """Inside the cube of half side 1 and below the pyramid with its tip at the origin and its rim at z = 1."""
    return (np.abs(p).max(axis=1) < 1) & (p[:, 2] < np.abs(p[:, :2]).max(axis=1))


def sampled(shape):
    """Surface samples and inside tests that know nothing of distances."""
    rng = np.random.default_rng(2)
    ball = rng.normal(size=(200_000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    if shape == "sphere":
        return Sphere(radius=0.8), 0.8 * ball, lambda p: np.linalg.norm(p, axis=1) < 0.8
    if shape == "capsule":
        axis = np.array([0.0, 0.5, 0.0])
        tube = np.column_stack([ball[:, 0], np.zeros(len(ball)), ball[:, 2]])
        tube *= 0.6 / np.linalg.norm(tube, axis=1, keepdims=True)
        tube[:, 1] = rng.uniform(-0.5, 0.5, len(ball))
        caps = 0.6 * ball + np.sign(ball[:, 1:2]) * axis
        beyond = lambda p: np.maximum(np.abs(p[:, 1]) - 0.5, 0)  # noqa: E731
        return (
            Capsule(radius=0.6, axis=axis),
            np.vstack([tube, caps]),
            lambda p: p[:, 0] ** 2 + p[:, 2] ** 2 + beyond(p) ** 2 < 0.36,
        )
    if shape == "bowl":
        return mesh(bowl_mesh()), on_triangles(*bowl_mesh(), 400_000), within_bowl
    return Box(half=HALF), on_triangles(*box_mesh(HALF), 400_000), lambda p: (np.abs(p) < HALF).all(axis=1)


@pytest.mark.parametrize("name", ["sphere", "capsule", "box", "bowl"])
def test_distance_is_that_to_the_nearest_sample_and_negative_inside(name):
    shape, surface, inside = sampled(name)
    p = points()
    d = shape.distance(p).d
    np.testing.assert_array_equal(d < 0, inside(p))
    nearest = cKDTree(surface).query(p)[0]
    assert (nearest >= np.abs(d) - 1e-12).all()
    np.testing.assert_allclose(np.abs(d), nearest, atol=0.02)


def test_plane_keeps_what_is_along_its_normal_outside():
    plane = Plane(normal=np.array([0.0, 0.0, -2.0]))
    np.testing.assert_allclose(plane.distance(np.array([[3.0, 1.0, 0.5], [0, 0, -0.25]])).d, [-0.5, 0.25])


@pytest.mark.parametrize("name", ["sphere", "capsule", "box", "bowl"])
def test_normal_is_the_unit_gradient_of_the_distance(name):
    shape, p, step = sampled(name)[0], points(seed=3), 1e-6
    ends = [(shape.distance(p + e).d, shape.distance(p - e).d) for e in step * np.eye(3)]
    slope = np.stack([(after - before) / (2 * step) for after, before in ends], axis=1)
    smooth = np.abs(np.linalg.norm(slope, axis=1) - 1) < 1e-4  # a kink lies between the two samples elsewhere
    assert smooth.mean() > 0.98
    np.testing.assert_allclose(shape.distance(p).normal[smooth], slope[smooth], atol=1e-4)


def test_mesh_of_a_box_is_the_box_to_64_bits():
    # 32 bits would leave 1e-7 here.
    p = points()
    box, meshed = Box(half=HALF).distance(p), mesh(box_mesh(HALF)).distance(p)
    np.testing.assert_allclose(meshed.d, box.d, atol=1e-14)
    np.testing.assert_allclose(meshed.normal, box.normal, atol=1e-9)


def test_mesh_whose_faces_look_inwards_is_turned():
    vertices, faces = box_mesh(HALF)
    p = points()
    turned = Mesh(vertices=vertices, faces=faces[:, ::-1])
    np.testing.assert_allclose(turned.distance(p).d, Box(half=HALF).distance(p).d, atol=1e-14)


def test_mesh_far_from_the_origin_keeps_its_precision():
    vertices, faces = box_mesh(HALF)
    away, p = np.array([1e3, -2e3, 5e2]), points()
    moved = Mesh(vertices=vertices + away, faces=faces)
    np.testing.assert_allclose(moved.distance(p + away).d, Box(half=HALF).distance(p).d, atol=1e-11)


def test_side_of_a_sharp_tip_does_not_depend_on_how_its_faces_are_cut():
    # One side of the spike is a fan of 40 slivers: counted as 40 normals they would outvote the two other sides.
    fan = np.column_stack([np.linspace(-0.1, 0.1, 41), np.full(41, -0.1), np.zeros(41)])
    vertices = np.vstack([fan, [[0.0, 0.1, 0.0], [0.0, 0.0, 1.0]]])
    back, tip = 41, 42
    sides = [[n, n + 1, tip] for n in range(40)] + [[40, back, tip], [back, 0, tip]]
    floor = [[n + 1, n, back] for n in range(40)]
    p = np.array([0, 0, 1]) + np.random.default_rng(0).uniform(-0.1, 0.1, (2000, 3))
    inside = mesh((vertices, np.array(sides + floor))).distance(p).d < 0
    np.testing.assert_array_equal(inside, Delaunay(vertices).find_simplex(p) >= 0)
    assert 0 < inside.mean() < 0.5


def test_closest_point_of_a_triangle_beats_every_sample_of_it():
    rng = np.random.default_rng(0)
    corners, p = rng.normal(size=(50, 3, 3)), rng.normal(size=(50, 3))
    shares = closest_shares(p, corners)
    np.testing.assert_allclose(shares.sum(axis=1), 1)
    away = np.linalg.norm(p - np.einsum("pk,pkc->pc", shares, corners), axis=1)
    samples = np.einsum("sk,pkc->psc", rng.dirichlet((0.5, 0.5, 0.5), 20_000), corners)
    nearest = np.linalg.norm(p[:, None] - samples, axis=2).min(axis=1)
    assert (shares >= 0).all() and (away <= nearest + 1e-12).all()
    np.testing.assert_allclose(away, nearest, atol=0.03)


def test_turning_shape_and_points_together_turns_the_forces():
    rng, turn = np.random.default_rng(0), rotation(1.3)
    y, volume = rng.uniform(-1, 1, (1, 60, 3)), rng.uniform(1, 2, 60)
    still = Contact(shape=Box(half=HALF), volume=volume, alpha=2.0, position=np.array([0.1, 0.2, 0.3]))
    turned = Contact(
        shape=Box(half=HALF), volume=volume, alpha=2.0, position=turn @ still.position[0], rotation=turn
    )
    np.testing.assert_allclose(turned.gradient(y @ turn.T), still.gradient(y) @ turn.T, atol=1e-13)
    np.testing.assert_allclose(turned.value(y @ turn.T), still.value(y), rtol=1e-12)


@pytest.fixture(scope="module")
def cloud():
    return RestCloud.build(block((7, 7, 5), (0.1, 0.1, 0.06), (-0.05, -0.05, 0.0)))


PRESSES = {
    "plane": (Plane(normal=np.array([0.0, 0.0, -1.0])), 0.057, 0.054),
    "sphere": (Sphere(radius=0.04), 0.095, 0.09),
    "capsule": (Capsule(radius=0.02, axis=np.array([0.03, 0.01, 0.0])), 0.076, 0.073),
    "box": (Box(half=np.array([0.02, 0.03, 0.02])), 0.077, 0.074),
    "mesh": (mesh(box_mesh((0.02, 0.03, 0.02))), 0.077, 0.074),
}


def pressed(cloud, name, factor=100.0):
    """The block on its fixed base under a shape at two heights."""
    shape, *heights = PRESSES[name]
    position = np.array([[0.002, 0.001, z] for z in heights])
    alpha = contact_alpha(MU, cloud.spacing, factor)
    contact = Contact(shape=shape, volume=cloud.volume, alpha=alpha, position=position)
    energy = Energy.of(Elastic.neo_hookean(cloud, LAME), [contact], cloud.x[:, 2] < 1e-9)
    return contact, energy, equilibrate(energy, np.repeat(cloud.x[None], 2, axis=0)).require_converged()


@pytest.mark.parametrize("name", PRESSES)
def test_press_is_carried_by_the_base(cloud, name):
    contact, energy, found = pressed(cloud, name)
    push, held = -contact.gradient(found.y).sum(axis=1), energy.elastic.gradient(found.y)[:, energy.fixed].sum(axis=1)
    assert (push[:, 2] < 0).all() and push[1, 2] < push[0, 2]
    np.testing.assert_allclose(push, -held, atol=1e-6 * np.abs(push).max())


def test_mesh_presses_as_the_box_it_is_made_of(cloud):
    np.testing.assert_allclose(pressed(cloud, "mesh")[2].y, pressed(cloud, "box")[2].y, atol=1e-9 * cloud.spacing)


def test_penetration_falls_as_the_stiffness_grows(cloud):
    depth = []
    for factor in (10, 100, 1000):
        contact, _, found = pressed(cloud, "sphere", factor)
        depth.append(contact.penetration(found.y).max(axis=1))
    softer, middle, stiffer = depth
    assert (softer > 5 * middle).all() and (middle > 8 * stiffer).all()
    assert (stiffer < 2e-3 * cloud.spacing).all()


def test_block_rests_on_a_plane_with_its_weight(cloud):
    weight = 0.7 * np.array([0, 0, -9.81])
    load = AppliedForce(force=(cloud.volume / cloud.volume.sum())[None, :, None] * weight)
    floor = Contact(
        shape=Plane(normal=np.array([0.0, 0.0, 1.0])), volume=cloud.volume, alpha=contact_alpha(MU, cloud.spacing),
        position=np.zeros(3),
    )  # fmt: skip
    top = np.flatnonzero(cloud.x[:, 2] > 0.0599)
    guide = Handles.relative(top, cloud.x[None, top], mu=MU, spacing=cloud.spacing, factor=1e-5)
    energy = Energy.of(Elastic.neo_hookean(cloud, LAME), [load, floor, guide])
    found = equilibrate(energy, cloud.x[None] - [0, 0, 0.002]).require_converged()
    carried, guided = (-term.gradient(found.y).sum(axis=(0, 1)) for term in (floor, guide))
    np.testing.assert_allclose(carried + guided, -weight, atol=1e-6 * 7)
    np.testing.assert_allclose(carried[2], -weight[2], rtol=2e-3)


def ball_contact(alpha=1.0, position=(0.0, 0.0, 0.0), rotation=None):
    return Contact(shape=Sphere(radius=1.0), volume=np.ones(2), alpha=alpha, position=position, rotation=rotation)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sphere(radius=0.0), "radius must be positive; got 0.0"),
        (lambda: Capsule(radius=-1.0, axis=np.zeros(3)), "radius must be positive"),
        (lambda: Box(half=np.array([1.0, 0.0, 1.0])), "half must be positive"),
        (lambda: Plane(normal=np.zeros(3)), "normal must not be zero"),
        (lambda: Mesh(vertices=np.eye(3), faces=np.array([[0, 1, 2]])), "faces must close up"),
        (lambda: Mesh(vertices=np.eye(3), faces=np.array([[0, 1, 3]])), "faces must lie between 0 and 2; got"),
        (lambda: contact_alpha(0.0, 1.0), "mu, spacing and factor must be positive"),
        (lambda: ball_contact(alpha=-1.0), "alpha must be positive; got -1"),
        (lambda: ball_contact(position=np.zeros((2, 2))), r"position must have shape \(any, 3\)"),
        (lambda: ball_contact(rotation=2 * np.eye(3)), "rotation must be a rotation in every frame"),
    ],
)
def test_unsound_contact_is_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()
