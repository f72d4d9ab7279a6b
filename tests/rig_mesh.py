"""Tetrahedra that fill an outline: a body-centred lattice whose surface is cut and moved onto the outline.

After Labelle and Shewchuk, Isosurface Stuffing, SIGGRAPH 2007, with quadratic elements whose edges follow the outline.
"""

import itertools

import numpy as np
from rig_outlines import Outline, Soft
from skfem import MeshTet, MeshTet2
from skfem.quadrature import get_quadrature_tet

Array = np.ndarray
SNAP = 0.30  # lattice points this near to the surface, in cells, move onto it
PROJECTIONS = 30
SMOOTHING = 20
SHAKES = 60
FOLD = 0.3  # a curved tetrahedron may keep no less of its volume anywhere
FLAT = 0.25  # quality below which a tetrahedron on the surface is left out


def lattice(soft: Soft) -> tuple[Array, Array]:
    """Points (N, 3) and tetrahedra (M, 4) of a body-centred lattice on the body's planes; the ground is one of them."""
    middles = [(a[:-1] + a[1:]) / 2 for a in soft.lines]
    corner, centre = (np.stack(np.meshgrid(*a, indexing="ij"), axis=-1) for a in (soft.lines, middles))
    number = np.arange(corner[..., 0].size).reshape(corner.shape[:3])
    middle = number.size + np.arange(centre[..., 0].size).reshape(centre.shape[:3])
    points = soft.bend(np.concatenate([corner.reshape(-1, 3), centre.reshape(-1, 3)]))
    tets = []
    for axis in range(3):
        near, far = (np.take(middle, range(a, middle.shape[axis] + b), axis=axis) for a, b in ((0, -1), (1, 0)))
        beside = [i for i in range(3) if i != axis]
        shift = np.zeros((4, 3), int)
        shift[:, axis] = 1
        shift[[1, 2], beside[0]] = 1
        shift[[2, 3], beside[1]] = 1
        index = np.stack(np.meshgrid(*(np.arange(n) for n in near.shape), indexing="ij"), axis=-1)
        at = index.reshape(-1, 3)
        face = [number[tuple((at + s).T)] for s in shift]
        for a, b in itertools.pairwise([0, 1, 2, 3, 0]):
            tets.append(np.stack([near.ravel(), far.ravel(), face[a], face[b]], axis=1))
    return points, np.concatenate(tets)


def finest(soft: Soft) -> float:
    """The smallest spacing of the lattice's planes [m]."""
    return float(min(np.diff(a).min() for a in soft.lines))


def onto(outline: Outline, p: Array) -> Array:
    """Points (M, 3) moved along the gradient until the outline is zero."""
    for _ in range(PROJECTIONS):
        value, g = outline(p), gradient(outline, p)
        p = p - (0.8 * value / np.maximum((g * g).sum(1), 1e-4))[:, None] * g
    return p


def gradient(outline: Outline, p: Array, h: float = 2e-4) -> Array:
    """Central differences of the outline, (M, 3)."""
    return np.stack([(outline(p + h * e) - outline(p - h * e)) / (2 * h) for e in np.eye(3)], axis=1)


def fill(soft: Soft) -> MeshTet2:
    """Quadratic tetrahedra whose outer nodes lie on the outline."""
    points, tets = lattice(soft)
    points, value = _snapped(soft, points)
    points, tets = _clipped(soft, points, value, tets)
    points, tets = _connected(points, _upright(points, tets))
    mesh = MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(tets.T))
    mesh = _repaired(soft, _peeled(_smoothed(soft, mesh)))
    return _curved(soft, mesh)


def _snapped(soft: Soft, points: Array) -> tuple[Array, Array]:
    value, size = soft.outline(points), finest(soft)
    moved = onto(soft.outline, points)
    for tip in soft.tips:
        at = int(np.linalg.norm(points - tip, axis=1).argmin())
        there = onto(soft.outline, np.array([tip]))[0]
        if np.linalg.norm(there - points[at]) < 0.6 * size:
            points[at] = moved[at] = there
    # A point of the ground plane stays in it.
    ground = np.abs(points[:, 2]) < 1e-9
    near = (np.linalg.norm(moved - points, axis=1) < SNAP * size) & (np.abs(soft.outline(moved)) < 1e-5)
    near &= ~ground
    points = np.where(near[:, None], moved, points)
    value = np.where(near, 0.0, value)
    value[ground & (value <= 0)] = 0.0
    return points, value


