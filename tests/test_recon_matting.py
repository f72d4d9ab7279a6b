"""Mattes of a drawn furry thing whose true matte is known, a network's mattes, and frames that cannot be right."""

import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest
from furry import difference_network, shot

from recon.mattes.foreground import over_black
from recon.mattes.masks import MaskOptions, brightness_mask, cleaned, plate_mask, plate_of
from recon.mattes.matting import MattingOptions, closed_form, matte, trimap
from recon.mattes.network import network_matte, open_network
from recon.mattes.report import MatteFacts, MatteLimits, facts_of, judged

QUICK = MattingOptions(closed_form=False)


def overlap(alpha: np.ndarray, true: np.ndarray) -> float:
    """Intersection over union of what is more than half object."""
    a, b = alpha > 0.5, true > 0.5
    return (a & b).sum() / (a | b).sum()


@pytest.mark.parametrize("noise", [1.0, 3.0, 6.0])
@pytest.mark.parametrize("with_plate", [True, False])
def test_furry_thing_on_dark_cloth_is_cut_out(noise, with_plate):
    drawn = shot(np.random.default_rng(0), noise=noise)
    alpha = matte(drawn.image, drawn.plate if with_plate else None)
    assert overlap(alpha, drawn.alpha) > 0.985  # the goal is 0.975
    quick = matte(drawn.image, drawn.plate if with_plate else None, options=QUICK)
    assert overlap(quick, drawn.alpha) > 0.975
    assert np.abs(alpha - drawn.alpha).mean() < 0.6 * np.abs(quick - drawn.alpha).mean()  # fur is shared, not cut


@pytest.mark.parametrize("noise", [0.5, 3.0, 10.0])
@pytest.mark.parametrize("drift", [0.85, 1.0, 1.2])
def test_empty_scene_gives_an_empty_matte_at_any_noise_and_exposure(noise, drift):
    drawn = shot(np.random.default_rng(1), noise=noise, drift=drift, lit=40.0, thing=False)
    assert not matte(drawn.image, drawn.plate).any()


def test_a_lit_floor_is_taken_for_what_it_is():
    """By the plate, and by brightness where the light on the floor ends softly and apart from the object."""
    drawn = shot(np.random.default_rng(2), lit=40.0)
    assert overlap(matte(drawn.image, drawn.plate), drawn.alpha) > 0.985
    assert overlap(matte(drawn.image), drawn.alpha) > 0.985


def test_plate_is_what_most_pictures_show():
    plates = [shot(np.random.default_rng(k)).plate for k in range(5)]
    plates[2][50:90, 60:100] = 200  # somebody's hand
    plate = plate_of(iter(plates))
    clean = shot(np.random.default_rng(0), noise=0.0).plate
    assert plate.dtype == np.uint8 and np.abs(plate.astype(float) - clean).max() < 12
    with pytest.raises(ValueError, match="pictures of the empty scene must be at least one, of one shape"):
        plate_of([])


def test_grey_picture_is_cut_out_too():
    drawn = shot(np.random.default_rng(3))
    grey, plate = drawn.image[..., 1], drawn.plate[..., 1]
    assert overlap(matte(grey, plate), drawn.alpha) > 0.975 and overlap(matte(grey), drawn.alpha) > 0.975


def test_small_hole_is_filled_and_a_large_one_stays():
    y, x = np.mgrid[0:200, 0:200]
    from_middle = np.hypot(y - 100, x - 100)
    ring = (from_middle < 80) & (from_middle > 30) & (np.hypot(y - 40, x - 100) > 4)
    ring[5:8, 5:8] = True  # a speck
    mask = cleaned(ring, MaskOptions())
    assert mask[40, 100] and not mask[100, 100] and not mask[6, 6] and mask.sum() > ring.sum()
    assert cleaned(ring, MaskOptions(largest_hole=1.0))[100, 100]
    assert not cleaned(np.zeros((9, 9), bool), MaskOptions()).any()


