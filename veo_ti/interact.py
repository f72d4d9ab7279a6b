"""Loads and colliders written in words on the command line."""

import numpy as np

from sim.checks import require
from sim.terms.shapes import Box, Capsule, Mesh, Plane, Shape, Sphere
from veo_ti.shapes import closed_mesh


def vector(name: str, text: str, count: int) -> np.ndarray:
    """`count` numbers separated by commas; raises ValueError naming what is wrong."""
    try:
        values = np.array([float(part) for part in text.split(",")])
    except ValueError:
        values = np.zeros(0)
    sound = len(values) == count and bool(np.isfinite(values).all())
    require(sound, name, f"be {count} numbers separated by commas", repr(text))
    return values


def force_of(text: str) -> tuple[np.ndarray, np.ndarray, float]:
    """Force [N], place [m], radius [m] from "fx,fy,fz@x,y,z,radius"."""
    force, at, place = text.partition("@")
    require(at == "@", "force", "have the form fx,fy,fz@x,y,z,radius", repr(text))
    where = vector("force place", place, 4)
    require(where[3] > 0, "force radius", "be positive", where[3])
    return vector("force", force, 3), where[:3], float(where[3])


_COLLIDERS = {
    "plane": (6, "x,y,z,nx,ny,nz"),
    "sphere": (4, "x,y,z,radius"),
    "capsule": (7, "x,y,z,ax,ay,az,radius"),
    "box": (6, "x,y,z,hx,hy,hz"),
}


def collider_of(text: str, ramp: np.ndarray) -> tuple[Shape, np.ndarray]:
    """A shape and its positions (T, 3) [m] from "kind:numbers" or "mesh:FILE", with "@dx,dy,dz" for how far it moves.

    The first three numbers place it; then a plane's normal, a sphere's radius, a capsule's half axis and radius, or a
    box's half sizes. ramp (T,) goes from 0 to 1 as the shape moves. Raises ValueError for any other form.
    """
    where, _, motion = text.partition("@")
    kind, _, rest = where.partition(":")
    moved = vector("contact motion", motion, 3) if motion else np.zeros(3)
    if kind == "mesh":
        mesh = closed_mesh(rest)
        return Mesh(vertices=mesh.vertices, faces=mesh.triangles), ramp[:, None] * moved
    require(kind in _COLLIDERS, "contact", f"be one of {', '.join([*_COLLIDERS, 'mesh'])}", repr(text))
    v = vector(f"contact {kind}", rest, _COLLIDERS[kind][0])
    shapes = {
        "plane": lambda: Plane(normal=v[3:]),
        "sphere": lambda: Sphere(radius=float(v[3])),
        "capsule": lambda: Capsule(axis=v[3:6], radius=float(v[6])),
        "box": lambda: Box(half=v[3:]),
    }
    return shapes[kind](), v[:3] + ramp[:, None] * moved