def _clipped(soft: Soft, points: Array, value: Array, tets: Array) -> tuple[Array, Array]:
    """Keep what is inside: whole tetrahedra, and parts of those that the surface cuts."""
    cuts, made, out = {}, [], []

    def cut(inside: int, outside: int) -> int:
        key = (inside, outside)
        if key not in cuts:
            share = value[inside] / (value[inside] - value[outside])
            cuts[key] = len(points) + len(made)
            made.append(points[inside] + share * (points[outside] - points[inside]))
        return cuts[key]

    sign = np.sign(value)[tets]
    out.extend(tets[(sign <= 0).all(axis=1) & (sign < 0).any(axis=1)].tolist())
    for tet, s in zip(*(a[(sign < 0).any(axis=1) & (sign > 0).any(axis=1)] for a in (tets, sign)), strict=True):
        inner, zero, outer = ([int(v) for v in tet[which]] for which in (s < 0, s == 0, s > 0))
        if len(outer) == 1:
            prism = [(v, cut(v, outer[0])) for v in inner] + [(v, v) for v in zero]
        elif len(outer) == 2 and len(inner) == 2:
            a, b = inner
            prism = [(a, b), (cut(a, outer[0]), cut(b, outer[0])), (cut(a, outer[1]), cut(b, outer[1]))]
        else:
            out.append([*inner, *zero, *(cut(inner[0], v) for v in outer)])
            continue
        out.extend(_prism(prism))
    fresh = onto(soft.outline, np.array(made))
    near = np.linalg.norm(fresh - made, axis=1) < 0.5 * finest(soft)
    return np.concatenate([points, np.where(near[:, None], fresh, made)]), np.array(out)


def _prism(edges: list[tuple[int, int]]) -> list[list[int]]:
    """Tetrahedra of a prism with three such edges between its ends; its sides are split at their lowest number."""
    base, top = ([e[i] for e in edges] for i in (0, 1))
    lowest = min((*base, *top))
    if lowest in top and lowest not in base:
        base, top = top, base
    k = base.index(lowest)
    (a, b, c), (d, e, f) = (base[k:] + base[:k]), (top[k:] + top[:k])
    first = [a, d, e, f]
    # The side opposite the lowest corner: b c f e.
    rest = [[a, b, c, f], [a, b, f, e]] if min(b, f) < min(c, e) else [[a, b, c, e], [a, c, f, e]]
    return [tet for tet in (first, *rest) if len(set(tet)) == 4]


def _upright(points: Array, tets: Array) -> Array:
    p = points[tets]
    volume = np.linalg.det(p[:, 1:] - p[:, :1]) / 6
    size = np.abs(volume).max()
    tets = np.where((volume < 0)[:, None], tets[:, [0, 1, 3, 2]], tets)
    return tets[np.abs(volume) > 1e-6 * size]


def _connected(points: Array, tets: Array) -> tuple[Array, Array]:
    used, index = np.unique(tets, return_inverse=True)
    return points[used], index.reshape(tets.shape)


def _peeled(mesh: MeshTet) -> MeshTet:
    """Without the flat tetrahedra that lie on the surface with two of their faces, or more."""
    while True:
        outer = np.isin(mesh.t2f, mesh.boundary_facets()).sum(axis=0)
        flat = (outer >= 2) & (quality(mesh.p.T, mesh.t.T) < FLAT)
        if not flat.any():
            return mesh
        mesh = mesh.restrict(np.flatnonzero(~flat)).remove_unused_nodes()


def _smoothed(soft: Soft, mesh: MeshTet) -> MeshTet:
    """Nodes moved towards the mean of their neighbours, outer ones along the surface, where that improves the worst."""
    p, edges, outer = mesh.p.T.copy(), mesh.edges, mesh.boundary_nodes()
    on = np.zeros(len(p), bool)
    on[outer] = True
    skin = np.unique(np.sort(mesh.facets[:, mesh.boundary_facets()][[0, 1, 1, 2, 0, 2]].reshape(3, 2, -1), axis=1)
                     .transpose(1, 0, 2).reshape(2, -1), axis=1)  # fmt: skip
    ground = p[:, 2] < 1e-6
    for _ in range(SMOOTHING):
        goal = np.where(on[:, None], _mean(p, skin), _mean(p, edges))
        moved = p + 0.4 * (goal - p)
        moved[on & ~ground] = onto(soft.outline, moved[on & ~ground])
        moved[ground] = p[ground]
        p = _guarded(p, moved, mesh.t.T)
    return MeshTet(np.ascontiguousarray(p.T), mesh.t)


