"""What a material remembers of its strains: a Maxwell branch, or a permanent set."""

from dataclasses import dataclass

import numpy as np

from sim.checks import as_array, require

_SHARP = 16  # power of the strain: how much the larger of two strains alone decides what stays


def green_strain(F: np.ndarray) -> np.ndarray:
    """`E = (F^T F - 1) / 2` of F (..., 3, 3)."""
    return (np.swapaxes(F, -1, -2) @ F - np.eye(3)) / 2


@dataclass(frozen=True, kw_only=True, eq=False)
class Memory:
    """What stays of strains E (T, ...): `own_t E_t + past_t` with `past_t = decay_t past_before + share_t E_before`.

    Each (T, ...), of a shape that goes with E.
    """

    own: np.ndarray
    decay: np.ndarray
    share: np.ndarray

    def past(self, E: np.ndarray) -> np.ndarray:
        """What the frames before have left in each, (T, ...); ValueError when E has another number of frames."""
        require(len(E) == len(self.own), "E", f"have {len(self.own)} frames, one for each time", len(E))
        out = np.zeros_like(E, dtype=float)
        for t in range(1, len(E)):
            out[t] = self.then(t, out[t - 1], E[t - 1])
        return out

    def then(self, frame: int, past: np.ndarray, E: np.ndarray) -> np.ndarray:
        """The past of a frame from that of the frame before, and its strain."""
        return self.decay[frame] * past + self.share[frame] * E


def viscous(time: np.ndarray, tau: float) -> Memory:
    """The viscous strain `tau E_v' = E - E_v`, E_v = 0 at the first frame, at times (T,) [s].

    With x = step / tau and f = 1 - (1 - e^-x) / x: `E_v <- e^-x E_v + (1 - f - e^-x) E_before + f E_now`, exact for a
    strain that is linear between the frames, whatever the step. Raises ValueError when time does not increase or
    tau [s] is not positive.
    """
    steps = np.diff(as_array("time", time, (None,)))
    require(bool((steps > 0).all()), "time", "increase from frame to frame", steps.min(initial=np.inf))
    require(tau > 0, "tau", "be positive", tau)
    x = np.concatenate([[np.inf], steps / tau])
    decay = np.exp(-x)
    mean = np.where(np.isinf(x), 1.0, -np.expm1(-x) / x)
    own = 1 - mean
    return Memory(own=own, decay=decay, share=decay * np.concatenate([[0.0], own[:-1]]) + (mean - decay))


def largest(E: np.ndarray, beyond: float = 0.0) -> Memory:
    """The largest strain so far, of E (T, N, 3, 3), or the share of it by which its size is beyond a yield strain.

    Strains are weighted by a high power of their size, so that two of about the same size do not take turns.
    """
    size = np.linalg.norm(E, axis=(2, 3), keepdims=True)
    most = np.maximum(np.maximum.accumulate(size, axis=0), 1e-300)
    fade = np.concatenate([np.zeros_like(most[:1]), most[:-1] / most[1:]]) ** _SHARP  # of all weights so far
    total = np.zeros_like(size)  # of sizes by their weights
    for t, now in enumerate((size / most) ** _SHARP * size):
        total[t] = now + (fade[t] * total[t - 1] if t else 0.0)
    scale = most / np.maximum(total, most)
    before = np.concatenate([np.ones_like(scale[:1]), scale[:-1]])
    earlier = np.concatenate([np.zeros_like(size[:1]), size[:-1]])
    yielded, earlier_too = (np.maximum(1 - beyond / np.maximum(s, 1e-300), 0.0) for s in (size, earlier))
    return Memory(
        own=scale * (size / most) ** _SHARP * yielded, decay=scale / before * fade,
        share=scale * (earlier / most) ** _SHARP * earlier_too,
    )  # fmt: skip
