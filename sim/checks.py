"""Input checks whose every failure is one sentence: `{name} must {rule}; got {value}`."""

from collections.abc import Sequence

import numpy as np


def require(ok: bool, name: str, rule: str, got: object) -> None:
    """Raise ValueError "{name} must {rule}; got {got}" unless ok."""
    if not ok:
        raise ValueError(f"{name} must {rule}; got {got}")


def as_array(name: str, value: object, shape: Sequence[int | None], dtype: type = np.float64) -> np.ndarray:
    """A contiguous array of the given shape (None: any length) and dtype, all finite.

    Raises ValueError naming the array when the shape is wrong or a value is NaN or infinite.
    """
    try:
        array = np.ascontiguousarray(value, dtype=dtype)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be an array of {np.dtype(dtype).name}; got {type(value).__name__}") from None
    wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
    fits = array.ndim == len(shape) and all(n is None or n == m for n, m in zip(shape, array.shape, strict=True))
    require(fits, name, f"have shape {wanted}", array.shape)
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        bad = np.argwhere(~np.isfinite(array))
        first = tuple(bad[0].tolist())
        raise ValueError(f"{name} must be finite; got {len(bad)} NaN or infinite values, the first at {first}")
    return array


def some(indices: np.ndarray, most: int = 5) -> str:
    """The first few indices in words, for messages: "3, 17, 20 and 41 more"."""
    shown = ", ".join(str(int(i)) for i in indices[:most])
    return shown if len(indices) <= most else f"{shown} and {len(indices) - most} more"
