"""A recording as it comes from the cameras: encoded packets and their times, in files that survive a crash."""

from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import BinaryIO

import numpy as np

from sim.checks import require

PLACE = "recording"  # the folder, beside the layout's capture/
RAW, TIMES = ".hevc", ".times.csv"
_PARAMETERS = 32  # the first of HEVC's kinds of units that hold no picture
_INTRA = range(16, 24)  # those from which decoding can start


@dataclass(frozen=True, kw_only=True)
class PacketInfo:
    """What is known of one encoded picture: one line of the times file.

    time_us: on the host's clock, to which all devices are synchronised; device_time_us: on the device's own [us].
    sequence: the sensor's count, in which a gap is a picture that was never encoded. iso 0: not known.
    """

    time_us: int
    device_time_us: int
    sequence: int
    bytes: int
    keyframe: int
    exposure_us: int = 0
    iso: int = 0


COLUMNS = tuple(f.name for f in fields(PacketInfo))


@dataclass(frozen=True, kw_only=True)
class Packet:
    """One encoded picture of one stream."""

    data: bytes
    info: PacketInfo


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedStream:
    """What the files of one stream hold, from the first keyframe on; all arrays by picture, in order.

    number (F,): its place in the times file, from 0 on; time (F,) [s] on the host's clock; dropped: pictures that the
    sensor counted and that never came; damaged: those that came and cannot be decoded, once that was tried.
    """

    name: str
    folder: Path
    number: np.ndarray  # (F,)
    time: np.ndarray  # (F,) [s]
    offset: np.ndarray  # (F,) [bytes]
    size: np.ndarray  # (F,) [bytes]
    keyframe: np.ndarray  # (F,) bool
    dropped: int
    damaged: int = 0

    @property
    def raw(self) -> Path:
        """The packets one after another: an H.265 elementary stream."""
        return self.folder / (self.name + RAW)


def packet_of(data: bytes, *, time_us: int, device_time_us: int = 0, sequence: int, exposure_us: int = 0,
              iso: int = 0) -> Packet:  # fmt: skip
    """A packet with its facts; whether decoding can start at it is read from the H.265 bytes themselves."""
    info = PacketInfo(
        time_us=time_us, device_time_us=device_time_us, sequence=sequence, bytes=len(data),
        keyframe=int(_starts_decoding(data)), exposure_us=exposure_us, iso=iso,
    )  # fmt: skip
    return Packet(data=data, info=info)


def _starts_decoding(data: bytes) -> bool:
    """True when the first picture unit of an Annex B packet is an intra random access picture (H.265, table 7-1)."""
    at = data.find(b"\0\0\1")
    while 0 <= at < len(data) - 3:
        kind = data[at + 3] >> 1 & 63
        if kind < _PARAMETERS:
            return kind in _INTRA
        at = data.find(b"\0\0\1", at + 3)
    return False


def unbuffered(path: Path) -> BinaryIO:
    """A new file whose every write is in the system's hands at once: a killed process loses none of it."""
    return path.open("xb", buffering=0)


class StreamFiles:
    """The two files of one stream, open for writing: NAME.hevc and NAME.times.csv. `with` closes them."""

    def __init__(self, folder: Path, name: str, opened: Callable[[Path], BinaryIO] = unbuffered) -> None:
        self._length = 0
        with ExitStack() as stack:
            self._packets, self._times = (_closed_by(stack, opened(folder / n)) for n in (name + RAW, name + TIMES))
            _write_all(self._times, (",".join(COLUMNS) + "\n").encode())
            self._stack = stack.pop_all()

    def append(self, packet: Packet) -> None:
        """Write one packet, then its line: a packet without a line does not count. Raises OSError, as a full disk."""
        try:
            _write_all(self._packets, packet.data)
        except OSError:
            with suppress(OSError):  # the reader ignores a rest that has no line
                self._packets.truncate(self._length)
            raise
        self._length += len(packet.data)
        _write_all(self._times, (",".join(map(str, astuple(packet.info))) + "\n").encode())

    def __enter__(self) -> "StreamFiles":
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def _closed_by(stack: ExitStack, file: BinaryIO) -> BinaryIO:
    stack.callback(_close, file)
    return file


def _close(file: BinaryIO) -> None:
    with suppress(OSError):  # what could be written is written: the files have no buffer
        file.close()


def _write_all(file: BinaryIO, data: bytes) -> None:
    left = memoryview(data)
    while left:
        left = left[file.write(left) :]


def read_stream(folder: str | Path, name: str) -> RecordedStream:
    """Read what a stream's files hold, whatever ended the recording: a rest that was cut off does not count.

    Raises ValueError naming the stream when a file is missing, a line of times is damaged, or no keyframe came.
    """
    folder = Path(folder)
    path, raw = folder / (name + TIMES), folder / (name + RAW)
    for file in (path, raw):
        require(file.exists(), name, "have been recorded", f"no {file.name}")
    table = _table(path)
    ends = np.cumsum(table[:, COLUMNS.index("bytes")])
    table = table[ends <= raw.stat().st_size]
    keys = table[:, COLUMNS.index("keyframe")] > 0
    require(bool(keys.any()), name, "hold a keyframe", f"{len(table)} pictures without one")
    first = int(keys.argmax())
    time, sequence, size = (table[first:, COLUMNS.index(c)] for c in ("time_us", "sequence", "bytes"))
    return RecordedStream(
        name=name,
        folder=folder,
        number=np.arange(first, len(table)),
        time=1e-6 * time,
        offset=(ends[: len(table)] - table[:, COLUMNS.index("bytes")])[first:],
        size=size,
        keyframe=keys[first:],
        dropped=max(0, int(sequence[-1] - sequence[0]) + 1 - len(sequence)),
    )


def _table(path: Path) -> np.ndarray:
    """All whole lines as (F, columns) integers."""
    lines = path.read_text(encoding="ascii", errors="replace").splitlines(keepends=True)
    whole = [line.rstrip("\n").split(",") for line in lines if line.endswith("\n")]
    require(bool(whole) and tuple(whole[0]) == COLUMNS, path.name, f"start with {','.join(COLUMNS)}", lines[:1])
    for number, cells in enumerate(whole[1:], 2):
        fits = len(cells) == len(COLUMNS) and all(c.isdigit() and len(c) < 19 for c in cells)
        require(fits, f"{path.name} line {number}", f"hold {len(COLUMNS)} whole numbers", repr(",".join(cells)))
    return np.array([[int(c) for c in cells] for cells in whole[1:]], dtype=np.int64).reshape(-1, len(COLUMNS))
