"""Hessian product: Taichi beside the C++ floor, torch, JAX, numpy and scipy on the same numbers."""

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from scipy.sparse import csr_matrix

from benchmarks import scene
from benchmarks.arrays import Library, array_product
from benchmarks.floor import floor_product
from benchmarks.table import Row, skipped
from benchmarks.timing import Job, interleaved, milliseconds, ratio
from sim.elastic import ElasticTangent

_FEW = 4  # frames that the slow peers compute; their time is scaled
Peer = tuple[Job, Callable[[], np.ndarray], int]  # the job, its result (T', N, 3), its frames T'


def hessian_rows(points: int, frames: int, rounds: int) -> list[Row]:
    """One row a peer; every peer's result is compared with ours first."""
    energy = scene.bar(points, frames)
    tangent = energy.elastic.tangent(scene.twisted(energy, frames))
    p = np.random.default_rng(0).standard_normal((frames, energy.elastic.cloud.count, 3))
    others = peers(tangent, p)
    ours = tangent.product(p)
    for name, (job, result, count) in others.items():
        job()
        assert np.abs(result() - ours[:count]).max() <= 1e-9 * np.abs(ours).max(), name
    jobs = {"taichi": lambda: tangent.product(p), **{name: job for name, (job, _, _) in others.items()}}
    seconds = interleaved(jobs, rounds)
    scale = {name: frames / count for name, (_, _, count) in others.items()}
    size = f"Hessian product, {energy.elastic.cloud.count} points x {frames} frames"
    return [_floor_row(size, seconds), *(_row(size, name, goal, seconds, scale) for name, goal in _GOALS.items())]


_GOALS = {"torch f64": 8.0, "JAX f64": 5.0, "numpy einsum": None, "scipy assembled": None}


def _floor_row(size: str, seconds: dict[str, np.ndarray]) -> Row:
    what, target = f"{size}: Taichi over hand-written C++", "<= 3 x"
    if "C++" not in seconds:
        return skipped(what, "no g++", target)
    found = ratio(seconds["taichi"], seconds["C++"])
    figure = f"{found:.2f} x ({milliseconds(seconds['taichi'])} over {milliseconds(seconds['C++'])})"
    return Row(what=what, figure=figure, target=target, reached=found <= 3)


def _row(size: str, name: str, goal: float | None, seconds: dict[str, np.ndarray], scale: dict[str, float]) -> Row:
    what, target = f"{size}: {name} over Taichi", f">= {goal:g} x" if goal else ""
    if name not in seconds:
        return skipped(what, "not installed", target)
    found = ratio(seconds[name] * scale[name], seconds["taichi"])
    note = f", {_FEW} frames scaled" if scale[name] > 1 else ""
    return Row(what=what, figure=f"{found:.1f} x{note}", target=target, reached=found >= goal if goal else None)


def peers(tangent: ElasticTangent, p: np.ndarray) -> dict[str, Peer]:
    """Everyone else who computes H p here; those that only need a few frames to be timed get them."""
    few = min(_FEW, len(p))
    floor = floor_product(tangent, p)
    found = {
        "C++": None if floor is None else (*floor, len(p)),
        "torch f64": _torch(tangent, p),
        "JAX f64": _jax(tangent, p),
        "numpy einsum": _whole_arrays(tangent, p[:few], _numpy()),
        "scipy assembled": _assembled(tangent, p[:few]),
    }
    return {name: peer for name, peer in found.items() if peer is not None}


def _whole_arrays(tangent: ElasticTangent, p: np.ndarray, library: Library, compiled: Callable = lambda f: f) -> Peer:
    """Frames last, as these libraries want it; the change of layout is not timed."""
    product = compiled(array_product(tangent, library))
    columns = library.array(np.ascontiguousarray(p.transpose(1, 2, 0)))
    F = library.array(np.ascontiguousarray(tangent.F[: len(p)].transpose(1, 2, 3, 0)))
    out = []

    def job() -> None:
        out[:] = [product(columns, F)]
        getattr(out[0], "block_until_ready", lambda: None)()

    return job, lambda: np.asarray(out[0]).transpose(2, 0, 1), len(p)


def _numpy() -> Library:
    def scatter(index: np.ndarray, rows: np.ndarray, count: int) -> np.ndarray:
        gather = csr_matrix((np.ones(len(index)), (index, np.arange(len(index)))), (count, len(index)))
        return (gather @ rows.reshape(len(index), -1)).reshape(count, 3, -1)

    def einsum(rule: str, *operands: np.ndarray) -> np.ndarray:
        return np.einsum(rule, *operands, optimize=True)

    return Library(array=np.asarray, einsum=einsum, stack=np.stack, scatter=scatter)


def _torch(tangent: ElasticTangent, p: np.ndarray) -> Peer | None:
    try:
        import torch
    except ImportError:
        return None

    def scatter(index: torch.Tensor, rows: torch.Tensor, count: int) -> torch.Tensor:
        return torch.zeros(count, *rows.shape[1:], dtype=rows.dtype).index_add(0, index, rows)

    library = Library(array=torch.from_numpy, einsum=torch.einsum, stack=torch.stack, scatter=scatter)
    return _whole_arrays(tangent, p, library)


def _jax(tangent: ElasticTangent, p: np.ndarray) -> Peer | None:
    try:
        import jax
        import jax.numpy as jnp
    except ImportError:
        return None
    jax.config.update("jax_enable_x64", True)

    def scatter(index: jax.Array, rows: jax.Array, count: int) -> jax.Array:
        return jnp.zeros((count, *rows.shape[1:])).at[index].add(rows)

    library = Library(array=jnp.asarray, einsum=jnp.einsum, stack=jnp.stack, scatter=scatter)
    return _whole_arrays(tangent, p, library, jax.jit)


def _assembled(tangent: ElasticTangent, p: np.ndarray) -> Peer:
    """The assembled matrix of each frame times its column; assembling is not timed."""
    pattern, N = tangent.elastic.pattern, p.shape[1]
    blocks = tangent.assembled(slice(0, len(p)))
    matrices = [sp.bsr_matrix((b, pattern.indices, pattern.indptr), shape=(3 * N, 3 * N)).tocsr() for b in blocks]
    out = []

    def job() -> None:
        out[:] = [H @ v.ravel() for H, v in zip(matrices, p, strict=True)]

    return job, lambda: np.reshape(out, p.shape), len(p)
