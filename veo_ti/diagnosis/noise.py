"""The noise of a measurement from its own residual: what neighbours do not share, and what stray points look like."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from sim.evidence import design_effect
from veo_ti.diagnosis.scene import Scene

_STENCIL = 14
_FLAT = 1e-3  # singular values below it: neighbours in a plane or on a line
_FEW = 5  # neighbours that it takes to say what they share
_UNLOADED = 0.02  # of the largest load
_RESTS = 3  # unloaded spells that it takes to compare them
_LASTING = 0.6  # of the energy, that does not change over the frames: beyond it something stays, which noise does not
_QUIETEST, _QUIET = 0.1, 2.0  # of the frames, and times their energy, which noise that goes on may have in the others
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
    around = _Neighbourhoods.of(scene)
    stray, e = around.stray(scene.residual, scene.target.seen, scene.target.sigma or 0.0)
    estimate = _size(e)
    sigma = scene.target.sigma or estimate
    share = float(stray.sum() / max(scene.target.seen.sum(), 1))
    correlation = _correlation(scene, modes, sigma, stray)
    return Noise(sigma=sigma, local=estimate, stray=stray, correlation=correlation, outlier_share=share)


def counted(scene: Scene, noise: Noise, modes: np.ndarray) -> float:
    """The variance at which residuals count [m2]: the noise's, or that of the whole residual while it is larger.

    Where the model is wrong, the material would else be bent far beyond its linearisation to imitate what is missing.
    """
    r, seen = scene.residual * scene.train[:, None, None], scene.target.seen & scene.train[:, None]
    square = float((r**2).sum() / (3 * seen.sum()))
    return max(noise.variance, square * design_effect(r, seen, modes))


def evenness(scene: Scene, modes: np.ndarray) -> float:
    """Energy of the residual's smooth modes (N, S), beyond that of white noise, in the quietest tenth of the training
    frames, over the mean.

    Noise that neighbours share goes on in every frame, whatever the load; physics that is missing follows the load, or
    stays, which counts as zero. Without a known sigma nothing counts as white.
    """
    frames = np.flatnonzero(scene.train & scene.target.seen.any(axis=1))
    frames = frames[frames > 0]  # the reference is taken as it was seen
    if len(frames) < 5:
        return 0.0
    projected = np.einsum("ns,tnc->tsc", modes, scene.residual[frames])
    energy = (projected**2).sum(axis=(1, 2))
    if (projected.mean(axis=0) ** 2).sum() > _LASTING * energy.mean():
        return 0.0
    beyond = energy - 3 * _white(scene.target.sigma or 0.0, modes, scene.target.seen[frames]).sum(axis=1)
    return max(float(np.quantile(beyond, _QUIETEST) / max(beyond.mean(), 1e-300)), 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Neighbourhoods:
    """The points near every point that is ever seen, by which an affine fit predicts what is smooth."""

    used: np.ndarray  # (U,)
    near: np.ndarray  # (U, k) of all points
    design: np.ndarray  # (U, k, 4)

    @classmethod
    def of(cls, scene: Scene) -> "_Neighbourhoods":
        used = np.flatnonzero(scene.target.seen.any(axis=0))
        x = scene.cloud.x[used]
        near = cKDTree(x).query(x, min(_STENCIL, len(used)))[1][:, 1:]
        arms = (x[near] - x[:, None]) / scene.cloud.spacing
        return cls(used=used, near=used[near], design=np.concatenate([np.ones((*arms.shape[:2], 1)), arms], axis=2))

    def beyond(self, r: np.ndarray, good: np.ndarray) -> np.ndarray:
        """What of r (T, N, 3) [m] the good (T, N) neighbours do not share, as large as white noise is in r; NaN where a
        point is not good itself or too few around it are."""
        e, share = np.full_like(r, np.nan), good[:, self.near]  # (T, U, k)
        whole = share.all(axis=2)
        weights = np.linalg.pinv(self.design, rcond=_FLAT)[:, 0]  # (U, k): predicts the value at the point itself
        smooth = np.einsum("uk,tukc->tuc", weights, r[:, self.near])
        gain = np.sqrt(1 + (weights**2).sum(axis=1))
        e[:, self.used] = np.where(whole[..., None], (r[:, self.used] - smooth) / gain[:, None], np.nan)
        t, u = np.nonzero(~whole & (share.sum(axis=2) >= _FEW))
        D = self.design[u] * share[t, u][..., None]
        inverse = np.linalg.pinv(np.swapaxes(D, 1, 2) @ D, rcond=_FLAT**2, hermitian=True)
        weights = np.einsum("pa,pka->pk", inverse[:, 0], D)
        smooth = np.einsum("pk,pkc->pc", weights, r[t[:, None], self.near[u]])
        e[t, self.used[u]] = (r[t, self.used[u]] - smooth) / np.sqrt(1 + (weights**2).sum(axis=1))[:, None]
        return np.where(good[..., None], e, np.nan)

    def stray(self, r: np.ndarray, seen: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
        """The points (T, N) far from what their neighbours say, and what all others do not share with theirs.

        Of every neighbourhood the one farthest off is stray; the others are judged again without it.
        """
        stray = np.zeros_like(seen)
        while True:
            e = self.beyond(r, seen & ~stray)
            off = np.nan_to_num(np.abs(e)).max(axis=2)
            over = off > _STRAY * max(sigma, _size(e))
            if not over.any():
                return stray, e
            highest = np.zeros_like(off)
            highest[:, self.used] = off[:, self.near].max(axis=2)
            stray |= over & (off >= highest)


def _size(e: np.ndarray) -> float:
    """Standard deviation of normal numbers, which outliers do not move."""
    return float(np.nanmedian(np.abs(e))) / 0.67449


def _correlation(scene: Scene, modes: np.ndarray, sigma: float, stray: np.ndarray) -> float:
    """Energy of what cannot be elastic in the residual's smooth spatial modes over that of white noise, at least 1.

    That is its part that is rough in time, and the difference between unloaded frames with loads between them, which
    shows noise that is slow in time too; of those the lower quartile, since a permanent set differs as well. No more
    than the quietest frames hold: a body that lags is not back in an unloaded frame, and moves roughly.
    """
    frames = np.flatnonzero(scene.train & scene.target.seen.any(axis=1))
    if len(frames) < 5:
        return 1.0
    seen = scene.target.seen[frames] & ~stray[frames]
    r = np.where(seen[..., None], scene.residual[frames], 0.0)
    projected = np.einsum("ns,tnc->tsc", modes, r)
    white = _white(sigma, modes, seen)
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
    energy = (projected**2).sum(axis=(1, 2)) / (3 * white.sum(axis=1))
    quiet = float(np.quantile(energy[frames > 0], _QUIETEST))  # the reference is taken as it was seen
    return max(1.0, min(max(found), _QUIET * quiet))


def _white(sigma: float, modes: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Expected square (T, S) [m2] of a coordinate of white noise in modes (N, S), where points are seen (T, N)."""
    return sigma**2 * np.einsum("ns,tn->ts", modes**2, seen.astype(float))


def _ends_of_rests(load: np.ndarray) -> np.ndarray:
    """The last frame of every run of unloaded ones."""
    rest = load < _UNLOADED * max(float(load.max()), 1e-300)
    return np.flatnonzero(rest & ~np.append(rest[1:], False))
