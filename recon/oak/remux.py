"""Recorded packets made into a video: which of them can be decoded, and a container around those, unchanged."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from fractions import Fraction
from itertools import chain
from pathlib import Path

import av
import numpy as np

from recon.oak.recording import RecordedStream
from sim.checks import require

CLOCK = 90_000  # ticks a second


def decodable(stream: RecordedStream) -> RecordedStream:
    """The stream without the pictures that cannot be decoded: all from a packet that is missing to the next keyframe.

    Raises ValueError where that is all of them.
    """
    decoder, good = av.CodecContext.create("hevc", "r"), np.zeros(len(stream.time), bool)
    decoder.thread_type = "AUTO"
    for number, data in chain(enumerate(_packets(stream)), [(0, b"")]):  # an empty one asks for what is held back
        with suppress(av.InvalidDataError):
            for frame in decoder.decode(owned_packet(data, number)):
                good[frame.pts] |= not frame.is_corrupt
    require(bool(good.any()), stream.name, "hold a picture that can be decoded", f"{len(good)} damaged ones")
    parts = {name: getattr(stream, name)[good] for name in ("number", "time", "offset", "size", "keyframe")}
    return replace(stream, **parts, damaged=int((~good).sum()))


def owned_packet(data: bytes, number: int) -> av.Packet | None:
    """A packet with this time stamp in a buffer of FFmpeg's own; None, which asks for what is held back, for no data.

    avcodec_send_packet reads up to 64 bytes past the end, and from other threads: PyAV's packet around Python's bytes
    has no such room, and the process may crash.
    """
    if not data:
        return None
    packet = av.Packet(len(data))
    packet.update(data)
    packet.pts = packet.dts = number
    return packet


@contextmanager
def contained(stream: RecordedStream) -> Iterator[Path]:
    """The stream's packets, as they are, in an mp4 with their true times, for as long as the block lasts.

    Raises ValueError when they are no H.265 stream, and OSError where the mp4 cannot be written, as a full disk.
    """
    path = stream.folder / f".{stream.name}.mp4"
    try:
        _mux(stream, path)
        yield path
    finally:
        path.unlink(missing_ok=True)


def _mux(stream: RecordedStream, path: Path) -> None:
    ticks = np.round((stream.time - stream.time[0]) * CLOCK).astype(int)
    try:
        with av.open(str(stream.raw), format="hevc") as source, av.open(str(path), "w") as container:
            track = container.add_stream_from_template(source.streams.video[0])
            for tick, key, data in zip(ticks.tolist(), stream.keyframe.tolist(), _packets(stream), strict=True):
                packet = owned_packet(data, tick)
                packet.time_base, packet.is_keyframe, packet.stream = Fraction(1, CLOCK), key, track
                container.mux(packet)
    except av.FFmpegError as error:
        if isinstance(error, OSError):
            raise
        raise ValueError(f"{stream.raw.name} must be an H.265 stream; got {error.strerror}") from None


def _packets(stream: RecordedStream) -> Iterator[bytes]:
    with stream.raw.open("rb") as file:
        for offset, size in zip(stream.offset.tolist(), stream.size.tolist(), strict=True):
            file.seek(offset)
            yield file.read(size)
