"""The C++ floor: floor.cpp compiled where there is a g++, as a Hessian product on arrays laid out for it."""

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from sim.elastic import ElasticTangent

_LANES = 8
# Not -ffast-math: a library linked with it switches denormal numbers off for the whole process, which SciPy trips over.
_FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fopenmp", "-shared", "-fPIC")
Floor = tuple[Callable[[], object], Callable[[], np.ndarray]]  # the job, its result (T, N, 3)


def floor_product(tangent: ElasticTangent, p: np.ndarray) -> Floor | None:
    """A job computing H p and a look at its result (T, N, 3), or None where nothing can compile it.

    The change of layout is not part of the job.
    """
    library = _library()
    if library is None:
        return None
    elastic, cloud = tangent.elastic, tangent.elastic.cloud
    N, k = cloud.neighbours.shape
    packed, F = _packed(p), _packed(tangent.F.reshape(*p.shape[:2], 9))
    out, Q = _aligned(packed.shape), _aligned(F.shape[1:])
    own = np.ascontiguousarray(elastic.stencil_gradients[:, 0])
    edge = (cloud.incident_point * k + cloud.incident_slot).astype(np.int32)
    pattern = elastic.pattern
    arrays = (
        cloud.neighbours, np.ascontiguousarray(cloud.gradients), own, cloud.volume, elastic.m, cloud.incident_start,
        edge, pattern.indptr, pattern.indices, elastic.stiffness, packed, F, Q, out,
    )  # fmt: skip
    sizes = [ctypes.c_long(n) for n in (N, k, len(packed))]

    def job() -> None:
        library.product(*sizes, *(ctypes.c_void_p(a.ctypes.data) for a in arrays))

    return job, lambda: np.moveaxis(out, 3, 1).reshape(-1, N, 3)[: len(p)]


def _library() -> ctypes.CDLL | None:
    compiler = shutil.which("g++")
    if compiler is None:
        return None
    with TemporaryDirectory() as folder:
        target = Path(folder) / "floor.so"
        source = Path(__file__).with_name("floor.cpp")
        done = subprocess.run([compiler, *_FLAGS, str(source), "-o", str(target)], capture_output=True)
        return ctypes.CDLL(str(target)) if done.returncode == 0 else None


def _packed(a: np.ndarray) -> np.ndarray:
    """(T, N, C) to (T / 8, N, C, 8), the last frame repeated to fill the last block."""
    index = np.minimum(np.arange(-(-len(a) // _LANES) * _LANES), len(a) - 1)
    out = _aligned((len(index) // _LANES, *a.shape[1:], _LANES))
    out[...] = np.moveaxis(a[index].reshape(-1, _LANES, *a.shape[1:]), 1, 3)
    return out


def _aligned(shape: tuple[int, ...]) -> np.ndarray:
    raw = np.zeros(int(np.prod(shape)) + _LANES)
    first = -raw.ctypes.data % 64 // 8
    return raw[first : first + int(np.prod(shape))].reshape(shape)
