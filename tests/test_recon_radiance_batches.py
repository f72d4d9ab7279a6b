"""Which pixels a field is trained on."""

import numpy as np
import pytest
import torch
from test_recon_radiance import OPTIONS, cameras, views  # noqa: F401

from recon.radiance.batches import Pixels
from recon.radiance.device import array
from recon.radiance.hulls import hulls_of


@pytest.fixture(scope="module")
def occupancy(views):  # noqa: F811
    return hulls_of(views, cells=OPTIONS.cells)[1]


def of_all(parts, frame: int) -> np.ndarray:
    """One frame of all cameras, pixel after pixel."""
    return np.concatenate([part[frame].reshape(-1, *part.shape[3:]) for part in parts])


def test_all_of_the_object_and_half_of_what_is_beside_it_are_looked_at(views, occupancy):  # noqa: F811
    pixels, beside = Pixels.of(views, occupancy), []
    for frame in range(len(views.times)):
        shown = of_all(views.mattes, frame) > 0
        looked = np.zeros(len(shown), bool)
        looked[pixels.hits[frame]] = True
        assert (looked[shown]).all()
        near = looked.copy()
        near[1:] |= looked[:-1]
        near[:-1] |= looked[1:]
        beside.append(looked & ~shown)
        assert beside[-1].sum() == pytest.approx((near & ~shown).sum() / 2, rel=0.15)
    assert not (beside[0] & beside[1]).any()  # the other half in the next frame


def test_what_is_drawn_is_what_was_filmed(views, occupancy):  # noqa: F811
    pixels, frames = Pixels.of(views, occupancy), torch.arange(2).repeat(200)
    batch = pixels.draw(frames, torch.Generator().manual_seed(0))
    toward = {tuple(d): n for n, d in enumerate(pixels.directions.tolist())}
    number = np.array([toward[tuple(d)] for d in batch.direction.tolist()])
    for frame in (0, 1):
        own = frames.numpy() == frame
        for drawn, filmed in ((batch.colour, views.images), (batch.matte, views.mattes)):
            expected = of_all(filmed, frame)[number[own]] / np.float32(255)
            # To the bit on a processor; a GPU may round a quotient the other way.
            np.testing.assert_array_max_ulp(array(drawn)[own], expected, maxulp=int(drawn.is_cuda))
