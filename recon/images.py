"""Pictures of one camera that are files in a folder or an array, delivered like a video."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from recon.files import replacing
from sim.checks import require


@dataclass(frozen=True, eq=False)
class ImageFiles:
    """A picture file a frame, read when asked for. grey: delivered as (height, width), as mattes are.

    Raises ValueError naming file and camera for a file that is missing, no picture, or of another size than the first.
    """

    paths: Sequence[Path]
    grey: bool = False
    camera: str = ""
    fps: float = 1.0
    size: tuple[int, int] = field(init=False)  # width, height [px]

    def __post_init__(self) -> None:
        require(len(self.paths) > 0, f"pictures of {self.camera or 'a camera'}", "be at least one", 0)
        object.__setattr__(self, "paths", tuple(map(Path, self.paths)))
        object.__setattr__(self, "size", self._read(self.paths[0]).shape[1::-1])

    @property
    def count(self) -> int:
        """Frames."""
        return len(self.paths)

    @property
    def label(self) -> str:
        """The folder and the camera, for messages."""
        return self._label(self.paths[0].parent)

    @property
    def identity(self) -> str:
        """Changes when a file does."""
        states = [(str(p.resolve()), p.stat().st_size, p.stat().st_mtime_ns) for p in self.paths if p.exists()]
        return hashlib.sha256(repr((states, self.grey)).encode()).hexdigest()

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
        """Pictures start to stop: (height, width, 3) RGB or (height, width) grey, uint8."""
        stop = self.count if stop is None else stop
        fits = 0 <= start <= stop <= self.count
        require(fits, f"frames of {self.label}", f"be among its {self.count}", f"{start} to {stop}")
        for path in self.paths[start:stop]:
            image = self._read(path)
            wanted = f"be {self.size[0]} x {self.size[1]} pixels as the first"
            require(image.shape[1::-1] == self.size, self._label(path), wanted, image.shape[1::-1])
            yield image

    def _read(self, path: Path) -> np.ndarray:
        return read_image(path, grey=self.grey, label=self._label(path))

    def _label(self, path: Path) -> str:
        return f"{path.name} ({self.camera})" if self.camera else path.name


@dataclass(frozen=True, eq=False)
class Pictures:
    """The same for an array or memory map (T, height, width[, 3]) uint8; label: what it is, for messages."""

    array: np.ndarray
    label: str
    fps: float = 1.0

    @property
    def count(self) -> int:
        """Frames."""
        return len(self.array)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.array.shape[2], self.array.shape[1]

    @property
    def identity(self) -> str:
        """Changes when the pictures do; reads them all."""
        digest = hashlib.sha256(f"{self.label} {self.array.shape}".encode())
        for image in self.array:
            digest.update(np.ascontiguousarray(image))
        return digest.hexdigest()

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
        """Pictures start to stop."""
        stop = self.count if stop is None else stop
        fits = 0 <= start <= stop <= self.count
        require(fits, f"frames of {self.label}", f"be among its {self.count}", f"{start} to {stop}")
        yield from (np.asarray(image) for image in self.array[start:stop])


def shown(colour: np.ndarray) -> np.ndarray:
    """Numbers from 0 to 1 as the bytes of a picture; those beyond are cut."""
    return (255 * np.asarray(colour).clip(0, 1)).astype(np.uint8)


def read_image(path: str | Path, *, grey: bool = False, label: str = "") -> np.ndarray:
    """A picture file as (height, width, 3) RGB or (height, width) grey, uint8; raises ValueError naming it."""
    label, there = label or Path(path).name, Path(path).is_file()
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR) if there else None
    require(image is not None, label, "be a readable picture", "something else" if there else "no such file")
    return image if grey else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def write_image(path: str | Path, image: np.ndarray) -> Path:
    """Write RGB (height, width, 3) or grey (height, width) uint8 in the format of the ending; whole or not at all."""
    stored = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    with replacing(path) as partial:
        require(cv2.imwrite(str(partial), stored), Path(path).name, "end in .png, .jpg or another known format", path)
    return Path(path)
