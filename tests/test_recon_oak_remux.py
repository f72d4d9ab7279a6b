"""Packets that FFmpeg reads: they are its own memory, with room behind."""

import subprocess
import sys
from pathlib import Path

ON_FORBIDDEN_PAGES = """
import ctypes, mmap
import av
from oak_fakes import COLOUR, clip
from recon.oak.remux import owned_packet

def guarded(data):  # the last byte is the last of a page, and what follows may not be read
    whole = -(-len(data) // mmap.PAGESIZE) * mmap.PAGESIZE
    memory = mmap.mmap(-1, whole + mmap.PAGESIZE)
    start = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    assert ctypes.CDLL(None).mprotect(ctypes.c_void_p(start + whole), mmap.PAGESIZE, 0) == 0
    memory[whole - len(data) : whole] = data
    return memoryview(memory)[whole - len(data) : whole]

decoder = av.CodecContext.create("hevc", "r")
decoder.thread_type = "AUTO"
packets = [owned_packet(guarded(data), number) for number, data in enumerate(clip(COLOUR, 8))]
assert [frame.pts for packet in [*packets, None] for frame in decoder.decode(packet)] == list(range(8))
"""


def test_decoder_may_read_past_the_end_of_a_packet():
    """FFmpeg's bit readers do, by up to 64 bytes: given Python's own bytes the process crashes now and then."""
    command = [sys.executable, "-c", "import sys; sys.path.insert(0, 'tests')\n" + ON_FORBIDDEN_PAGES]
    done = subprocess.run(command, cwd=Path(__file__).parent.parent, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
