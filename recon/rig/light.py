"""Light on the stage: five lamps with soft shadows and a little from everywhere, once a frame for all cameras."""

import numpy as np

from recon.rig.raster import Shade
from recon.rig.stage import TARGET, around

LAMPS = tuple(TARGET + 1.75 * around(a, e) for a, e in ((36, 38), (108, 44), (180, 37), (252, 44), (324, 38)))
COLOURS = np.array([[1.02, 1.0, 0.96], [0.97, 1.0, 1.04], [1.0, 1.0, 1.0], [1.04, 1.0, 0.95], [0.98, 1.0, 1.02]])
STRENGTH = 0.36  # of a lamp on a surface that faces it
AMBIENT = 0.42  # from all sides
SPOTS = 3  # directions that stand for one lamp
SOFT = 0.07  # [rad] half width of a lamp
SKY = 14  # directions that stand for all sides
SPACING = 0.004  # [m] of the shadows' samples
BIAS = 0.005  # [m]


def normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3) at the vertices of a closed mesh, outwards."""
    face = np.cross(
        points[triangles[:, 1]] - points[triangles[:, 0]], points[triangles[:, 2]] - points[triangles[:, 0]]
    )
    out = np.stack([np.bincount(triangles.ravel(), np.repeat(face[:, i], 3), len(points)) for i in range(3)], axis=1)
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-30)


def irradiance(points: np.ndarray, facing: np.ndarray, nodes: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Light (M, 3), RGB, that falls on points (M, 3) [m] with normals (M, 3), past a mesh (V, 3) that casts shadows."""
    out = np.zeros((len(points), 3), np.float32)
    ways, shares = _ways()
    for way, share in zip(ways, shares, strict=True):
        cosine = facing @ way
        lit = cosine > 0
        shade = Shade.cast(nodes, triangles, -way, SPACING)
        seen = cosine[lit] * shade.lit(points[lit], BIAS)
        out[lit] += (seen[:, None] * share).astype(np.float32)
    return out


def plain_light(facing: np.ndarray) -> np.ndarray:
    """The same (M, 3) where nothing casts a shadow."""
    ways, shares = _ways()
    return np.maximum(0.0, facing @ ways.T) @ shares


def _ways() -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (W, 3) towards the light and what comes from there, (W, 3) RGB."""
    rng, ways, shares = np.random.default_rng(5), [], []
    for lamp, colour in zip(LAMPS, COLOURS, strict=True):
        toward = (lamp - TARGET) / np.linalg.norm(lamp - TARGET)
        for _ in range(SPOTS):
            way = toward + SOFT * rng.uniform(-1, 1, 3)
            ways.append(way / np.linalg.norm(way))
            shares.append(STRENGTH / SPOTS * colour)
    golden = np.pi * (3 - np.sqrt(5))
    for i in range(SKY):  # evenly over the sphere but for the lowest part, which the table hides
        z = 1 - (2 * i + 1) / SKY * 0.85
        side = np.sqrt(1 - z * z)
        ways.append(np.array([side * np.cos(golden * i), side * np.sin(golden * i), z]))
        shares.append(np.full(3, 4 * AMBIENT / SKY * (0.6 + 0.4 * z)))
    return np.array(ways), np.array(shares)