def _repaired(soft: Soft, mesh: MeshTet) -> MeshTet:
    """Corners of the worst tetrahedra shaken, and kept where the worst one around them becomes better."""
    rng, p, tets = np.random.default_rng(0), mesh.p.T.copy(), mesh.t.T
    on = np.isin(np.arange(len(p)), mesh.boundary_nodes())
    ground = p[:, 2] < 1e-6
    for _ in range(SHAKES):
        for i in np.unique(tets[quality(p, tets) < FLAT]):
            star = tets[(tets == i).any(axis=1)]
            size = np.linalg.norm(p[star].reshape(-1, 3) - p[i], axis=1).max()
            trial, before = p.copy(), quality(p, star).min()
            trial[i] += rng.normal(0, 0.08, 3) * size * [1, 1, not ground[i]]
            if on[i] and not ground[i]:
                trial[i] = onto(soft.outline, trial[[i]])[0]
            if quality(trial, star).min() > before:
                p = trial
    return MeshTet(np.ascontiguousarray(p.T), mesh.t)


def _mean(p: Array, edges: Array) -> Array:
    ends = np.concatenate([edges, edges[::-1]], axis=1)
    total = np.stack([np.bincount(ends[0], p[ends[1], i], minlength=len(p)) for i in range(3)], axis=1)
    return total / np.maximum(np.bincount(ends[0], minlength=len(p)), 1)[:, None]


def quality(p: Array, tets: Array) -> Array:
    """6 sqrt 2 V / (root-mean-square edge)^3, 1 for the regular tetrahedron."""
    x = p[tets]
    pairs = list(itertools.combinations(range(4), 2))
    edge = np.mean([((x[:, a] - x[:, b]) ** 2).sum(1) for a, b in pairs], axis=0)
    return np.sqrt(2) * np.linalg.det(x[:, 1:] - x[:, :1]) / edge**1.5


def _guarded(p: Array, moved: Array, tets: Array) -> Array:
    """Every node's move is taken back where a tetrahedron around it would become worse than before and bad."""
    for _ in range(10):
        before, after = quality(p, tets), quality(moved, tets)
        bad = (after < 0.3) & (after < before)
        if not bad.any():
            break
        moved[np.unique(tets[bad])] = p[np.unique(tets[bad])]
    return moved


def _curved(soft: Soft, mesh: MeshTet) -> MeshTet2:
    """Mid-edge nodes of the skin moved onto the outline; not on the ground and not where the edge is far from it."""
    curved = MeshTet2.from_mesh(mesh)
    p, count = curved.doflocs.copy(), mesh.p.shape[1]
    skin = np.unique(mesh.f2e[:, mesh.boundary_facets()]) + count
    skin = skin[p[2, skin] > 1e-4]
    there = onto(soft.outline, p[:, skin].T)
    length = np.linalg.norm(np.diff(mesh.p[:, mesh.edges[:, skin - count]], axis=1)[:, 0], axis=0)
    fine = np.linalg.norm(there - p[:, skin].T, axis=1) < 0.15 * length
    straight = p.copy()
    p[:, skin[fine]] = there[fine].T
    edges = mesh.t2e + count
    while (folded := _fold(p, curved.t, mesh) < FOLD).any():
        p[:, edges[:, folded]] = straight[:, edges[:, folded]]
    return MeshTet2(p, curved.t)


def _fold(p: Array, t: Array, mesh: MeshTet) -> Array:
    """Least volume ratio of each curved tetrahedron to its straight one, at the points of integration."""
    X, _ = get_quadrature_tet(5)
    curved, plain = MeshTet2(p, t), MeshTet2.from_mesh(mesh)
    return (curved.mapping().detDF(X) / plain.mapping().detDF(X)).min(axis=1)
