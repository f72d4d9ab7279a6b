"""Kernels that exist in single precision, to train with, and in double, to check gradients with."""

from typing import Any

import taichi as ti
import torch


def real_of(dtype: torch.dtype) -> Any:
    """Taichi's type of a tensor's numbers."""
    return {torch.float32: ti.f32, torch.float64: ti.f64}[dtype]


def arrays_of(real: Any) -> tuple[Any, Any]:
    """Kernel arguments that are arrays of one and of two dimensions."""
    return ti.types.ndarray(dtype=real, ndim=1), ti.types.ndarray(dtype=real, ndim=2)
