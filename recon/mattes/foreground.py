"""What the object alone adds to a picture: at its edges a pixel is part object, part background."""

import numpy as np


def over_black(image: np.ndarray, matte: np.ndarray) -> np.ndarray:
    """`alpha F` (h, w[, 3]) uint8 of an image `alpha F + (1 - alpha) B` and its matte alpha (h, w), both uint8.

    The object's colour F at mixed pixels is that of its neighbourhood (Germer et al. 2020, multi-level); multiplying
    the image itself by the matte would count the mixture twice and leave a dark seam.
    """
    import numba

    numba.config.THREADING_LAYER = "workqueue"  # Open3D's TBB is an older one, at which numba warns
    from pymatting import estimate_foreground_ml  # compiles with numba when imported

    alpha = matte.astype(np.float32) / 255
    if not ((matte > 0) & (matte < 255)).any():
        return np.where((matte > 0).reshape(*matte.shape, *[1] * (image.ndim - 2)), image, 0).astype(np.uint8)
    colour = image.reshape(*matte.shape, -1).astype(np.float32) / 255
    found = alpha[..., None] * np.clip(estimate_foreground_ml(colour, alpha), 0, 1)
    return np.round(255 * found).astype(np.uint8).reshape(image.shape)
