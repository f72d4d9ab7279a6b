"""Steps of long work whose results are kept in files, so that an interrupted command goes on from there."""

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from recon.files import replacing
from veo_ti.store import read_npz


def key_of(*parts: object) -> str:
    """A fingerprint of what decides a result: texts, numbers, tuples and dataclasses of them, arrays."""
    digest = hashlib.sha256()
    for part in parts:
        array = isinstance(part, np.ndarray)
        digest.update(np.ascontiguousarray(part).tobytes() if array else repr(part).encode())
        digest.update(b"|")
    return digest.hexdigest()


def kept(path: Path, key: str, make: Callable[[], Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """The arrays in the .npz file when it was made with the same key, else those that `make` gives, kept there."""
    found = _read(path)
    if found.pop("key", None) == key:
        return found
    made = dict(make())
    with replacing(path) as partial:
        np.savez_compressed(partial, key=np.array(key), **made)
    return made


def _read(path: Path) -> dict[str, np.ndarray]:
    """What the file holds; nothing when it is missing or damaged."""
    try:
        return read_npz(path)
    except ValueError:
        return {}
