"""Frames whose matte cannot be right: empty, cut off, overexposed, or suddenly of another size."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sim.checks import require

_NEAR = 5  # frames to either side that say what size is usual


@dataclass(frozen=True, kw_only=True)
class MatteLimits:
    """empty: smallest share of the picture that is an object. border: most object pixels on the picture's edge, as a
    share of that edge. saturated: largest share of the object with a full channel. jump: largest factor by which
    the area may change from one frame to the next.
    """

    empty: float = 1e-4
    border: float = 1e-3
    saturated: float = 0.05
    jump: float = 1.3

    def __post_init__(self) -> None:
        for name in ("empty", "border", "saturated"):
            require(0 <= getattr(self, name) <= 1, name, "be a share between 0 and 1", getattr(self, name))
        require(self.jump > 1, "jump", "be a factor above 1", self.jump)


@dataclass(frozen=True, kw_only=True)
class MatteFacts:
    """What one frame's matte says about itself, all as shares (see MatteLimits)."""

    area: float
    border: float
    saturated: float


@dataclass(frozen=True, kw_only=True, eq=False)
class MatteReport:
    """The frames of one camera that should not be used, and why."""

    camera: str
    bad: np.ndarray  # (T,) bool
    sentences: tuple[str, ...]


def facts_of(matte: np.ndarray, image: np.ndarray) -> MatteFacts:
    """Facts of a matte (H, W) in [0, 1] and its image (H, W[, 3]) uint8."""
    require(matte.shape == image.shape[:2], "matte", f"have the picture's shape {image.shape[:2]}", matte.shape)
    mask = matte > 0.5
    edge = np.concatenate([mask[0], mask[-1], mask[1:-1, 0], mask[1:-1, -1]])
    full = image.max(axis=2) == 255 if image.ndim == 3 else image == 255
    saturated = float(full[mask].mean()) if mask.any() else 0.0
    return MatteFacts(area=float(matte.mean()), border=float(edge.mean()), saturated=saturated)


def judged(camera: str, facts: Sequence[MatteFacts], *, limits: MatteLimits | None = None) -> MatteReport:
    """Which frames are bad, in sentences that name camera and frames."""
    limits = limits or MatteLimits()
    area, border, saturated = (np.array([getattr(f, k) for f in facts], float) for k in ("area", "border", "saturated"))
    empty = area < limits.empty
    faults = (
        (empty, "the matte is empty"),
        (~empty & (border > limits.border), "the object is cut off by the picture's edge"),
        (~empty & (saturated > limits.saturated), f"more than {limits.saturated:.0%} of the object is overexposed"),
        (_jumping(area, ~empty, limits.jump), f"the object's area jumps by more than a factor of {limits.jump:g}"),
    )
    bad = np.any([fault for fault, _ in faults], axis=0) if len(facts) else np.zeros(0, bool)
    said = tuple(f"{camera} {spelled(np.flatnonzero(f))}: {what}" for f, what in faults if f.any())
    return MatteReport(camera=camera, bad=bad, sentences=said)


def spelled(frames: np.ndarray) -> str:
    """ "frame 3" or "frames 3, 7-9" of ascending numbers."""
    runs = np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1)
    said = ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)
    return f"frame {said}" if len(frames) == 1 else f"frames {said}"


def _jumping(area: np.ndarray, sound: np.ndarray, factor: float) -> np.ndarray:
    """(T,) bool: of two neighbouring frames whose areas differ by the factor, the one less usual around there."""
    jumps, at = np.zeros(len(area), bool), np.flatnonzero(sound)
    for one, other in pairwise(at):
        if not 1 / factor <= area[other] / area[one] <= factor:
            near = at[(at >= one - _NEAR) & (at <= other + _NEAR)]
            usual = np.median(area[near])
            far = np.abs(np.log(area[[one, other]] / usual))
            jumps[other if far[1] >= far[0] else one] = True
    return jumps
