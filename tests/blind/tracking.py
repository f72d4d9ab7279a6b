"""What tracking makes of true positions: noise, lost points, outliers; frame 0 stays as it is."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

SETTINGS = ("iid", "outliers", "correlated", "missing", "force_scale")
OUTLIERS = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracked:
    """Positions as measured, which of them were seen, and how that was made."""

    points: np.ndarray  # (T, M, 3) [m]
    observed: np.ndarray  # (T, M) bool
    details: dict[str, object]


def tracked(rng: np.random.Generator, clean: np.ndarray, sigma: float, setting: str, spacing: float) -> Tracked:
    """Gaussian noise of `sigma` [m] per coordinate, made worse by the setting.

    outliers: 1 % of the points 5 to 30 mm off. correlated: 60 % of the variance lasts some frames (AR(1), 0.8) and
    reaches over some spacings [m]. missing: single points and whole spots for some frames, 5 to 15 % in all.
    """
    noise = rng.normal(size=clean.shape)
    seen, details = np.ones(clean.shape[:2], bool), {}
    if setting == "correlated":
        reach = float(rng.uniform(1.5, 3)) * spacing
        noise = np.sqrt(0.4) * noise + np.sqrt(0.6) * _correlated(rng, clean, reach)
        details = {"reach": reach, "share": 0.6}
    points = clean + sigma * noise
    if setting == "outliers":
        off = rng.random(clean.shape[:2]) < OUTLIERS
        way = rng.normal(size=clean.shape)
        way /= np.linalg.norm(way, axis=2, keepdims=True)
        points = points + (off * rng.uniform(5e-3, 3e-2, off.shape))[..., None] * way
        details = {"share": OUTLIERS}
    if setting == "missing":
        seen = _seen(rng, clean)
        details = {"share": float(1 - seen.mean())}
    points[0], seen[0] = clean[0], True
    points[~seen] = np.nan
    return Tracked(points=points, observed=seen, details=details)


def _correlated(rng: np.random.Generator, clean: np.ndarray, reach: float) -> np.ndarray:
    """Unit-variance noise: white noise smeared by a Gaussian over `reach` [m], then an AR(1) over frames."""
    x = clean[0]
    K = np.exp(-((x[:, None] - x[None]) ** 2).sum(-1) / reach**2)
    K /= np.linalg.norm(K, axis=1, keepdims=True)
    out = K @ rng.normal(size=clean.shape)
    for t in range(1, len(out)):
        out[t] = 0.8 * out[t - 1] + 0.6 * out[t]
    return out


def _seen(rng: np.random.Generator, clean: np.ndarray) -> np.ndarray:
    """False for single lost points, and for a few spots of the surface that something hid for some frames."""
    frames, points = clean.shape[:2]
    seen = rng.random((frames, points)) > rng.uniform(0.02, 0.06)
    tree = cKDTree(clean[0])
    for _ in range(4):
        near = tree.query(clean[0, rng.integers(points)], k=points // 12)[1]
        start = int(rng.integers(1, frames))
        seen[start : start + int(rng.integers(3, 9)), near] = False
    return seen
