"""What reaches the files, whatever happens to the cameras, the disk or the process meanwhile."""

import errno
import signal
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from oak_fakes import COLOUR, clip, steady

from recon.oak.recorder import FIRST_WAIT, WAIT, DeviceLost, record_streams
from recon.oak.recording import StreamFiles, packet_of, read_stream
from recon.oak.remux import decodable

COUNT = 16


@dataclass
class Replay:
    """A stream that gives one packet a call, then nothing, or is lost."""

    name: str
    packets: list
    lost: str = ""

    @property
    def device(self):
        return self.name.split(".")[0]

    def take(self):
        if not self.packets and self.lost:
            raise DeviceLost(self.lost)
        return [self.packets.pop(0)] if self.packets else []


@dataclass
class Clock:
    """Time that passes while one sleeps."""

    now: float = 0.0

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        self.now += 50 * seconds


@dataclass
class Disk:
    """Files on a disk that is full after `left` bytes."""

    left: int
    files: list = field(default_factory=list)

    def opened(self, path: Path):
        disk, file = self, path.open("xb", buffering=0)
        self.files.append(file)

        class Limited:
            truncate, close = file.truncate, file.close

            def write(self, data):
                room = min(disk.left, len(data))
                if not room:
                    raise OSError(errno.ENOSPC, "No space left on device")
                disk.left -= room
                return file.write(bytes(data[:room]))

        return Limited()


def packets(times=None, sequence=None):
    times = times or steady(COUNT)
    given = zip(clip(COLOUR, len(times)), times, sequence or range(len(times)), strict=True)
    return [packet_of(data, time_us=time, sequence=number) for data, time, number in given]


def record(folder, *sources, seconds=1.0, **options):
    clock = Clock()
    return record_streams(sources, folder, fps=40, seconds=seconds, clock=clock, sleep=clock.sleep, **options)


def test_every_packet_and_its_time_is_on_the_disk_as_it_came(tmp_path):
    said = []
    done = record(tmp_path, Replay("cam0001", packets()), on_status=said.append)
    assert (tmp_path / "cam0001.hevc").read_bytes() == b"".join(clip(COLOUR, COUNT))
    stream = read_stream(tmp_path, "cam0001")
    np.testing.assert_allclose(stream.time, 10 + np.arange(COUNT) / 40, atol=1e-9)
    np.testing.assert_array_equal(np.flatnonzero(stream.keyframe), [0, 8])
    assert decodable(stream).damaged == 0 and stream.dropped == 0
    assert done.faults == () and done.seconds == pytest.approx(1.0, abs=0.11)
    assert said[-1] == done.streams and (done.streams[0].frames, done.streams[0].dropped) == (COUNT, 0)
    assert done.streams[0].fps == pytest.approx(40) and done.streams[0].name == "cam0001"


def test_unplugged_camera_ends_alone_and_keeps_what_it_sent(tmp_path):
    lost = Replay("cam0002", packets()[:5], lost="X_LINK_ERROR")
    also = Replay("cam0002.left", packets()[:6], lost="X_LINK_ERROR")
    done = record(tmp_path, Replay("cam0001", packets()), lost, also)
    assert done.faults == ("cam0002 was lost (X_LINK_ERROR); what it sent until then is kept.",)
    assert [len(read_stream(tmp_path, n).time) for n in ("cam0001", "cam0002", "cam0002.left")] == [COUNT, 5, 6]
    assert done.streams[1].error == "lost after 5 pictures: X_LINK_ERROR" and done.streams[1].fps == 0


def test_recording_ends_when_all_cameras_are_gone(tmp_path):
    done = record(tmp_path, Replay("cam0001", packets()[:5], lost="unplugged"), seconds=None)
    assert done.streams[0].frames == 5 and len(done.faults) == 1


