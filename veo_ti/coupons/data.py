"""Training curves as data with their noise, in pieces over which the error that any simple law leaves is shared."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from veo_ti.coupons.curves import Curve, free_of_pressure, principal

MEMORY = 0.25  # of ln stretch, over which a law's error forgets itself
FINEST = 3e-4  # relative noise below which a table's own digits end
_NEAR = 4  # neighbours from which a point is predicted


def noise_of(curve: Curve) -> tuple[float, float]:
    """Relative noise of a curve from what its neighbours do not share, and its own relative uncertainty.

    Each point against the parabola through its neighbours, two on either side: the physics is smooth, digitising is
    not. The median of the size is not moved by a bend that the parabola cannot follow, as at locking.
    """
    x, y, d = np.log(curve.stretch), curve.stress, curve.scale
    errors = []
    for i in range(1, len(x) - 1):
        near = np.argsort(np.abs(np.arange(len(x)) - i), kind="stable")[1 : _NEAR + 1]
        design = np.vander((x[near] - x[i]) / max(float(np.ptp(x[near])), 1e-12), 3)
        weights = np.linalg.pinv(design)[2]  # of the value at the point itself
        errors.append((y[i] - weights @ y[near]) / (d[i] * np.sqrt(1 + weights @ weights)))
    size = float(np.median(np.abs(errors))) / 0.67449
    return max(size, FINEST), 1.17 / np.sqrt(len(errors))  # the median's, for normal errors


@dataclass(frozen=True, kw_only=True, eq=False)
class Data:
    """Curves in pieces: what is fitted are the mean relative errors of the pieces.

    A law's own error is smooth, so the points of a piece share it and count once against it; their noise averages out.
    mean (b, n) takes the means; noise (b,): relative standard deviation of a mean of noise alone; level (curves,): of
    one point; unsure: relative uncertainty of that.
    """

    curves: tuple[Curve, ...]
    stress: np.ndarray  # (n,) [Pa]
    scale: np.ndarray  # (n,) [Pa]
    mean: np.ndarray
    noise: np.ndarray
    level: np.ndarray
    unsure: float
    modulus: float  # mu of the Neo-Hookean law by relative least squares [Pa]: the prior's centre for every model

    @classmethod
    def of(cls, curves: Sequence[Curve]) -> "Data":
        """The data of some curves, with the noise of each estimated from itself."""
        levels = [noise_of(curve) for curve in curves]
        pieces = [np.unique(piece, return_inverse=True)[1] for piece in map(pieces_of, curves)]
        first = np.cumsum([0, *(p.max() + 1 for p in pieces)])
        rows = np.concatenate([p + f for p, f in zip(pieces, first, strict=False)])
        mean = (np.arange(first[-1])[:, None] == rows).astype(float)
        count = mean.sum(axis=1)
        level = np.repeat([level for level, _ in levels], np.diff(first))
        return cls(
            curves=tuple(curves), stress=np.concatenate([c.stress for c in curves]),
            scale=np.concatenate([c.scale for c in curves]), mean=mean / count[:, None], noise=level / np.sqrt(count),
            level=np.array([level for level, _ in levels]),
            modulus=_modulus(curves), unsure=float(1 / np.sqrt(sum(1 / u**2 for _, u in levels))),
        )  # fmt: skip


def _modulus(curves: Sequence[Curve]) -> float:
    shapes = [free_of_pressure(s, s) for s in (principal(c.mode, c.stretch) for c in curves)]
    scale = np.concatenate([c.scale for c in curves])
    a, b = np.concatenate(shapes) / scale, np.concatenate([c.stress for c in curves]) / scale
    return max(float(a @ b / (a @ a)), 1e-6 * float(np.abs(b).max()))


def pieces_of(curve: Curve) -> np.ndarray:
    """The piece of each point, (n,): runs of equal length in ln stretch, about MEMORY."""
    x = np.log(curve.stretch)
    span = float(np.ptp(x))
    count = max(int(np.ceil(span / MEMORY)), 1)
    return np.minimum((x - x.min()) / max(span, 1e-12) * count, count - 1).astype(int)
