"""Steps of long work whose results are kept in files, so that an interrupted command goes on from there."""

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from recon.files import replacing
from veo_ti import __version__
from veo_ti.store import read_npz


def key_of(*parts: object) -> str:
    """A fingerprint of what decides a result: this version, texts, numbers, tuples and dataclasses of them, arrays."""
    digest = hashlib.sha256(__version__.encode())
    for part in parts:
        array = isinstance(part, np.ndarray)
        digest.update(np.ascontiguousarray(part).tobytes() if array else repr(part).encode())
        digest.update(b"|")
    return digest.hexdigest()


def kept(path: Path, key: str, make: Callable[[], Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """The arrays in the .npz file when it was made with the same key, else those that `make` gives, kept there."""
    found = recalled(path, key)
    return keep(path, key, make()) if found is None else found


def keep(path: Path, key: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays, once they are in the .npz file under that key."""
    with replacing(path) as partial:
        np.savez_compressed(partial, key=np.array(key), **arrays)
    return dict(arrays)


def recalled(path: Path, key: str) -> dict[str, np.ndarray] | None:
    """The arrays that the file holds under that key; None where it is missing, damaged or of another one."""
    try:
        found = read_npz(path)
    except ValueError:
        return None
    return found if found.pop("key", None) == key else None
