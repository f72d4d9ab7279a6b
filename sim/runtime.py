"""The one owner of Taichi's start: CPU unless told, f64, quiet; everything else calls `ensure()`."""

import contextlib
import functools
import io

import taichi as ti
from threadpoolctl import ThreadpoolController

ARCHITECTURES = ("cpu", "cuda")


def ensure(arch: str | None = None, *, debug: bool = False, threads: int | None = None) -> None:
    """Start Taichi once with 64-bit floats; do nothing when it already runs that way.

    arch: "cpu" or "cuda"; default what runs already, else "cpu". debug: bounds checks in kernels. threads: CPU threads,
    default all. Taichi ignores these two once it runs: a second start would invalidate every array of the first.
    Raises ValueError for an unknown arch, RuntimeError when the caller's own Taichi runs in 32 bits, or Taichi on
    another arch than the one asked for, as it does without a GPU.
    """
    if arch not in (None, *ARCHITECTURES):
        raise ValueError(f"arch must be one of {ARCHITECTURES}; got {arch!r}")
    if _runs():
        if ti.lang.impl.get_runtime().default_fp != ti.f64:
            raise RuntimeError("Taichi already runs with 32-bit floats; start it with sim.runtime.ensure() instead")
    else:
        _start(arch or "cpu", debug, threads)
    if arch is not None and running() != arch:
        raise RuntimeError(f"Taichi runs on {running()}; {arch} must be there, and be asked for before anything else")


def running() -> str:
    """What Taichi runs on, one of ARCHITECTURES; "cpu" before it is started."""
    return "cuda" if _runs() and ti.lang.impl.current_cfg().arch == ti.cuda else "cpu"


def _runs() -> bool:
    return ti.lang.impl.get_runtime().prog is not None


def _start(arch: str, debug: bool, threads: int | None) -> None:
    options = {"cpu_max_num_threads": threads} if threads else {}
    quiet = {"log_level": ti.ERROR, "offline_cache": True}
    with contextlib.redirect_stdout(io.StringIO()):
        ti.init(arch=getattr(ti, arch), default_fp=ti.f64, debug=debug, **quiet, **options)


@functools.cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()


def serial_blas() -> contextlib.AbstractContextManager:
    """Run BLAS on one thread inside the context: small dense factors and SuperLU lose tenfold to threads that wait."""
    return _controller().limit(limits=1, user_api="blas")
