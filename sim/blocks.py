"""Block-diagonal matrices: one 3 x 3 block per frame and point."""

import numpy as np
import taichi as ti

from sim.dtypes import Matrices2, Vectors2, contiguous


@ti.kernel
def _apply(blocks: Matrices2, v: Vectors2, out: Vectors2):
    for t, i in ti.ndrange(v.shape[0], v.shape[1]):
        out[t, i] = blocks[t, i] @ v[t, i]


@ti.kernel
def _invert(blocks: Matrices2, out: Matrices2):
    for t, i in ti.ndrange(blocks.shape[0], blocks.shape[1]):
        out[t, i] = blocks[t, i].inverse()


def apply_blocks(blocks: np.ndarray, v: np.ndarray) -> np.ndarray:
    """blocks (T, N, 3, 3) times v (T, N, 3)."""
    v = contiguous(v)
    out = np.empty_like(v)
    _apply(blocks, v, out)
    return out


def invert_blocks(blocks: np.ndarray) -> np.ndarray:
    """Inverses of blocks (T, N, 3, 3)."""
    blocks = contiguous(blocks)
    out = np.empty_like(blocks)
    _invert(blocks, out)
    return out
