"""Where fits ended, kept in files, so that an interrupted diagnosis goes on where it stopped."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from veo_ti.kept import keep, key_of, recalled

_ALIKE = 1e-3  # share of the largest number, to which two fits are asked for the same


@dataclass(eq=False)
class Checkpoints:
    """The fits of one diagnosis in their order, which is always the same; none where there is no folder."""

    folder: Path | None = None
    key: str = ""  # what decides the diagnosis: measurement, options, catalogue
    count: int = 0

    def next(self, name: str, asked: np.ndarray) -> dict[str, np.ndarray] | None:
        """Where the next fit ended, if that is known: one of this name that began with the same numbers.

        Not to the last digit: what a solve leaves depends on the factors that others before it left.
        """
        self.count += 1
        found = None if self.folder is None else recalled(self._path, self._key(name))
        if found is None or found["asked"].shape != asked.shape:
            return None
        return found if np.abs(found["asked"] - asked).max() <= _ALIKE * np.abs(asked).max() else None

    def keep(self, name: str, asked: np.ndarray, ended: Mapping[str, np.ndarray]) -> None:
        """That is where this fit ended."""
        if self.folder is not None:
            keep(self._path, self._key(name), {"asked": asked, **ended})

    def _key(self, name: str) -> str:
        return key_of(self.key, name)

    @property
    def _path(self) -> Path:
        return self.folder / f"checkpoint_fit_{self.count:03d}.npz"