@dataclass
class Endless:
    """A stream that has a packet at every other call."""

    name: str = "cam0001"
    device: str = "cam0001"
    calls: int = 0

    def take(self):
        self.calls += 1
        return [packet_of(b"", time_us=25_000 * self.calls, sequence=self.calls // 2)] if self.calls % 2 else []


def test_silent_cameras_are_named_and_the_others_go_on(tmp_path):
    mute, stalled = Replay("cam0002", []), Replay("cam0003", packets()[:3])
    done = record(tmp_path, Endless(), mute, stalled, seconds=1.0)
    assert done.faults == (
        f"cam0003 has sent nothing for {WAIT:.0f} s; its 3 pictures are kept.",
        f"cam0002 has sent nothing for {FIRST_WAIT:.0f} s; its 0 pictures are kept.",
    )
    assert done.seconds == pytest.approx(1.0, abs=0.11) and done.streams[0].error == ""
    assert done.streams[0].frames > 100 and done.streams[2].frames == 3


def test_gaps_are_counted_and_times_that_go_backwards_are_kept_and_named(tmp_path):
    times = steady(COUNT)
    times[9] = times[8] - 2_000
    numbers = [n + 3 * (n > 4) for n in range(COUNT)]
    done = record(tmp_path, Replay("cam0001", packets(times, numbers)))
    assert done.streams[0].dropped == 3 and read_stream(tmp_path, "cam0001").dropped == 3
    assert done.faults == ("cam0001 went back in time by 2.000 ms at picture 10; it is kept but cannot be paired.",)
    assert len(read_stream(tmp_path, "cam0001").time) == COUNT


@pytest.mark.parametrize("left", range(2600, 8200, 337))
def test_full_disk_keeps_every_packet_that_was_counted(tmp_path, left):
    """Wherever the last byte falls, in a packet or in a line of times: what counts can be read and decoded."""
    disk = Disk(left)
    done = record(tmp_path, Replay("cam0001", packets()), Replay("cam0002", packets()), opened=disk.opened)
    assert len(done.faults) == 1 and "is full: the recording ended after" in done.faults[0]
    for status in done.streams:
        if status.frames:
            stream = decodable(read_stream(tmp_path, status.name))
            assert len(stream.time) == status.frames and stream.damaged == 0
    assert all(file.closed for file in disk.files)


def test_disk_that_is_full_from_the_start_and_other_faults_of_files_are_one_sentence(tmp_path):
    (sentence,) = record(tmp_path, Replay("cam0001", packets()), opened=Disk(0).opened).faults
    assert sentence.startswith(f"the disk of {tmp_path} is full: the recording ended after 0.0 s, and everything ")
    (sentence,) = record(tmp_path / "absent", Replay("cam0001", packets())).faults
    assert "absent cannot be written (No such file or directory): the recording ended" in sentence


KILLED = """
import itertools, os, signal, sys
from pathlib import Path
from recon.oak.recorder import record_streams
from recon.oak.recording import packet_of

class Endless:
    name = device = "cam0001"
    sent = 0
    def take(self):
        if self.sent == 40:
            os.kill(os.getpid(), signal.SIGKILL)
        self.sent += 1
        data = b"\\0\\0\\1\\x26" + bytes([self.sent]) * 1000
        return [packet_of(data, time_us=25_000 * self.sent, sequence=self.sent)]

record_streams([Endless()], Path(sys.argv[1]), fps=40)
"""


def test_killed_process_loses_nothing_that_it_wrote(tmp_path):
    ended = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False, timeout=120)
    assert ended.returncode == -signal.SIGKILL
    stream = read_stream(tmp_path, "cam0001")
    assert len(stream.time) == 40
    held = (tmp_path / "cam0001.hevc").read_bytes()
    last = held[stream.offset[-1] : stream.offset[-1] + stream.size[-1]]
    assert last == b"\0\0\1\x26" + bytes([40]) * 1000


def test_rest_that_was_cut_off_does_not_count(tmp_path):
    with StreamFiles(tmp_path, "cam0001") as files:
        for packet in packets():
            files.append(packet)
    times, raw = tmp_path / "cam0001.times.csv", tmp_path / "cam0001.hevc"
    whole = times.read_text()
    times.write_text(whole[:-4])  # the last line was cut
    assert len(read_stream(tmp_path, "cam0001").time) == COUNT - 1
    times.write_text(whole)
    raw.write_bytes(raw.read_bytes()[:-30])  # the last two packets were not yet on the disk
    assert len(read_stream(tmp_path, "cam0001").time) == COUNT - 2


def test_pictures_before_the_first_keyframe_do_not_count(tmp_path):
    with StreamFiles(tmp_path, "cam0001") as files:
        for packet in packets()[3:]:
            files.append(packet)
    stream = read_stream(tmp_path, "cam0001")
    assert len(stream.time) == COUNT - 8 and stream.keyframe[0]
    assert decodable(stream).damaged == 0


def test_damaged_files_are_one_sentence(tmp_path):
    with StreamFiles(tmp_path, "cam0001") as files:
        for packet in packets()[1:4]:
            files.append(packet)
    with pytest.raises(ValueError, match="cam0001 must hold a keyframe; got 3 pictures without one"):
        read_stream(tmp_path, "cam0001")
    times = tmp_path / "cam0001.times.csv"
    times.write_text(times.read_text() + "1,2,x,4,5,6,7\n")
    with pytest.raises(ValueError, match=r"cam0001\.times\.csv line 5 must hold 7 whole numbers; got '1,2,x,4,5,6,7'"):
        read_stream(tmp_path, "cam0001")
    times.write_text("nonsense\n")
    with pytest.raises(ValueError, match=r"cam0001\.times\.csv must start with time_us,"):
        read_stream(tmp_path, "cam0001")
    with pytest.raises(ValueError, match=r"cam0002 must have been recorded; got no cam0002\.times\.csv"):
        read_stream(tmp_path, "cam0002")


def test_existing_files_are_never_written_over(tmp_path):
    (tmp_path / "cam0001.hevc").write_bytes(b"precious")
    (sentence,) = record(tmp_path, Replay("cam0001", packets())).faults
    assert "File exists" in sentence and (tmp_path / "cam0001.hevc").read_bytes() == b"precious"
