"""Packets from many cameras into files as they come, whatever happens to a camera or the disk meanwhile."""

import errno
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Protocol

from recon.oak.recording import Packet, StreamFiles, unbuffered

PAUSE = 0.002  # [s] where no camera had anything
TELL_EVERY = 0.5  # [s]
FIRST_WAIT, WAIT = 15.0, 5.0  # [s] of silence that a camera is given before its first packet, and later


class DeviceLost(Exception):
    """A device that does not answer any more; the text says why."""


class Source(Protocol):
    """One stream of a device that is running."""

    @property
    def name(self) -> str: ...  # cam0001.left
    @property
    def device(self) -> str: ...  # cam0001

    def take(self) -> list[Packet]:
        """All packets that have come since, in order; raises DeviceLost."""
        ...


@dataclass(frozen=True, kw_only=True)
class StreamStatus:
    """How one stream is doing: packets written, pictures that the sensor counted but never sent, the present rate."""

    name: str
    frames: int
    dropped: int
    fps: float  # [1/s], over the last second or so
    error: str = ""


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """What was recorded: seconds [s] with all cameras running; faults: a sentence for each thing that went wrong."""

    folder: Path
    seconds: float
    streams: tuple[StreamStatus, ...]
    faults: tuple[str, ...]


def record_streams(
    sources: Sequence[Source],
    folder: Path,
    *,
    fps: float,
    seconds: float | None = None,
    on_status: Callable[[tuple[StreamStatus, ...]], None] = lambda _: None,
    opened: Callable[[Path], BinaryIO] = unbuffered,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Recorded:
    """Write every packet as it comes until `seconds` [s] have passed with all cameras running, or Ctrl-C.

    A camera that is unplugged, or falls silent, ends its own streams only; a disk that is full ends the recording.
    Either way everything until then is kept in `folder`, and the result's faults say what happened.
    on_status gets the state of every stream twice a second; opened, clock and sleep are for tests.
    """
    loop = _Loop(clock=clock, on_status=on_status)
    with ExitStack() as stack:
        try:
            for source in sources:
                files = stack.enter_context(StreamFiles(folder, source.name, opened))
                loop.follow(source, files, round(fps))
            while loop.goes_on(seconds):
                if not loop.turn():
                    sleep(PAUSE)
        except KeyboardInterrupt:
            pass  # the person who records has seen enough
        except OSError as error:
            loop.faults.append(_disk_sentence(error, folder, loop.passed()))
    loop.tell()
    return Recorded(folder=folder, seconds=loop.passed(), streams=loop.statuses(), faults=tuple(loop.faults))


def _disk_sentence(error: OSError, folder: Path, seconds: float) -> str:
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    what = f"the disk of {folder} is full" if full else f"{folder} cannot be written ({error.strerror or error})"
    return f"{what}: the recording ended after {seconds:.1f} s, and everything until then is kept."


@dataclass(kw_only=True)
class _Track:
    """One stream while it is being recorded."""

    source: Source
    files: StreamFiles
    heard: float  # [s], when it last sent something
    recent: deque[int]  # times of the packets of about the last second [us]
    frames: int = 0
    dropped: int = 0
    sequence: int = -1
    fault: str = ""
    gone: bool = False
    silent: bool = False

    def status(self) -> StreamStatus:
        span = 1e-6 * (self.recent[-1] - self.recent[0]) if self.recent else 0.0
        fps = (len(self.recent) - 1) / span if span > 0 and not (self.gone or self.silent) else 0.0
        name = self.source.name
        return StreamStatus(name=name, frames=self.frames, dropped=self.dropped, fps=fps, error=self.fault)

    def write(self, packet: Packet, now: float) -> str:
        """Write a packet; returns what is wrong with it, or nothing."""
        self.files.append(packet)
        back = self.recent[-1] - packet.info.time_us if self.recent else -1
        if self.frames:
            self.dropped += max(0, packet.info.sequence - self.sequence - 1)
        self.recent.append(packet.info.time_us)
        self.sequence, self.heard, self.silent, self.frames = packet.info.sequence, now, False, self.frames + 1
        what = f"went back in time by {1e-3 * back:.3f} ms at picture {self.frames}; it is kept but cannot be paired"
        return what if back >= 0 else ""


class _Loop:
    """All streams while they are being recorded."""

    def __init__(self, clock: Callable[[], float], on_status: Callable[[tuple[StreamStatus, ...]], None]) -> None:
        self.tracks: list[_Track] = []
        self.faults: list[str] = []
        self._clock, self._on_status = clock, on_status
        self._complete: float | None = None  # [s], when every camera had sent something
        self._told = clock()

    def follow(self, source: Source, files: StreamFiles, recent: int) -> None:
        times: deque[int] = deque(maxlen=max(2, recent))
        self.tracks.append(_Track(source=source, files=files, heard=self._clock(), recent=times))

    def passed(self) -> float:
        """Time [s] since every camera was there."""
        return 0.0 if self._complete is None else self._clock() - self._complete

    def statuses(self) -> tuple[StreamStatus, ...]:
        return tuple(track.status() for track in self.tracks)

    def tell(self) -> None:
        self._told = self._clock()
        self._on_status(self.statuses())

    def goes_on(self, seconds: float | None) -> bool:
        if self._complete is None and all(t.frames or t.gone or t.silent for t in self.tracks):
            self._complete = self._clock()
        over = self._complete is not None and seconds is not None and self.passed() >= seconds
        return not over and not all(t.gone or t.silent for t in self.tracks)

    def turn(self) -> int:
        """Write what has come; returns the number of packets. Raises OSError where a file cannot be written."""
        count = 0
        for track in self.tracks:
            count += 0 if track.gone else self._take(track)
        if self._clock() - self._told >= TELL_EVERY:
            self.tell()
        return count

    def _take(self, track: _Track) -> int:
        try:
            packets = track.source.take()
        except DeviceLost as error:
            track.gone, track.fault = True, f"lost after {track.frames} pictures: {error}"
            device = f"{track.source.device} was lost ("
            if not any(fault.startswith(device) for fault in self.faults):
                self.faults.append(f"{device}{error}); what it sent until then is kept.")
            return 0
        now = self._clock()
        for packet in packets:
            if (wrong := track.write(packet, now)) and not track.fault:
                self._blame(track, wrong)
        wait = WAIT if track.frames else FIRST_WAIT
        if now - track.heard > wait and not track.silent:
            track.silent = True
            self._blame(track, f"has sent nothing for {wait:.0f} s; its {track.frames} pictures are kept")
        return len(packets)

    def _blame(self, track: _Track, what: str) -> None:
        track.fault = what
        self.faults.append(f"{track.source.name} {what}.")