def test_trimap_is_open_within_the_band_only():
    mask = np.zeros((40, 40), bool)
    mask[10:30, 10:30] = True
    opened = trimap(mask, 3)
    np.testing.assert_array_equal(opened[20, 5:15], [0, 0, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 1, 1])
    thin = np.zeros((40, 40), bool)
    thin[10:30, 20] = True  # nothing of it is sure
    image = np.zeros((40, 40, 3), np.uint8)
    np.testing.assert_array_equal(closed_form(image, trimap(thin, 3)) > 0, trimap(thin, 3) > 0)


@dataclass(frozen=True)
class FakeTensor:
    name: str
    shape: tuple
    type: str = "tensor(float)"


@dataclass(frozen=True)
class FakeSession:
    """Stands in for onnxruntime's: says the brightest channel is the matte."""

    inputs: tuple = (FakeTensor("src", (1, 3, "h", "w")),)
    outputs: tuple = (FakeTensor("fgr", (1, 3, "h", "w")), FakeTensor("pha", (1, 1, "h", "w")))
    scale: float = 1.0

    def get_inputs(self):
        return list(self.inputs)

    def get_outputs(self):
        return list(self.outputs)

    def run(self, output_names, input_feed):
        picture = input_feed["src"]
        height, width = self.inputs[0].shape[2:]
        assert output_names == ["pha"] and picture.dtype == np.float32
        assert not isinstance(height, int) or picture.shape == (1, 3, height, width)
        return [self.scale * picture.max(axis=1, keepdims=True)]


def test_network_is_fed_and_read_as_it_asks():
    image = shot(np.random.default_rng(4)).image
    expected = (image / 255.0).max(axis=2)
    np.testing.assert_allclose(network_matte(FakeSession(), image), expected, atol=1e-6)
    fixed = FakeSession(inputs=(FakeTensor("src", (1, 3, 120, 160)),))
    assert np.abs(network_matte(fixed, image) - expected).mean() < 0.03
    assert network_matte(fixed, image).shape == image.shape[:2]


def test_network_of_another_kind_is_one_sentence():
    image, plain = np.zeros((8, 8, 3), np.uint8), FakeSession()
    both = replace(plain, inputs=(*plain.inputs, FakeTensor("bgr", (1, 3, "h", "w"))))
    with pytest.raises(ValueError, match="plate must be given: the network takes the empty scene as bgr"):
        network_matte(both, image)
    recurrent = replace(plain, inputs=(*both.inputs, FakeTensor("r1i", (1, 16, "h", "w"))))
    with pytest.raises(ValueError, match=r"at most one empty scene alike; got src .*, bgr .*, r1i"):
        network_matte(recurrent, image)
    with pytest.raises(ValueError, match="matting network's outputs must hold a matte"):
        network_matte(replace(plain, outputs=plain.outputs[:1] * 2), image)
    with pytest.raises(ValueError, match="matting network's pha must be one matte between 0 and 1"):
        network_matte(replace(plain, scale=3.0), np.full((8, 8, 3), 200, np.uint8))


def test_missing_network_or_runtime_is_one_sentence_naming_both(tmp_path, monkeypatch):
    with pytest.raises(
        ValueError, match=r"matting network must be an \.onnx file, run by the package onnxruntime; got"
    ):
        open_network(tmp_path / "none.onnx")
    (tmp_path / "net.onnx").write_bytes(difference_network())
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(RuntimeError, match=r"net\.onnx needs the package onnxruntime to run"):
        open_network(tmp_path / "net.onnx")


def test_network_in_an_onnx_file_runs(tmp_path):
    pytest.importorskip("onnxruntime")
    (tmp_path / "net.onnx").write_bytes(difference_network())
    drawn = shot(np.random.default_rng(5), noise=0.0, drift=1.0)
    alpha = network_matte(open_network(tmp_path / "net.onnx"), drawn.image, drawn.plate)
    expected = np.abs(drawn.image / 255.0 - drawn.plate / 255.0).max(axis=2)
    np.testing.assert_allclose(alpha, expected, atol=1e-6)
    (tmp_path / "bad.onnx").write_bytes(b"no network")
    with pytest.raises(ValueError, match=r"bad\.onnx must hold a network that onnxruntime can run; got"):
        open_network(tmp_path / "bad.onnx")


