"""What every part of the total energy offers, and the pointwise Hessian that most of them have."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sim.blocks import apply_blocks


@dataclass(frozen=True, kw_only=True, eq=False)
class PointBlocks:
    """A Hessian that couples no two points: blocks (T, N, 3, 3)."""

    blocks: np.ndarray

    def product(self, p: np.ndarray) -> np.ndarray:
        """H p, (T, N, 3)."""
        return apply_blocks(self.blocks, p)


class TermTangent(Protocol):
    """The Hessian of a term: its pointwise blocks (T, N, 3, 3) serve preconditioners, the product is all of it."""

    blocks: np.ndarray

    def product(self, p: np.ndarray) -> np.ndarray:
        """H p, (T, N, 3)."""


class Term(Protocol):
    """One part of the energy over a batch y (T, N, 3) [m]; a novel interaction is one more term in the list."""

    def value(self, y: np.ndarray) -> np.ndarray:
        """Energy of each frame, (T,) [J]."""

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """dE/dy, (T, N, 3) [N]."""

    def tangent(self, y: np.ndarray, project: np.ndarray | None = None) -> TermTangent | None:
        """The Hessian, without its negative part in the frames where `project` is set; None for a linear energy."""

    def frames(self, index: np.ndarray) -> "Term":
        """The same term for the chosen frames only."""


def per_frame(array: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Rows `index` of a per-frame array; an array of one row holds for every frame."""
    return array if len(array) == 1 else array[index]


def mixed(array: np.ndarray, frame: int, share: float) -> np.ndarray:
    """A per-frame array the `share` of the way from `frame` to the next, one row."""
    if len(array) == 1:
        return array
    return (1 - share) * array[frame : frame + 1] + share * array[frame + 1 : frame + 2]
