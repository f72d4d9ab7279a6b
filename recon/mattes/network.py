"""Mattes by a network that the user brings as an ONNX file; the paper's own has no obtainable weights."""

import importlib
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from sim.checks import require

_NAMES = ("pha", "alpha", "matte", "mask")  # what networks call the matte among their outputs
_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}


class Tensor(Protocol):
    """What onnxruntime says of an input or output."""

    name: str
    shape: list[int | str | None]
    type: str


class Session(Protocol):
    """The part of onnxruntime.InferenceSession that matting needs."""

    def get_inputs(self) -> list[Tensor]:
        """The inputs in order."""

    def get_outputs(self) -> list[Tensor]:
        """The outputs in order."""

    def run(self, output_names: list[str], input_feed: dict[str, np.ndarray]) -> list[np.ndarray]:
        """The named outputs for these inputs."""


def open_network(path: str | Path) -> Session:
    """The network in an .onnx file, to be run on the processor.

    Raises ValueError when there is no such file or it holds no network, RuntimeError when onnxruntime is missing.
    """
    path = Path(path)
    require(path.is_file(), "matting network", "be an .onnx file, run by the package onnxruntime", repr(str(path)))
    try:
        onnxruntime = importlib.import_module("onnxruntime")  # optional: no dependency of the project
    except ImportError:
        said = f"{path.name} needs the package onnxruntime to run: pip install 'veo_ti[matting]'"
        raise RuntimeError(said) from None
    try:
        return onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's own classes share no other base
        reason = str(error).splitlines()[0]
        raise ValueError(f"{path.name} must hold a network that onnxruntime can run; got {reason}") from None


def network_matte(session: Session, image: np.ndarray, plate: np.ndarray | None = None) -> np.ndarray:
    """The object's share of each pixel (H, W) float32 in [0, 1] of an RGB image (H, W, 3) uint8.

    The network takes the picture, and as a second input the empty scene `plate` where it has one, as (1, 3, h, w)
    in [0, 1], and gives the matte as (1, 1, h, w), as Background Matting V2 does (Lin et al. 2021). Where its h and w
    are fixed the picture is resized to them and the matte back. Raises ValueError when its inputs or what it gives
    are of another kind.
    """
    inputs = session.get_inputs()
    fits = 1 <= len(inputs) <= 2 and all(_takes_pictures(t) for t in inputs)
    said = ", ".join(f"{t.name} {list(t.shape)}" for t in inputs)
    require(fits, "matting network's inputs", "be a picture (1, 3, h, w) and at most one empty scene alike", said)
    known = all(t.type in _TYPES for t in inputs)
    require(known, "matting network's inputs", "be of 16 or 32 bit floats", ", ".join(t.type for t in inputs))
    need = len(inputs) == 1 or plate is not None
    require(need, "plate", f"be given: the network takes the empty scene as {inputs[-1].name}", None)
    pictures = [image] if len(inputs) == 1 else [image, plate]
    feed = {t.name: _blob(t, p) for t, p in zip(inputs, pictures, strict=True)}
    name = _output(session)
    alpha = np.asarray(session.run([name], feed)[0], np.float32)
    flat = alpha.ndim >= 2 and alpha.size == alpha.shape[-1] * alpha.shape[-2]
    sound = flat and np.isfinite(alpha).all() and alpha.min() > -0.01 and alpha.max() < 1.01
    require(bool(sound), f"matting network's {name}", "be one matte between 0 and 1", f"an array {alpha.shape}")
    alpha = alpha.reshape(alpha.shape[-2:])
    return np.clip(cv2.resize(alpha, image.shape[1::-1], interpolation=cv2.INTER_LINEAR), 0, 1)


def _takes_pictures(tensor: Tensor) -> bool:
    return len(tensor.shape) == 4 and (tensor.shape[1] == 3 or not isinstance(tensor.shape[1], int))


def _blob(tensor: Tensor, picture: np.ndarray) -> np.ndarray:
    """(1, 3, h, w) in [0, 1], in the size and type that the network asks for."""
    height, width = tensor.shape[2:]
    if isinstance(height, int) and isinstance(width, int):
        picture = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    colour = picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)
    return np.ascontiguousarray(colour.transpose(2, 0, 1)[None] / 255.0, _TYPES[tensor.type])


def _output(session: Session) -> str:
    """The output that is the matte: by its name, else by its one channel."""
    outputs = session.get_outputs()
    named = [t.name for t in outputs if t.name.lower() in _NAMES]
    single = [t.name for t in outputs if len(t.shape) == 4 and t.shape[1] == 1]
    found = named or single or [t.name for t in outputs if len(outputs) == 1]
    said = ", ".join(f"{t.name} {list(t.shape)}" for t in outputs)
    require(len(found) > 0, "matting network's outputs", "hold a matte (1, 1, h, w)", said)
    return found[0]
