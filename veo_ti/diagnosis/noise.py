"""The noise of a measurement from its own residual: what neighbours do not share, and what stray points look like."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from veo_ti.diagnosis.scene import Scene

_STENCIL = 14
_UNLOADED = 0.02  # of the largest load
_RESTS = 3  # unloaded spells that it takes to compare them
_LASTING = 0.6  # of the energy, that does not change over the frames: beyond it something stays, which noise does not
_STRAY = 6.0  # local residual beyond which a point counts as an outlier, in standard deviations


@dataclass(frozen=True, kw_only=True, eq=False)
class Noise:
    """sigma: standard deviation of a coordinate [m]; local: the same as seen between neighbours, whatever was given;
    stray (T, N): outliers; correlation: how many residuals in the smooth modes make one independent one, judged by what
    is rough in time and by what differs between unloaded frames (1 for white noise)."""

    sigma: float
    local: float
    stray: np.ndarray
    correlation: float
    outlier_share: float  # of the observed points

    @property
    def variance(self) -> float:
        """At which smooth residuals count [m2]: correlated ones as fewer."""
        return self.sigma**2 * self.correlation


def measure_noise(scene: Scene, modes: np.ndarray) -> Noise:
    """The noise from the residual of a scene; a given sigma is taken as it is.

    A residual minus the affine fit to its neighbours' leaves noise, since what physics gets wrong is smooth at that
    scale; the median of its size is not moved by outliers. modes (N, S): smooth in space.
    """
    local, gain = _local(scene)
    seen = scene.target.seen & np.isfinite(gain)
    e = np.where(seen[..., None], local / gain[None, :, None], np.nan)
    estimate = float(np.nanmedian(np.abs(e))) / 0.67449
    sigma = scene.target.sigma or estimate
    stray = seen & (np.nan_to_num(np.abs(e)).max(axis=2) > _STRAY * max(sigma, estimate))
    share = float(stray.sum() / max(scene.target.seen.sum(), 1))
    correlation = _correlation(scene, modes, sigma, stray)
    return Noise(sigma=sigma, local=estimate, stray=stray, correlation=correlation, outlier_share=share)


def evenness(scene: Scene, modes: np.ndarray) -> float:
    """Energy of the residual's smooth modes (N, S) in the quietest tenth of the training frames, over the mean.

    Noise that neighbours share goes on in every frame, whatever the load; physics that is missing follows the load, or
    stays, which counts as zero.
    """
    frames = np.flatnonzero(scene.train & scene.target.seen.any(axis=1))
    frames = frames[frames > 0]  # the reference is taken as it was seen
    if len(frames) < 5:
        return 0.0
    projected = np.einsum("ns,tnc->tsc", modes, scene.residual[frames])
    energy = (projected**2).sum(axis=(1, 2))
    if (projected.mean(axis=0) ** 2).sum() > _LASTING * energy.mean():
        return 0.0
    return float(np.quantile(energy, 0.1) / max(energy.mean(), 1e-300))


def _local(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Residual minus an affine fit to its neighbours (T, N, 3) [m], and what that does to white noise, (N,)."""
    used = np.flatnonzero(scene.target.seen.any(axis=0))
    x = scene.cloud.x[used]
    near = cKDTree(x).query(x, min(_STENCIL, len(used)))[1][:, 1:]
    arms = x[near] - x[:, None]
    design = np.concatenate([np.ones((*arms.shape[:2], 1)), arms / scene.cloud.spacing], axis=2)
    weights = np.linalg.pinv(design, rcond=1e-3)[:, 0]  # (U, k): predicts the value at the point itself
    local = np.zeros_like(scene.residual)
    local[:, used] = scene.residual[:, used] - np.einsum("uk,tukc->tuc", weights, scene.residual[:, used[near]])
    gain = np.full(scene.cloud.count, np.nan)
    gain[used] = np.sqrt(1 + (weights**2).sum(axis=1))
    return local, gain


def _correlation(scene: Scene, modes: np.ndarray, sigma: float, stray: np.ndarray) -> float:
    """Energy of what cannot be elastic in the residual's smooth spatial modes over that of white noise, at least 1.

    That is its part that is rough in time, and the difference between unloaded frames with loads between them, which
    shows noise that is slow in time too; of those the lower quartile, since a permanent set differs as well.
    """
    frames = np.flatnonzero(scene.train & scene.target.seen.any(axis=1))
    if len(frames) < 5:
        return 1.0
    seen = scene.target.seen[frames] & ~stray[frames]
    r = np.where(seen[..., None], scene.residual[frames], 0.0)
    projected = np.einsum("ns,tnc->tsc", modes, r)
    white = sigma**2 * np.einsum("ns,tn->ts", modes**2, seen.astype(float))  # expected square of a coordinate
    rough = projected[1:-1] - (projected[:-2] + projected[2:]) / 2  # the middle against its neighbours in time
    ratio = np.median((rough**2).sum(axis=2), axis=0) / (
        1.5 * white[1:-1].mean(axis=0) * 2.366
    )  # median of chi2 with 3
    found = [1.0, float(np.median(ratio))]
    first = _ends_of_rests(scene.total_force[frames])
    if len(first) > _RESTS:
        change = projected[first[1:]] - projected[first[:-1]]
        expected = 3 * (white[first[1:]] + white[first[:-1]])
        found.append(float(np.quantile((change**2).sum(axis=(1, 2)) / expected.sum(axis=1), 0.25)))
    return max(found)


def _ends_of_rests(load: np.ndarray) -> np.ndarray:
    """The last frame of every run of unloaded ones."""
    rest = load < _UNLOADED * max(float(load.max()), 1e-300)
    return np.flatnonzero(rest & ~np.append(rest[1:], False))
