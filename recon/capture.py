"""A recording: calibrated cameras, their pictures frame by frame, and what else was recorded with them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from recon.cameras import Camera
from recon.plush.reconstruction import NozzlePath
from recon.video import FrameSource
from sim.checks import as_array, require


@dataclass(frozen=True, kw_only=True, eq=False)
class Capture:
    """A recording whose pictures are read only when asked for.

    cameras: those that are calibrated; times (T,) [s]; sources: camera name -> its pictures, upright, T of them, also
    of cameras without calibration; mattes: camera name -> grey pictures, 255 on the object; plates: camera name -> the
    picture without the object; nozzle: by frame; missing: sentences, what is missing and what can still be done.
    Raises ValueError naming file and camera where a part has another size or number of frames.
    """

    cameras: tuple[Camera, ...]
    times: np.ndarray
    sources: Mapping[str, FrameSource]
    mattes: Mapping[str, FrameSource] = field(default_factory=dict)
    plates: Mapping[str, np.ndarray] = field(default_factory=dict)
    nozzle: NozzlePath | None = None
    missing: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", as_array("times", self.times, (None,)))
        object.__setattr__(self, "cameras", tuple(self.cameras))
        count = len(self.times)
        require(count > 0 and bool((np.diff(self.times) > 0).all()), "times", "increase", self.times[:5].tolist())
        names = [camera.name for camera in self.cameras]
        require(len(set(names)) == len(names), "cameras", "have different names", names)
        for camera in self.cameras:
            require(camera.name in self.sources, "cameras", "have pictures", camera.name)
            _same_size(camera.name, camera.size, self.sources[camera.name], "as calibrated")
        for source in (*self.sources.values(), *self.mattes.values()):
            require(source.count == count, source.label, f"have {count} frames as the others have", source.count)
        for name, matte in self.mattes.items():
            require(name in self.sources, matte.label, "belong to a camera of the recording", name)
            _same_size(name, self.sources[name].size, matte, "as the camera's pictures")
        for name, plate in self.plates.items():
            fits = name in self.sources and plate.shape[1::-1] == tuple(self.sources[name].size)
            require(fits, f"background plate of {name}", "be as large as the camera's pictures", plate.shape[1::-1])
        if self.nozzle is not None:
            require(len(self.nozzle.seen) == count, "nozzle", f"have {count} frames", len(self.nozzle.seen))

    @property
    def names(self) -> tuple[str, ...]:
        """All cameras that have pictures, calibrated or not."""
        return tuple(self.sources)

    def camera(self, name: str) -> Camera:
        """The calibrated camera of that name; raises ValueError when there is none."""
        found = [camera for camera in self.cameras if camera.name == name]
        require(len(found) == 1, "camera", f"be one of the {len(self.cameras)} calibrated ones", name)
        return found[0]

    def chosen(self, roles: Sequence[str], streams: Sequence[str]) -> tuple[Camera, ...]:
        """The calibrated cameras that have one of these roles and one of these streams."""
        return tuple(camera for camera in self.cameras if camera.role in roles and camera.stream in streams)

    def image(self, camera: str, frame: int) -> np.ndarray:
        """One picture, RGB (height, width, 3) or grey (height, width), uint8; whole films: `sources[camera].frames`."""
        require(camera in self.sources, "camera", f"be one of the recording's {len(self.sources)}", camera)
        return next(self.sources[camera].frames(frame, frame + 1))

    def matte(self, camera: str, frame: int) -> np.ndarray:
        """One matte (height, width) uint8, 255 on the object; raises ValueError when the camera has none."""
        require(camera in self.mattes, "camera", f"be one of the {len(self.mattes)} that have mattes", camera)
        return next(self.mattes[camera].frames(frame, frame + 1))


def _same_size(name: str, size: tuple[int, int], source: FrameSource, reason: str) -> None:
    rule = f"show {name} with {size[0]} x {size[1]} pixels {reason}"
    require(tuple(source.size) == tuple(size), source.label, rule, f"{source.size[0]} x {source.size[1]}")
