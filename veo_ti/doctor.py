"""What works on this machine, and what to do about what does not. Every probe runs in a process of its own."""

import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from veo_ti.offscreen import can_render

PACKAGES = {  # name on PyPI: what is imported
    "numpy": "import numpy", "scipy": "import scipy", "taichi": "import sim.runtime",
    "torch": "import torch", "open3d": "from sim._open3d import load_open3d; load_open3d()",
    "opencv-python-headless": "import cv2", "depthai": "import depthai", "pyvista": "import pyvista",
    "h5py": "import h5py", "rich": "import rich", "cyclopts": "import cyclopts", "imageio": "import imageio",
    "imageio-ffmpeg": "import imageio_ffmpeg", "libusb-package": "import libusb_package",
    "matplotlib": "import matplotlib.figure", "c3d": "import c3d", "threadpoolctl": "import threadpoolctl",
}
DEBIAN = {  # the shared library a loader may miss: the package that holds it
    "libusb-1.0.so.0": "libusb-1.0-0", "libGL.so.1": "libgl1", "libEGL.so.1": "libegl1", "libX11.so.6": "libx11-6",
    "libXrender.so.1": "libxrender1", "libXext.so.6": "libxext6", "libSM.so.6": "libsm6", "libICE.so.6": "libice6",
    "libgomp.so.1": "libgomp1", "libudev.so.1": "libudev1", "libOSMesa.so.8": "libosmesa6",
    "libstdc++.so.6": "libstdc++6", "libgthread-2.0.so.0": "libglib2.0-0", "libtinfo.so.6": "libtinfo6",
}
TAICHI_PROBE = """
import numpy as np
import taichi as ti
from sim.runtime import ensure
ensure()
@ti.kernel
def double(x: ti.types.ndarray(dtype=ti.f64, ndim=1)):
    for i in x:
        x[i] *= 2.0
x = np.arange(3.0)
double(x)
assert x.tolist() == [0.0, 2.0, 4.0], x
"""
CAMERA_PROBE = """
import depthai
found = [d.getDeviceId() for d in depthai.Device.getAllAvailableDevices()]
open("answer", "w").write(", ".join(found))
"""
CUDA_PROBE = """
import torch
names = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())]
open("answer", "w").write(", ".join(names))
"""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One line of the doctor's table: ok, or a sentence saying what to do. What is not `needed` may be absent."""

    name: str
    version: str
    ok: bool
    sentence: str
    needed: bool = True


@dataclass(frozen=True, kw_only=True)
class _Answer:
    """How a probe ended: the process's code (None: too slow), the end of what it said, what it wrote as its answer."""

    code: int | None
    said: str
    answer: str


def examine() -> list[Finding]:
    """Look at packages, Taichi, off-screen drawing, film writing, cameras, processors, memory and CUDA.

    Takes some seconds; nothing that crashes or hangs in a probe reaches the caller.
    """
    probes: list[Callable[[], Finding]] = [lambda name=name: _package(name) for name in PACKAGES]
    probes += [_taichi_kernel, _drawing, _film, _cameras, _processors, _memory, _cuda]
    with ThreadPoolExecutor(max_workers=max(2, min(8, os.cpu_count() or 2))) as pool:
        return [future.result() for future in [pool.submit(probe) for probe in probes]]


def explain(name: str, code: int | None, said: str) -> str:
    """What to do when importing `name` ended with this exit code (None: too slow) and these last words."""
    library = re.search(r"(lib[\w.+-]+\.so[.\d]*): (?:cannot open|file too short|invalid)", said)
    if library and library[1] in DEBIAN:
        return f"The system library {library[1]} is missing: apt install {DEBIAN[library[1]]}"
    if library:
        return f"The system library {library[1]} is missing: find its package with apt-file search {library[1]}"
    if code is None:
        return "It did not answer in time: try again when the machine is less busy"
    if code < 0:
        return f"Loading it ends the process ({signal.Signals(-code).name}): pip install --force-reinstall {name}"
    if absent := re.search(r"No module named '([\w]+)", said):
        wanted = name if "".join(PACKAGES.get(name, "").split()[-1:]) == absent[1] else absent[1]
        return f"Not installed: pip install {wanted}"
    return said.strip().splitlines()[-1] if said.strip() else f"It ended with exit code {code} and said nothing"


