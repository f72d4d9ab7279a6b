"""Drawn pictures of a furry thing on dark cloth with its true matte, and a matting network of three operations."""

from dataclasses import dataclass

import cv2
import numpy as np

FINE = 4  # drawn pixels a picture's pixel, along each side


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A picture and the empty scene (H, W, 3) uint8, and the share of the thing in each pixel (H, W)."""

    image: np.ndarray
    plate: np.ndarray
    alpha: np.ndarray


def shot(
    rng: np.random.Generator, *, noise: float = 3.0, drift: float = 1.03, lit: float = 0.0, thing: bool = True
) -> Shot:
    """noise: grey levels; drift: of the exposure since the plate; lit: levels of a stage light on the floor."""
    height, width = 240, 320
    y, x = np.mgrid[0 : height * FINE, 0 : width * FINE] / FINE
    angle, radius = np.arctan2(y - 120, x - 150), np.hypot(y - 120, x - 150)
    hair = 4 * rng.random(2000)[((angle + np.pi) / (2 * np.pi) * 1999).astype(int)] - 2
    inside = (radius < 62 + 14 * np.sin(3 * angle + 1) + 5 * np.sin(7 * angle) + hair).astype(np.float32)
    alpha = cv2.GaussianBlur(cv2.resize(inside, (width, height), interpolation=cv2.INTER_AREA), (0, 0), 0.6)
    y, x = np.mgrid[0:height, 0:width]
    cloth = 14 + 4 * np.sin(x / 37) * np.cos(y / 51) + lit * np.exp(-(((x - 270) / 45) ** 2) - ((y - 200) / 25) ** 2)
    cloth = cloth[..., None] * [1.0, 0.95, 1.05]
    fur = [104, 74, 54] + 120 * cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), 3)[..., None]
    eye = np.hypot(y - 105, x - 162) < 5
    fur = np.where(eye[..., None], 0.8 * cloth, np.clip(fur, 0, 255))
    share = alpha[..., None] * thing
    return Shot(
        image=_taken(drift * (share * fur + (1 - share) * cloth), noise, rng),
        plate=_taken(cloth, noise, rng),
        alpha=alpha * thing,
    )


def _taken(light: np.ndarray, noise: float, rng: np.random.Generator) -> np.ndarray:
    return np.clip(np.rint(light + noise * rng.normal(size=light.shape)), 0, 255).astype(np.uint8)


def difference_network() -> bytes:
    """An .onnx file: `pha = max over channels of |src - bgr|`, written by hand in the format's protocol buffers."""
    nodes = _node("Sub", ("src", "bgr"), "d") + _node("Abs", ("d",), "a")
    axes = _field(1, b"axes") + _field(8, 1) + _field(20, 7)
    nodes += _node("ReduceMax", ("a",), "pha", axes)
    values = _field(11, _value("src", 3)) + _field(11, _value("bgr", 3)) + _field(12, _value("pha", 1))
    graph = nodes + _field(2, b"difference") + values
    return _field(1, 7) + _field(8, _field(1, b"") + _field(2, 13)) + _field(7, graph)


def _field(number: int, value: int | bytes) -> bytes:
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value)
    return _varint(number << 3 | 2) + _varint(len(value)) + value


def _varint(value: int) -> bytes:
    return bytes([value]) if value < 128 else bytes([value & 127 | 128]) + _varint(value >> 7)


def _node(kind: str, inputs: tuple[str, ...], output: str, attribute: bytes = b"") -> bytes:
    names = b"".join(_field(1, name.encode()) for name in inputs) + _field(2, output.encode())
    return _field(1, names + _field(4, kind.encode()) + (_field(5, attribute) if attribute else b""))


def _value(name: str, channels: int) -> bytes:
    sizes = [_field(1, 1), _field(1, channels), _field(2, b"h"), _field(2, b"w")]
    shape = b"".join(_field(1, size) for size in sizes)
    return _field(1, name.encode()) + _field(2, _field(1, _field(1, 1) + _field(2, shape)))