def test_bad_frames_are_named():
    fine = MatteFacts(area=0.2, border=0.0, saturated=0.0)
    facts = [replace(fine, area=0.2 + 0.002 * k) for k in range(20)]
    facts[3] = replace(fine, area=0.0)
    facts[7], facts[8] = replace(facts[7], border=0.1), replace(facts[8], border=0.1)
    facts[12] = replace(facts[12], saturated=0.3)
    facts[15] = replace(facts[15], area=0.35)
    report = judged("cam0003", facts)
    np.testing.assert_array_equal(np.flatnonzero(report.bad), [3, 7, 8, 12, 15])
    assert report.sentences == (
        "cam0003 frame 3: the matte is empty",
        "cam0003 frames 7-8: the object is cut off by the picture's edge",
        "cam0003 frame 12: more than 5% of the object is overexposed",
        "cam0003 frame 15: the object's area jumps by more than a factor of 1.3",
    )
    assert judged("cam0003", [fine] * 5).sentences == () and not judged("cam0003", []).bad.any()


def test_facts_come_from_matte_and_picture():
    alpha, image = np.zeros((10, 20), np.float32), np.zeros((10, 20, 3), np.uint8)
    alpha[4:, 5:10] = 1.0
    image[5, 5:10, 0] = 255
    facts = facts_of(alpha, image)
    # 30 of 200 pixels; 5 of the 56 on the edge; 5 of the object's 30 have a full channel
    np.testing.assert_allclose([facts.area, facts.border, facts.saturated], [0.15, 5 / 56, 1 / 6], rtol=1e-6)


def test_bad_input_is_one_sentence():
    image = np.zeros((8, 8, 3), np.uint8)
    with pytest.raises(ValueError, match=r"plate must have the picture's shape \(8, 8, 3\); got \(8, 8\)"):
        plate_mask(image, image[..., 0])
    with pytest.raises(ValueError, match=r"image must be \(H, W\[, 3\]\) of uint8"):
        matte(image / 255.0)
    with pytest.raises(ValueError, match="band must be at least 1 pixel; got 0"):
        MattingOptions(band=0)
    with pytest.raises(ValueError, match="sigmas must be positive"):
        MaskOptions(sigmas=-1.0)
    with pytest.raises(ValueError, match="jump must be a factor above 1"):
        MatteLimits(jump=0.5)
    with pytest.raises(ValueError, match="matte must have the picture's shape"):
        facts_of(np.zeros((4, 4)), image)
    assert not brightness_mask(image).any()


def mixed(*depth: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A disc of one colour over a brighter ground: picture, matte, and the disc over black."""
    y, x = np.mgrid[:60, :60]
    alpha = np.clip(22 - np.hypot(x - 30, y - 30), 0, 4) / 4
    alpha = alpha.reshape(60, 60, *[1] * len(depth))
    disc, ground = np.array([180.0, 120.0, 60.0])[: depth[0] if depth else 1], 230.0
    image = alpha * (disc if depth else disc[0]) + (1 - alpha) * ground
    matte = np.round(255 * alpha.reshape(60, 60)).astype(np.uint8)
    return np.round(image).astype(np.uint8), matte, image - (1 - alpha) * ground


@pytest.mark.parametrize("depth", [(), (3,)])
def test_the_background_is_taken_out_of_mixed_pixels(depth):
    image, alpha, alone = mixed(*depth)
    edge = (alpha > 20) & (alpha < 235)
    off = np.abs(over_black(image, alpha).astype(float) - alone)[edge].mean()
    twice = np.abs(alpha.reshape(60, 60, *[1] * len(depth)) / 255.0 * image - alone)[edge].mean()
    assert off < 8 and off < twice / 4
    sharp = np.where(alpha > 127, 255, 0).astype(np.uint8)
    assert (over_black(image, sharp) == np.where((sharp > 0).reshape(60, 60, *[1] * len(depth)), image, 0)).all()
