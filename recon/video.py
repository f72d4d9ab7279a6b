"""Videos in and out, one frame at a time."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Protocol

import av
import cv2
import numpy as np
from av.container import InputContainer
from av.video.reformatter import ColorRange, Colorspace
from av.video.stream import VideoStream

from recon.files import replacing
from sim.checks import require

KEY_FRAMES = 40  # frames between two places from which decoding can start
SMALLEST = 64  # [px], below its largest block x265 writes outside its buffers
# x265's thread pool can crash the process as a stream ends: its lookahead races (their issue 684, not mended in 4.2).
ONE_THREAD = "pools=none:frame-threads=1"
CODERS = {
    "hevc": {
        "preset": "veryfast",
        "x265-params": f"log-level=none:open-gop=0:bframes=0:keyint={KEY_FRAMES}:{ONE_THREAD}",
    },
    "h264": {"preset": "veryfast", "bf": "0", "g": str(KEY_FRAMES)},
}
LEVELS = np.arange(256)
TO_STUDIO = np.round(16 + LEVELS * 219 / 255).astype(np.uint8)  # black is stored as 16, white as 235
FROM_STUDIO = np.round((LEVELS - 16) * 255 / 219).clip(0, 255).astype(np.uint8)
LUMA_FIRST = ("yuv420p", "nv12", "yuvj420p", "gray")  # pixel formats whose first plane is the brightness


class FrameSource(Protocol):
    """Pictures of one camera in order: RGB (height, width, 3) or grey (height, width), uint8, upright."""

    @property
    def count(self) -> int: ...  # frames
    @property
    def size(self) -> tuple[int, int]: ...  # width, height [px]
    @property
    def fps(self) -> float: ...  # [1/s]
    @property
    def identity(self) -> str: ...  # changes when the pictures do
    @property
    def label(self) -> str: ...  # file and camera, for messages

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]: ...


@dataclass(frozen=True, eq=False)
class VideoFile:
    """A video, decoded frame by frame. turned: stored lying, delivered rotated by 90 degrees counter-clockwise.

    count is that of the frames that are there, not what the header promises. Raises ValueError, naming file and
    camera, for a file that is missing, no video, empty or truncated; damage inside it is found when it is decoded,
    as far as the decoder notices it.
    """

    path: Path
    turned: bool = False
    grey: bool = False
    camera: str = ""
    count: int = field(init=False)
    size: tuple[int, int] = field(init=False)  # width, height as delivered [px]
    fps: float = field(init=False)
    _stamps: np.ndarray = field(init=False, repr=False)  # of all frames, ascending; empty where the file has none

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", Path(self.path))
        with self._opened() as (container, stream):
            packets = [(p.pts, p.is_corrupt) for p in container.demux(stream) if p.size and not p.is_discard]
            size, rate = (stream.codec_context.width, stream.codec_context.height), stream.average_rate
            whole, promised = sum(not corrupt for _, corrupt in packets), max(len(packets), stream.frames)
        stamps = [stamp for stamp, _ in packets]
        require(promised > 0, self.label, "hold at least one frame", "an empty video")
        require(whole == promised, self.label, "be a complete video", f"{whole} whole frames of {promised}")
        known = None not in stamps and len(set(stamps)) == len(stamps)
        values = {"count": promised, "size": size[::-1] if self.turned else size, "fps": float(rate or 0.0)}
        for name, value in (values | {"_stamps": np.sort(stamps) if known else np.empty(0, int)}).items():
            object.__setattr__(self, name, value)

    @property
    def label(self) -> str:
        """File and camera, for messages."""
        return f"{self.path.name} ({self.camera})" if self.camera else self.path.name

    @property
    def identity(self) -> str:
        """Changes when the file does."""
        state = self.path.stat()
        return f"{self.path.resolve()} {state.st_size} {state.st_mtime_ns} {self.turned} {self.grey}"

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
        """Decode frames start to stop in order: (height, width, 3) RGB or (height, width) grey, uint8, upright.

        Raises ValueError for frames that the video does not have, and for a damaged one, naming file and camera.
        """
        stop = self.count if stop is None else stop
        fits = 0 <= start <= stop <= self.count
        require(fits, f"frames of {self.label}", f"be among its {self.count}", f"{start} to {stop}")
        if start < stop:
            yield from self._decoded(start, stop, seek=start > 0 and len(self._stamps) > 0)

    def _decoded(self, start: int, stop: int, seek: bool) -> Iterator[np.ndarray]:
        following = start
        with self._opened() as (container, stream):
            if seek:
                container.seek(int(self._stamps[start]), stream=stream)
            for number, frame in enumerate(container.decode(stream)):
                index = int(np.searchsorted(self._stamps, frame.pts)) if len(self._stamps) else number
                if seek and number == 0 and index > start:
                    break  # frames before an open group's first one cannot be decoded from it
                if index >= stop:
                    return
                if index >= start:
                    whole = index == following and not frame.is_corrupt
                    require(whole, self.label, "be a complete video", f"no frame {following}")
                    following += 1
                    yield self._upright(frame)
        if seek and following == start:
            yield from self._decoded(start, stop, seek=False)
            return
        require(following == stop, self.label, "be a complete video", f"no frame {following}")

    def _upright(self, frame: av.VideoFrame) -> np.ndarray:
        image = _luma(frame) if self.grey else frame.to_ndarray(format="rgb24")
        return cv2.rotate(image, cv2.ROTATE_90_COUNTERCLOCKWISE) if self.turned else image

    @contextmanager
    def _opened(self) -> Iterator[tuple[InputContainer, VideoStream]]:
        """The file and its first video stream; whatever is wrong with it becomes one ValueError."""
        try:
            with av.open(str(self.path)) as container:
                require(len(container.streams.video) > 0, self.label, "hold a video", "none")
                stream = container.streams.video[0]
                stream.thread_type = "AUTO"
                yield container, stream
        except av.FFmpegError as error:
            raise ValueError(f"{self.label} must be a complete video; got {error.strerror}") from None


def write_video(
    path: str | Path,
    frames: Iterable[np.ndarray],
    fps: float,
    *,
    turned: bool = False,
    grey: bool = False,
    codec: str = "hevc",
    crf: int = 18,
) -> Path:
    """Encode frames, RGB (height, width, 3) or grey (height, width) uint8, as they come; whole or not at all.

    fps [1/s]. turned: store them rotated by 90 degrees clockwise, as PLUSH does. codec: hevc or h264; crf: 0
    (lossless) to 51. Raises ValueError for no frame, an odd size, frames that differ in size, or another codec.
    """
    path, frames = Path(path), iter(frames)
    require(codec in CODERS, "codec", f"be one of {', '.join(CODERS)}", codec)
    require(bool(np.isfinite(fps) and fps > 0), "fps", "be positive", fps)
    first = next(frames, None)
    require(first is not None, path.name, "be given at least one frame", 0)
    shape = _checked(path.name, first, np.shape(first), grey).shape
    rate = Fraction(fps).limit_denominator(100_000)
    with replacing(path) as partial, av.open(str(partial), "w") as container:
        stream = _stream(container, codec, crf, rate, shape[:2] if turned else shape[1::-1])
        for number, image in enumerate(chain([first], frames)):
            image = _checked(path.name, image, shape, grey)
            image = cv2.rotate(image, cv2.ROTATE_90_CLOCKWISE) if turned else np.ascontiguousarray(image)
            picture = _grey_picture(image) if grey else _colour_picture(image)
            picture.pts, picture.time_base = number, 1 / rate
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return path


def _stream(container, codec: str, crf: int, rate: Fraction, size: tuple[int, int]) -> VideoStream:
    stream = container.add_stream(codec, rate=rate)
    stream.options = CODERS[codec] | {"crf": str(crf)}
    stream.width, stream.height, stream.pix_fmt = int(size[0]), int(size[1]), "yuv420p"
    context = stream.codec_context
    context.codec_tag = {"hevc": "hvc1", "h264": "avc1"}[codec]
    context.colorspace = context.color_primaries = context.color_trc = int(Colorspace.ITU709)
    context.color_range = ColorRange.MPEG
    return stream


def _colour_picture(image: np.ndarray) -> av.VideoFrame:
    picture = av.VideoFrame.from_ndarray(image, format="rgb24")
    return picture.reformat(format="yuv420p", dst_colorspace=Colorspace.ITU709)


def _grey_picture(image: np.ndarray) -> av.VideoFrame:
    neutral = np.full((image.shape[0] // 2, image.shape[1]), 128, np.uint8)
    return av.VideoFrame.from_ndarray(np.concatenate([TO_STUDIO[image], neutral]), format="yuv420p")


def _luma(frame: av.VideoFrame) -> np.ndarray:
    """Grey (height, width) from 0 to 255. The scaler's own conversion is up to three levels too dark."""
    if frame.format.name not in LUMA_FIRST:
        return frame.to_ndarray(format="gray")
    plane = frame.planes[0]
    stored = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[: frame.height, : frame.width]
    full = frame.color_range == ColorRange.JPEG or frame.format.name in ("gray", "yuvj420p")
    return stored.copy() if full else FROM_STUDIO[stored]


def _checked(name: str, image: np.ndarray, shape: tuple[int, ...], grey: bool) -> np.ndarray:
    """An image of the given shape that can be encoded: colour at half resolution needs even sizes."""
    image = np.asarray(image)
    fits = image.dtype == np.uint8 and image.ndim == (2 if grey else 3) and (grey or image.shape[2] == 3)
    kind = "(height, width)" if grey else "(height, width, 3)"
    require(fits, f"{name} frames", f"be uint8 {kind}", f"{image.dtype} {image.shape}")
    require(image.shape == shape, f"{name} frames", f"all have shape {shape}", image.shape)
    width, height = image.shape[1::-1]
    fits = min(width, height) >= SMALLEST and width % 2 == height % 2 == 0
    require(fits, f"{name} size", f"be even and at least {SMALLEST} pixels", f"{width} x {height}")
    return image
