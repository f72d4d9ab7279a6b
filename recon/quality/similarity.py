"""PSNR and SSIM of pictures, and a row of the paper's Table 2 (tab:rerender)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from skimage.metrics import structural_similarity

from recon.quality.lpips import Lpips
from sim.checks import as_array, require


@dataclass(frozen=True, kw_only=True)
class Quality:
    """psnr [dB]; ssim, 1 where equal; lpips, 0 where equal, None where its weights are not at hand."""

    psnr: float
    ssim: float
    lpips: float | None


@dataclass(frozen=True, kw_only=True)
class QualityRow:
    """One half of a row of the paper's Table 2, means over pictures. object_psnr counts the object's pixels only: a
    dark background, easily right, flatters the others by about 5 dB."""

    not_masked: Quality
    masked: Quality
    object_psnr: float


def psnr(shown: np.ndarray, filmed: np.ndarray, counted: np.ndarray | None = None) -> float:
    """`-10 log10 mean (a - b)^2` [dB] of pictures (h, w[, 3]) in 0 to 1; counted (h, w) bool: the pixels that do.

    Infinite where they are equal. Raises ValueError for other shapes, or when nothing is counted.
    """
    filmed = np.asarray(filmed, float)
    shown = as_array("shown", shown, filmed.shape)
    counted = np.ones(filmed.shape[:2], bool) if counted is None else np.asarray(counted, bool)
    require(bool(counted.any()), "counted", "hold a pixel", "none")
    error = float(np.mean((shown - filmed)[counted] ** 2))
    return float("inf") if error == 0 else -10 * float(np.log10(error))


def ssim(shown: np.ndarray, filmed: np.ndarray) -> float:
    """Structural similarity (Wang et al. 2004) of colour pictures (h, w, 3) in 0 to 1: Gaussian window, sigma 1.5.

    Raises ValueError for pictures smaller than the window of 11 pixels.
    """
    filmed = np.asarray(filmed, float)
    shown = as_array("shown", shown, filmed.shape)
    require(min(filmed.shape[:2]) >= 11, "pictures", "have at least 11 pixels a side", filmed.shape[:2])
    return float(structural_similarity(
        shown, filmed, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1.0, channel_axis=-1
    ))  # fmt: skip


def quality(shown: np.ndarray, filmed: np.ndarray, lpips: Lpips | None = None) -> Quality:
    """All three of one pair of pictures (h, w, 3) in 0 to 1."""
    learned = None if lpips is None else lpips(shown, filmed)
    return Quality(psnr=psnr(shown, filmed), ssim=ssim(shown, filmed), lpips=learned)


def quality_row(
    shown: Sequence[np.ndarray], filmed: Sequence[np.ndarray], mattes: Sequence[np.ndarray], lpips: Lpips | None = None
) -> QualityRow:
    """Means over pictures (h, w, 3) in 0 to 1; masked: both pictures times the matte (h, w), 0 to 1.

    Raises ValueError for unequal numbers of pictures, or a matte without object.
    """
    require(len(shown) == len(filmed) == len(mattes) > 0, "pictures", "be as many as mattes", len(shown))
    plain, masked, own = [], [], []
    for a, b, matte in zip(shown, filmed, mattes, strict=True):
        plain.append(quality(a, b, lpips))
        masked.append(quality(a * matte[..., None], b * matte[..., None], lpips))
        own.append(psnr(a, b, matte > 0.5))
    return QualityRow(not_masked=_mean(plain), masked=_mean(masked), object_psnr=float(np.mean(own)))


def _mean(rows: Sequence[Quality]) -> Quality:
    lpips = [r.lpips for r in rows if r.lpips is not None]
    return Quality(
        psnr=float(np.mean([r.psnr for r in rows])), ssim=float(np.mean([r.ssim for r in rows])),
        lpips=float(np.mean(lpips)) if lpips else None,
    )  # fmt: skip
