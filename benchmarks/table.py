"""Measure one section after the other: one markdown table of figures beside their targets, with the machine named."""

import math
import os
import platform
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from recon.files import replacing

_PACKAGES = ("numpy", "scipy", "taichi", "torch", "jax", "cvxopt", "scikit-sparse")
_ANSWER = {True: "yes", False: "**no**", None: ""}


@dataclass(frozen=True, kw_only=True)
class Row:
    """What was measured, the figure, the target in words, and whether it is reached (None: there is no target)."""

    what: str
    figure: str
    target: str = ""
    reached: bool | None = None


def skipped(what: str, why: str, target: str = "") -> Row:
    """The row of something that this machine cannot measure."""
    return Row(what=what, figure=f"not measured: {why}", target=target)


def markdown(rows: Sequence[Row]) -> str:
    """The table."""
    lines = ["| what | figure | target | reached |", "|---|---|---|---|"]
    return "\n".join(lines + [f"| {r.what} | {r.figure} | {r.target} | {_ANSWER[r.reached]} |" for r in rows])


def chosen(sections: Mapping[str, Callable], words: Sequence[str] | None) -> dict[str, Callable]:
    """The sections whose names begin with one of the words; all without any."""
    return {name: m for name, m in sections.items() if not words or any(name.startswith(word) for word in words)}


def report(words: str, sections: Mapping[str, Callable[[], list[Row]]], *, note: str = "") -> str:
    """The sentences, the machine and the table; says on stderr what is being measured, and what came of it, so that
    nothing is lost where a later section fails."""
    rows: list[Row] = []
    for name, measure in sections.items():
        begin = time.perf_counter()
        print(f"{name} ...", end=" ", file=sys.stderr, flush=True)
        found = measure()
        took = f"{time.perf_counter() - begin:.0f} s"
        print(took, *(f"  {r.what}: {r.figure}" for r in found), sep="\n", file=sys.stderr, flush=True)
        rows += found
    return "\n\n".join(part for part in (words, note, machine(), markdown(rows)) if part)


def publish(text: str, path: Path | None) -> None:
    """Print, and on request write."""
    print(text)
    if path is not None:
        with replacing(path) as partial:
            partial.write_text(text + "\n", encoding="utf-8")


def machine() -> str:
    """Processor, cores, load, memory, Python and the packages that matter, in a sentence."""
    versions = [f"{name} {version}" for name in _PACKAGES if (version := _version(name))]
    load = f"load {os.getloadavg()[0]:.1f} at the end, " if hasattr(os, "getloadavg") else ""
    system = f"{platform.system()}, Python {platform.python_version()}"
    return f"{_processor()}, {os.cpu_count()} cores, {load}{_memory()}{system}, {', '.join(versions)}."


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def peak_memory() -> float:
    """The most memory [GB] that this process held so far; NaN where the system does not say."""
    try:
        import resource
    except ImportError:  # Windows
        return float("nan")
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**30


def _memory() -> str:
    held = peak_memory()
    return "" if math.isnan(held) else f"at most {held:.1f} GB of memory used, "


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
