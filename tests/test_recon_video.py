"""Videos through real H.265 files: order, orientation, grey levels, jumps, and every kind of damaged file."""

import av
import numpy as np
import pytest

from recon.images import ImageFiles, Pictures, read_image, write_image
from recon.video import ONE_THREAD, VideoFile, write_video

COUNT, HEIGHT, WIDTH = 90, 64, 80


def pictures(count: int = COUNT, grey: bool = False) -> np.ndarray:
    """Smooth pictures whose mean tells their number: 2 levels a frame, brighter to the right and below."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    base = 10 + 0.3 * columns + 0.2 * rows
    stack = base + 2 * np.arange(count)[:, None, None]
    channels = [stack, stack[:, ::-1], 0.5 * stack]
    return (stack if grey else np.stack(channels, axis=-1)).astype(np.uint8)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("grey", [False, True])
def test_frames_come_back_in_order_and_upright(tmp_path, turned, grey):
    sent = pictures(grey=grey)
    path = write_video(tmp_path / "a.mp4", iter(sent), 40.0, turned=turned, grey=grey)
    video = VideoFile(path, turned=turned, grey=grey)
    assert (video.count, video.size, video.fps) == (COUNT, (WIDTH, HEIGHT), 40.0)
    got = np.stack(list(video.frames()))
    assert got.shape == sent.shape and got.dtype == np.uint8
    off = np.abs(got.astype(int) - sent)
    assert off.mean() < (0.7 if grey else 2.0) and off.max(axis=(1, 2)).max() < 16  # colour has half the pixels
    numbers = got.reshape(COUNT, -1).mean(axis=1)
    assert (np.diff(numbers) > 0).all()
    assert list(tmp_path.iterdir()) == [path]


def test_turned_video_is_stored_lying_clockwise(tmp_path):
    sent = np.zeros((4, HEIGHT, WIDTH), np.uint8)
    sent[:, :16, :24] = 200  # upper left corner: after a clockwise turn it is the upper right one
    write_video(tmp_path / "a.mp4", sent, 40.0, turned=True, grey=True)
    lying = VideoFile(tmp_path / "a.mp4", grey=True)
    assert lying.size == (HEIGHT, WIDTH)
    bright = next(lying.frames()) > 100
    assert bright[:24, -16:].mean() > 0.95 and bright[:, : HEIGHT - 18].mean() == 0


def test_grey_levels_keep_their_brightness(tmp_path):
    levels = np.repeat(np.arange(0, 256, 5), 8)[None, :].repeat(64, axis=0).astype(np.uint8)
    write_video(tmp_path / "a.mp4", [levels] * 2, 25.0, grey=True, crf=1)
    off = next(VideoFile(tmp_path / "a.mp4", grey=True).frames()).astype(int) - levels
    assert abs(off.mean()) < 0.2 and np.abs(off).max() <= 2


def foreign(path, sent: np.ndarray) -> None:
    """An H.265 file as another program writes it: frames out of order, groups that borrow from the one before."""
    with av.open(str(path), "w") as container:
        params = f"log-level=none:open-gop=1:bframes=4:keyint=20:min-keyint=20:{ONE_THREAD}"
        options = {"crf": "12", "x265-params": params}
        stream = container.add_stream("hevc", rate=30, options=options)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for image in sent:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())


@pytest.mark.parametrize("writer", ["ours", "foreign"])
def test_a_jump_gives_the_same_pictures_as_the_whole_film(tmp_path, writer):
    sent = pictures()
    if writer == "ours":
        write_video(tmp_path / "a.mp4", sent, 30.0)
    else:
        foreign(tmp_path / "a.mp4", sent)
    video = VideoFile(tmp_path / "a.mp4")
    whole = np.stack(list(video.frames()))
    assert len(whole) == COUNT
    for start, stop in [(0, 2), (1, 3), (17, 19), (18, 23), (20, 21), (38, 42), (79, 90), (89, 90)]:
        part = np.stack(list(video.frames(start, stop)))
        np.testing.assert_array_equal(part, whole[start:stop], err_msg=f"{start} to {stop}")
    assert list(video.frames(7, 7)) == []
    with pytest.raises(ValueError, match=r"frames of a\.mp4 must be among its 90; got 89 to 91"):
        next(video.frames(89, 91))


def test_a_truncated_video_is_one_sentence_naming_file_and_camera(tmp_path):
    whole = write_video(tmp_path / "whole.mp4", pictures(30), 40.0).read_bytes()
    path = tmp_path / "cam0003.aligned.mp4"
    for share in (0.0, 0.01, 0.5, 0.8):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(ValueError, match=r"^cam0003\.aligned\.mp4 \(cam0003\) must be a complete video; got "):
            VideoFile(path, camera="cam0003")
    path.write_text("no video at all")
    with pytest.raises(ValueError, match=r"cam0003\.aligned\.mp4 \(cam0003\) must be a complete video"):
        VideoFile(path, camera="cam0003")
    with pytest.raises(ValueError, match=r"none\.mp4 must be a complete video; got No such file"):
        VideoFile(tmp_path / "none.mp4")


def test_frames_cut_off_behind_an_intact_header_are_counted(tmp_path):
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w", options={"movflags": "faststart"}) as container:
        options = {"x265-params": f"log-level=none:bframes=0:{ONE_THREAD}"}
        stream = container.add_stream("hevc", rate=40, options=options)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        noise = np.random.default_rng(0).integers(0, 255, (30, HEIGHT, WIDTH, 3), dtype=np.uint8)
        for image in noise:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    assert VideoFile(path).count == 30
    whole = path.read_bytes()
    path.write_bytes(whole[: int(0.6 * len(whole))])
    with pytest.raises(ValueError, match=r"a\.mp4 \(cam1\) must be a complete video; got \d+ whole frames of 30"):
        VideoFile(path, camera="cam1")
    holed = bytearray(whole)
    holed[len(whole) // 2 : len(whole) // 2 + 4000] = bytes(4000)
    path.write_bytes(holed)
    video = VideoFile(path, camera="cam1")
    assert next(video.frames()).shape == (HEIGHT, WIDTH, 3)
    with pytest.raises(ValueError, match=r"a\.mp4 \(cam1\) must be a complete video"):
        list(video.frames())


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path):
    path = write_video(tmp_path / "a.mp4", pictures(5), 40.0)
    before = path.read_bytes()

    def breaking():
        yield from pictures(3)
        raise RuntimeError("the simulator stopped")

    with pytest.raises(RuntimeError, match="the simulator stopped"):
        write_video(path, breaking(), 40.0)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


BAD = {
    "none": ([], {}, "must be given at least one frame; got 0"),
    "floats": ([np.zeros((8, 8, 3))], {}, r"must be uint8 \(height, width, 3\); got float64 \(8, 8, 3\)"),
    "grey for colour": ([np.zeros((8, 8), np.uint8)], {}, r"must be uint8 \(height, width, 3\)"),
    "odd": ([np.zeros((64, 65, 3), np.uint8)], {}, "size must be even and at least 64 pixels; got 65 x 64"),
    "tiny": ([np.zeros((64, 62, 3), np.uint8)], {}, "size must be even and at least 64 pixels; got 62 x 64"),
    "unequal": ([np.zeros((64, 64, 3), np.uint8), np.zeros((64, 66, 3), np.uint8)], {}, r"must all have shape \(64"),
    "codec": ([np.zeros((64, 64, 3), np.uint8)], {"codec": "gif"}, "codec must be one of hevc, h264; got gif"),
}


@pytest.mark.parametrize("case", BAD)
def test_frames_that_cannot_be_written_are_one_sentence(tmp_path, case):
    frames, options, words = BAD[case]
    with pytest.raises(ValueError, match=words):
        write_video(tmp_path / "a.mp4", frames, 40.0, **options)
    assert list(tmp_path.iterdir()) == []


def test_image_files_and_arrays_behave_like_a_video(tmp_path):
    sent = pictures(5)
    files = [write_image(tmp_path / f"{i:03d}.png", image) for i, image in enumerate(sent)]
    for source in (ImageFiles(files, camera="cam1"), Pictures(sent, "cam1")):
        assert (source.count, source.size) == (5, (WIDTH, HEIGHT))
        np.testing.assert_array_equal(np.stack(list(source.frames(1, 4))), sent[1:4])
    before = ImageFiles(files).identity
    write_image(files[2], sent[2][:, ::-1])
    assert ImageFiles(files).identity != before
    write_image(files[3], sent[3][:20])
    files[4].write_text("x")
    with pytest.raises(ValueError, match=r"003\.png \(cam1\) must be 80 x 64 pixels as the first; got \(80, 20\)"):
        list(ImageFiles(files, camera="cam1").frames())
    with pytest.raises(ValueError, match=r"004\.png must be a readable picture"):
        read_image(files[4])
