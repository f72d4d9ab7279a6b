"""What a synthetic recording shall be like, and what shall be wrong with it."""

import dataclasses
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from recon.rig.motion import SHAPES
from sim.checks import require

FEWEST, MOST = 4, 19
SMALLEST, LARGEST = 88, 2160  # [px]; the coder needs 64, also for the grey pictures
WORDS = "nozzle-deg=8, nozzle-mm=5, missing=cam0003, late=cam0002:3, dropped=cam0004:2, scale=1.1 or inertia"
CAMERA = re.compile(r"cam\d{4}")


@dataclass(frozen=True, kw_only=True)
class RigFaults:
    """What is wrong with a recording; the default is nothing. `truth/` stays true.

    Cameras are devices, such as cam0003, with all three of their streams.
    """

    nozzle_deg: float = 0.0  # the marker's written pose is turned so much about its own x: the stream points too low
    nozzle_mm: float = 0.0  # and moved so far along its own x, sideways
    missing: tuple[str, ...] = ()  # calibrated, but there are no videos
    late: tuple[tuple[str, int], ...] = ()  # shows what was to be seen so many frames before; the first frame repeats
    dropped: tuple[tuple[str, int], ...] = ()  # so many frames are lost, the video is shorter
    scale: float = 1.0  # all lengths in calibration.json and aruco_path.json are so many times the true ones
    inertia: bool = False  # the body has mass and rings instead of following the loads

    @property
    def named(self) -> tuple[str, ...]:
        """Every camera that has a fault."""
        return (*self.missing, *(name for name, _ in (*self.late, *self.dropped)))


@dataclass(frozen=True, kw_only=True)
class RigOptions:
    """shape: plush, dinosaur, pillow or leaf. cameras: devices, the last three of which watch the nozzle.

    size: width of the upright colour pictures [px], 1080 for the full rig; all other sizes follow from it. greys: the
    left and right streams too. noise: standard deviation of a grey level of 255. drift: largest relative change of a
    camera's exposure. reconstruction: also write `reconstruction/`, from the truth, with so many points (0: none).
    seed: of lenses, noise and drift. Raises ValueError for what no rig can be.
    """

    shape: str = "plush"
    cameras: int = 19
    frames: int = 48
    size: int = 1080
    greys: bool = True
    noise: float = 2.0
    drift: float = 0.02
    reconstruction: int = 0
    seed: int = 0
    faults: RigFaults = field(default_factory=RigFaults)

    def __post_init__(self) -> None:
        require(self.shape in SHAPES, "shape", f"be one of {', '.join(SHAPES)}", self.shape)
        require(FEWEST <= self.cameras <= MOST, "cameras", f"be {FEWEST} to {MOST}", self.cameras)
        require(self.frames >= 2, "frames", "be at least 2", self.frames)
        require(SMALLEST <= self.size <= LARGEST, "size", f"be {SMALLEST} to {LARGEST} pixels", self.size)
        require(0 <= self.noise < 100, "noise", "be 0 to 100 grey levels", self.noise)
        require(0 <= self.drift < 0.5, "drift", "be at least 0 and less than 0.5", self.drift)
        require(self.reconstruction >= 0, "reconstruction", "not be negative", self.reconstruction)
        faults = self.faults
        names = [f"cam{i + 1:04d}" for i in range(self.cameras)]
        for name in faults.named:
            require(name in names, "fault", f"name one of the {self.cameras} cameras, cam0001 to {names[-1]}", name)
        require(len(faults.missing) < self.cameras, "fault missing", "leave a camera", len(faults.missing))
        for kind, few in (("late", faults.late), ("dropped", faults.dropped)):
            for name, count in few:
                require(0 < count < self.frames, f"fault {kind}", "be fewer frames than there are", f"{name}:{count}")
        for name, value in (("nozzle_deg", faults.nozzle_deg), ("nozzle_mm", faults.nozzle_mm)):
            require(math.isfinite(value), f"fault {name}", "be a number", value)
        require(0.1 <= faults.scale <= 10, "fault scale", "be 0.1 to 10", faults.scale)


def parse_faults(words: Sequence[str]) -> RigFaults:
    """Faults from words, such as those of `WORDS`; raises ValueError for any other word."""
    given: dict[str, object] = {}
    for word in words:
        kind, _, value = word.partition("=")
        key = kind.replace("-", "_")
        if key in ("nozzle_deg", "nozzle_mm", "scale"):
            given[key] = _number(word, value)
        elif key == "inertia" and not value:
            given[key] = True
        elif key == "missing" and CAMERA.fullmatch(value):
            given[key] = (*given.get(key, ()), value)
        else:
            name, _, count = value.partition(":")
            known = key in ("late", "dropped") and CAMERA.fullmatch(name) and count.isdigit()
            require(bool(known), "fault", f"be like {WORDS}", repr(word))
            given[key] = (*given.get(key, ()), (name, int(count)))
    return RigFaults(**given)


def plain(options: RigOptions) -> dict[str, object]:
    """The options as plain values, for a file and for comparing."""
    out = dataclasses.asdict(options)
    out["faults"] = {key: [list(v) if isinstance(v, tuple) else v for v in value] if isinstance(value, tuple) else value
                     for key, value in out["faults"].items()}  # fmt: skip
    return out


def _number(word: str, value: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise ValueError(f"fault must have a number after =; got {word!r}") from None