def _package(name: str) -> Finding:
    result = _run(PACKAGES[name])
    ok = result.code == 0
    return Finding(name=name, version=_version(name), ok=ok,
                   sentence="" if ok else explain(name, result.code, result.said), needed=name != "depthai")


def _taichi_kernel() -> Finding:
    result = _run(TAICHI_PROBE)
    ok = result.code == 0
    return Finding(name="Taichi kernel on the CPU", version=_version("taichi"), ok=ok,
                   sentence="compiles and runs" if ok else explain("taichi", result.code, result.said))


def _drawing() -> Finding:
    ok = can_render()
    painted = "pictures are painted in software, films take longer; for OpenGL: apt install libegl1 libgl1-mesa-dri"
    return Finding(name="off-screen OpenGL", version=_version("vtk"), ok=ok, sentence="draws" if ok else painted,
                   needed=False)


def _film() -> Finding:
    result = _run("import imageio_ffmpeg, subprocess, sys\n"
                  "subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), '-version'], check=True, capture_output=True)\n"
                  "open('answer', 'w').write(imageio_ffmpeg.get_ffmpeg_version())")
    ok = result.code == 0
    return Finding(name="ffmpeg", version=result.answer, ok=ok,
                   sentence="writes mp4" if ok else explain("imageio-ffmpeg", result.code, result.said))


def _cameras() -> Finding:
    result = _run(CAMERA_PROBE, timeout=5.0, DEPTHAI_SEARCH_TIMEOUT="500", DEPTHAI_LEVEL="off")
    sentence = f"found {result.answer}" if result.answer else "none found; only needed to record: plug one into USB 3"
    if result.code is None:
        sentence = "The search did not end in 5 s; only needed to record"
    return Finding(name="OAK-D cameras", version=_version("depthai"), ok=bool(result.answer), sentence=sentence,
                   needed=False)


def _processors() -> Finding:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return Finding(name="processor cores", version=str(cores), ok=True,
                   sentence="enough" if cores > 1 else "works; two or more are faster")


def _memory() -> Finding:
    try:
        gigabytes = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
    except (AttributeError, ValueError, OSError):
        return Finding(name="memory", version="unknown", ok=True, sentence="this system does not say")
    ok = gigabytes > 3.5
    return Finding(name="memory", version=f"{gigabytes:.1f} GB", ok=ok, sentence="enough" if ok else "4 GB are advised")


def _cuda() -> Finding:
    result = _run(CUDA_PROBE)
    seen, none = f"torch sees {result.answer}; --device cuda uses it", "torch sees none; everything runs on the CPU"
    sentence = seen if result.answer else none
    return Finding(name="CUDA", version="", ok=bool(result.answer), sentence=sentence, needed=False)


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def _run(code: str, *, timeout: float = 90.0, **environment: str) -> _Answer:
    """Run code from a file (Taichi reads its own source) in an empty folder, with this project importable."""
    root = str(Path(__file__).resolve().parent.parent)
    path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
    with tempfile.TemporaryDirectory() as folder:
        probe, answer = Path(folder, "probe.py"), Path(folder, "answer")
        probe.write_text(code)
        try:
            done = subprocess.run([sys.executable, str(probe)], cwd=folder, capture_output=True, text=True, check=False,
                                  timeout=timeout, env={**os.environ, "PYTHONPATH": path, **environment})
        except subprocess.TimeoutExpired:
            return _Answer(code=None, said="", answer="")
        return _Answer(code=done.returncode, said=(done.stdout + done.stderr)[-4000:],
                       answer=answer.read_text() if answer.exists() else "")
