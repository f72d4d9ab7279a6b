"""Triangles to pixels: which one each sample of a picture sees, and where on it."""

from dataclasses import dataclass

import numpy as np

CHUNK = 1 << 20  # candidates held in memory at once
EDGE = 1e-6  # a sample on an edge belongs to both triangles, the nearer one wins


@dataclass(frozen=True, kw_only=True, eq=False)
class Raster:
    """What the samples of a picture see."""

    triangle: np.ndarray  # (H, W) int32, -1 where there is none
    share: np.ndarray  # (H, W, 2) float32, weights of the triangle's second and third corner
    depth: np.ndarray  # (H, W) float32 [m], infinite where there is none

    @property
    def hit(self) -> np.ndarray:
        """Which samples see a triangle, (H, W) bool."""
        return self.triangle >= 0

    def corners(self, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vertex numbers (M, 3) and weights (M, 3) of the M samples that see a triangle, in the order of `hit`."""
        hit = self.hit
        second, third = self.share[hit].T
        return triangles[self.triangle[hit]], np.stack([1 - second - third, second, third], axis=1)


def rasterise(
    pixels: np.ndarray, depth: np.ndarray, triangles: np.ndarray, size: tuple[int, int], *, flat: bool = False
) -> Raster:
    """The nearest of triangles (M, 3) at every sample of a picture of size (width, height).

    pixels: (V, 2) places of the vertices in samples, NaN for what cannot be seen; depth: (V,) [m]. flat: a picture
    without perspective, in which depth and weights are linear. Triangles are straight in the picture, so they must be
    small beside the lens's distortion; either side of them is seen.
    """
    width, height = size
    out = Raster(
        triangle=np.full((height, width), -1, np.int32),
        share=np.zeros((height, width, 2), np.float32),
        depth=np.full((height, width), np.inf, np.float32),
    )
    p = pixels[triangles]
    low = np.ceil(np.nan_to_num(p.min(axis=1), nan=1e9)).clip(0).astype(np.int64)
    high = np.floor(np.nan_to_num(p.max(axis=1), nan=-1e9)).clip(max=[width - 1, height - 1]).astype(np.int64)
    span = np.maximum(high - low + 1, 0)
    cells = span.prod(axis=1)
    seen = np.flatnonzero(cells)
    for part in _parts(seen, cells[seen]):
        _draw(out, p[part], depth[triangles[part]], part, low[part], span[part], flat)
    return out


def _parts(seen: np.ndarray, cells: np.ndarray) -> list[np.ndarray]:
    """The triangles in groups of about CHUNK candidates."""
    cuts = np.flatnonzero(np.diff(np.cumsum(cells) // CHUNK)) + 1
    return [part for part in np.split(seen, cuts) if len(part)]


def _draw(
    out: Raster, p: np.ndarray, z: np.ndarray, number: np.ndarray, low: np.ndarray, span: np.ndarray, flat: bool
) -> None:
    """Test every sample in the triangles' boxes and keep the nearest hit of each."""
    cells = span.prod(axis=1)
    which = np.repeat(np.arange(len(p), dtype=np.int32), cells)
    index = np.arange(len(which), dtype=np.int32) - np.repeat((np.cumsum(cells) - cells).astype(np.int32), cells)
    row, column = np.divmod(index, np.repeat(span[:, 0].astype(np.int32), cells))
    second, third = _weights(p - low[:, None], cells, column, row)
    inside = np.flatnonzero((second >= -EDGE) & (third >= -EDGE) & (second + third <= 1 + EDGE))
    which, row, column, second, third = (a[inside] for a in (which, row, column, second, third))
    row, column = row + low[which, 1], column + low[which, 0]
    near = (1 / z if not flat else z).astype(np.float32)
    value = near[which, 0] + second * (near[:, 1] - near[:, 0])[which] + third * (near[:, 2] - near[:, 0])[which]
    if not flat:
        value = 1 / value
        second, third = (w * near[which, i] * value for i, w in ((1, second), (2, third)))
    order = np.argsort(-value)  # the last one written is the nearest
    at = (row * out.depth.shape[1] + column)[order]
    value = value[order]
    nearer = value < out.depth.ravel()[at]
    order, at, value = order[nearer], at[nearer], value[nearer]
    out.depth.ravel()[at] = value
    out.triangle.ravel()[at] = number[which[order]]
    out.share.reshape(-1, 2)[at] = np.stack([second[order], third[order]], axis=1)


def _weights(p: np.ndarray, cells: np.ndarray, column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the second and third corner, by Cramer's rule, at so many samples of each triangle, float32."""
    first, second = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b, c, d = np.stack([second[:, 1], -second[:, 0], -first[:, 1], first[:, 0]]) / area
        rows = np.stack([a, b, -a * p[:, 0, 0] - b * p[:, 0, 1], c, d, -c * p[:, 0, 0] - d * p[:, 0, 1]])
        rows = np.where(np.isfinite(rows).all(axis=0), rows, np.nan).astype(np.float32)  # seen from its edge: nothing
        a, b, e, c, d, f = np.repeat(rows, cells, axis=1)
        column, row = column.astype(np.float32), row.astype(np.float32)
        return a * column + b * row + e, c * column + d * row + f


@dataclass(frozen=True, kw_only=True, eq=False)
class Shade:
    """What lies behind something else along one direction: a depth picture without perspective."""

    axes: np.ndarray  # (3, 3) rows right, down, onwards
    low: np.ndarray  # (2,) [m] the first sample's place
    spacing: float  # [m]
    depth: np.ndarray  # (H, W) [m]

    @classmethod
    def cast(cls, points: np.ndarray, triangles: np.ndarray, direction: np.ndarray, spacing: float) -> "Shade":
        """The nearest surface along a direction (3,), of a mesh (V, 3) [m] with triangles (M, 3)."""
        axes = frame_along(direction)
        place = points @ axes.T
        low = place[:, :2].min(axis=0) - spacing
        size = np.ceil((place[:, :2].max(axis=0) - low) / spacing).astype(int) + 2
        found = rasterise(
            (place[:, :2] - low) / spacing, place[:, 2], triangles, (int(size[0]), int(size[1])), flat=True
        )
        return cls(axes=axes, low=low, spacing=spacing, depth=found.depth)

    def lit(self, points: np.ndarray, bias: float) -> np.ndarray:
        """How much of points (M, 3) nothing hides, (M,) in 0..1: of four samples around, those not nearer by bias."""
        place = points @ self.axes.T
        at = (place[:, :2] - self.low) / self.spacing
        first = np.floor(at).astype(int).clip(0, np.array(self.depth.shape)[::-1] - 2)
        share = (at - first).clip(0, 1)
        out = np.zeros(len(points))
        for i in (0, 1):
            for j in (0, 1):
                weight = np.abs(1 - i - share[:, 0]) * np.abs(1 - j - share[:, 1])
                out += weight * (self.depth[first[:, 1] + j, first[:, 0] + i] > place[:, 2] - bias)
        return out


def frame_along(direction: np.ndarray) -> np.ndarray:
    """Three unit vectors as rows, the third one along the direction (3,)."""
    forward = np.asarray(direction, float) / np.linalg.norm(direction)
    right = np.cross(np.eye(3)[np.abs(forward).argmin()], forward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])
