"""What an extension is worth on frames that chose nothing, in millimetres, with an interval over blocks of frames."""

from dataclasses import dataclass

import numpy as np

from sim.target import Target
from veo_ti.held_out import interval


@dataclass(frozen=True, kw_only=True)
class Gain:
    """Root mean square error per coordinate on the held-out frames [mm] under each model, and what was gained."""

    before_mm: float
    after_mm: float
    homogeneous_mm: float
    hold_residual_mm: float  # the baseline corrected by the residual of the nearest training frame
    no_change_mm: float
    noise_mm: float
    gained_mm: tuple[float, float, float]  # before minus after: estimate, and a 95 % interval

    @property
    def confirmed(self) -> bool:
        """Whether the interval leaves out zero."""
        return self.gained_mm[1] > 0


def measure_gain(
    target: Target, train: np.ndarray, models: dict[str, np.ndarray], sigma: float, *, seed: int = 0
) -> Gain | None:
    """Compare shown positions (T, N, 3) under the names before, after, homogeneous, no_change; None: nothing held out.

    The interval is a bootstrap over runs of held-out frames that follow each other, never over points.
    """
    held = ~train & target.seen.any(axis=1)
    if not held.any():
        return None
    squares = {name: _squares(target, y) for name, y in models.items()}
    squares["hold"] = _squares(target, models["before"] + _nearest_residual(target, models["before"], train))
    count = 3 * target.seen.sum(axis=1)

    def rms(name: str, frames: np.ndarray) -> float:
        return 1e3 * float(np.sqrt(squares[name][frames].sum() / count[frames].sum()))

    frames = np.flatnonzero(held)
    low, high = interval(lambda drawn: rms("before", drawn) - rms("after", drawn), frames, seed=seed)
    before, after = rms("before", frames), rms("after", frames)
    return Gain(
        before_mm=before, after_mm=after, homogeneous_mm=rms("homogeneous", frames),
        hold_residual_mm=rms("hold", frames), no_change_mm=rms("no_change", frames), noise_mm=1e3 * sigma,
        gained_mm=(before - after, low, high),
    )  # fmt: skip


def _squares(target: Target, y: np.ndarray) -> np.ndarray:
    return (target.residual(y) ** 2).sum(axis=(1, 2))


def _nearest_residual(target: Target, y: np.ndarray, train: np.ndarray) -> np.ndarray:
    """The residual of the nearest training frame in which a point was seen."""
    frames, known = np.arange(len(train)), np.flatnonzero(train & target.seen.any(axis=1))
    near = known[np.abs(known[None] - frames[:, None]).argmin(axis=1)]
    return target.residual(y)[near]
