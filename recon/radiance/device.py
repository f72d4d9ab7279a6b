"""Where tensors live: on the device that Taichi's kernels run on, so that neither copies for the other."""

import numpy as np
import torch

from sim import runtime
from sim.checks import require


def use(name: str) -> None:
    """Start Taichi on "cpu" or "cuda", and so everything here; before anything else.

    On a GPU the same seed gives the same result but for rounding: sums are added up in another order every time.
    Raises ValueError when torch or Taichi has no such device, or Taichi runs on the other one.
    """
    require(name != "cuda" or torch.cuda.is_available(), "device", "be one that torch sees", repr(name))
    try:
        runtime.ensure(name)
    except RuntimeError as error:
        raise ValueError(f"device must be one that Taichi can use; got {name!r}: {error}") from None


def device() -> torch.device:
    """The GPU when Taichi was started on it, else the CPU."""
    return torch.device(runtime.running())


def tensor(values: np.ndarray) -> torch.Tensor:
    """An array on the device; on the CPU it shares the array's memory."""
    return torch.from_numpy(values).to(device())


def array(values: torch.Tensor) -> np.ndarray:
    """Back from the device."""
    return values.detach().cpu().numpy()
