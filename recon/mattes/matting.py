"""Mattes: how much of each pixel is the object (paper "Reconstruction": matting with a brightness threshold)."""

import io
from contextlib import redirect_stdout
from dataclasses import dataclass, field

import cv2
import numpy as np

from recon.mattes.masks import MaskOptions, brightness_mask, plate_mask
from sim.checks import require

_MARGIN = 8  # [px] of background around the object that the closed form sees


@dataclass(frozen=True, kw_only=True)
class MattingOptions:
    """mask: how the object is found; band [px]: how far to either side of the mask's edge fur may reach.

    closed_form: solve for the shares inside the band (Levin, Lischinski and Weiss 2008); without it the matte is
    the mask itself, at a fortieth of the time.
    """

    mask: MaskOptions = field(default_factory=MaskOptions)
    band: int = 4
    closed_form: bool = True

    def __post_init__(self) -> None:
        require(self.band >= 1, "band", "be at least 1 pixel", self.band)


def matte(image: np.ndarray, plate: np.ndarray | None = None, *, options: MattingOptions | None = None) -> np.ndarray:
    """The object's share of each pixel, (H, W) float32 in [0, 1], of an image (H, W[, 3]) uint8.

    plate: the empty scene in the image's shape; without it the object is what is brighter than the dark cloth.
    All zero where no object is found. Raises ValueError for shapes that differ.
    """
    options = options or MattingOptions()
    require(image.dtype == np.uint8 and image.ndim in (2, 3), "image", "be (H, W[, 3]) of uint8", image.shape)
    if plate is None:
        mask = brightness_mask(image, options=options.mask)
    else:
        mask = plate_mask(image, plate, options=options.mask)
    if not options.closed_form or not mask.any():
        return mask.astype(np.float32)
    return closed_form(image, trimap(mask, options.band))


def trimap(mask: np.ndarray, band: int) -> np.ndarray:
    """(H, W) float: 1 surely object, 0 surely not, 0.5 within `band` pixels of the mask's edge."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * band + 1,) * 2)
    solid = mask.astype(np.uint8)
    inner = cv2.erode(solid, kernel, borderType=cv2.BORDER_REPLICATE)
    return 0.5 * (inner + cv2.dilate(solid, kernel)).astype(float)


def closed_form(image: np.ndarray, trimap: np.ndarray) -> np.ndarray:
    """The matte (H, W) float32 of an image (H, W[, 3]) uint8 where the trimap (H, W) leaves it open.

    Solved by PyMatting on the object's part of the picture only. Where nothing is sure to be object, or nothing
    open, the trimap's nearest answer is returned.
    """
    alpha = (trimap > 0.25).astype(np.float32)
    if not (trimap == 1).any() or not (trimap == 0.5).any():
        return alpha
    part = _surroundings(trimap > 0)
    import numba

    numba.config.THREADING_LAYER = "workqueue"  # Open3D's TBB is an older one, at which numba warns
    from pymatting import estimate_alpha_cf  # compiles with numba when imported

    colour = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
    with redirect_stdout(io.StringIO()):  # it prints when it has to start again, where commands print their results
        alpha[part] = np.clip(estimate_alpha_cf(colour[part] / 255.0, trimap[part]), 0, 1)
    return alpha


def _surroundings(mask: np.ndarray) -> tuple[slice, slice]:
    rows, columns = (np.flatnonzero(mask.any(axis=k)) for k in (1, 0))
    return tuple(slice(max(0, at[0] - _MARGIN), at[-1] + 1 + _MARGIN) for at in (rows, columns))
