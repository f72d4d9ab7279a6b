"""The body's colours on a fine grid over its skin, worked out once: the solid texture is too slow for every sample."""

from dataclasses import dataclass

import numpy as np

from recon.rig.body import Body, cut_triangle, six
from recon.rig.texture import colour_of


@dataclass(frozen=True, kw_only=True, eq=False)
class Baked:
    """Reflectance at the grid points of every quadratic triangle of the skin; neighbours agree on their common edge."""

    fine: int  # cuts of an edge
    cuts: int  # of the skin that samples refer to
    values: np.ndarray  # (S, G, 3) float32

    @classmethod
    def of(cls, shape: str, body: Body, cuts: int, fine: int) -> "Baked":
        """The texture of one of the shapes for samples on `body.skin(cuts)`."""
        bary, _ = cut_triangle(fine)
        place = np.einsum("gk,skj->sgj", six(bary), body.nodes[body.faces])
        values = colour_of(shape, place.reshape(-1, 3)).reshape(place.shape)
        return cls(fine=fine, cuts=cuts, values=values)

    def __call__(self, triangle: np.ndarray, second: np.ndarray, third: np.ndarray) -> np.ndarray:
        """Reflectance (M, 3) in triangles (M,) of the skin at the weights of their second and third corners."""
        bary, local = cut_triangle(self.cuts)
        face, part = np.divmod(triangle, len(local))
        a, b, c = (bary[local[:, i], 1:].astype(np.float32) for i in range(3))
        along = a[part] + second[:, None] * (b - a)[part] + third[:, None] * (c - a)[part]
        along = np.clip(along * self.fine, 0, self.fine - 1e-3)
        low = along.astype(np.int64)
        x, y = (along - low).T
        upper = x + y > 1
        i, j = low[:, 0], low[:, 1]
        # Beyond the diagonal of a grid square its opposite corner takes the first one's part.
        first = self._number(i + upper, j + upper)
        x, y = np.where(upper, 1 - y, x), np.where(upper, 1 - x, y)
        right, above = self._number(i + 1, j), self._number(i, j + 1)
        out = self.values[face, first] * (1 - x - y)[:, None]
        out += self.values[face, right] * x[:, None]
        out += self.values[face, above] * y[:, None]
        return out

    def _number(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """The grid point i steps along the first edge and j along the other; on the far edge the last one there is."""
        j = np.minimum(j, self.fine - i)
        return i * (self.fine + 1) - i * (i - 1) // 2 + np.maximum(j, 0)
