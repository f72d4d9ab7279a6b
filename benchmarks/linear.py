"""Linear systems beside direct peers: a Newton step's, all frames together to 1e-3; many right sides of one frame."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from benchmarks import scene
from benchmarks.direct import Cholmod, Superlu, best_direct
from benchmarks.table import Row, skipped
from benchmarks.timing import interleaved, milliseconds, ratio
from sim.direct import DirectFactors, Layout
from sim.linear import conjugate_gradients
from sim.runtime import serial_blas
from sim.solvers import LinearSolver

_FEW = {"CHOLMOD": 2, "SuperLU": 1}  # frames that the peers solve
_GOALS = {"CHOLMOD": 2.0, "SuperLU": 15.0}


def linear_rows(points: int, frames: int, rounds: int) -> list[Row]:
    """One row a direct peer; assembling counts on every side, the analysis of the pattern on none."""
    energy = scene.bar(points, frames)
    y = scene.twisted(energy, frames)
    tangent, right, solver = energy.tangent(y), -energy.gradient(y), LinearSolver.of(energy, "two-level")
    peers = dict([best_direct(energy), ("SuperLU", Superlu.of(energy))])

    def ours() -> None:
        precondition = solver.preconditioner(tangent)
        assert conjugate_gradients(tangent.product, right, precondition, tolerance=1e-3).converged.all()

    def one_by_one(peer: Cholmod | Superlu, count: int) -> None:
        for t in range(count):
            part, b = energy.frames(np.array([t])).tangent(y[t : t + 1]), right[t : t + 1]
            x = peer.preconditioner(part)(b)
            assert np.linalg.norm(part.product(x) - b) <= 1e-8 * np.linalg.norm(b)

    jobs = {name: lambda name=name: one_by_one(peers[name], _FEW[name]) for name in peers}
    seconds = interleaved({"ours": ours, **jobs}, rounds, warm=0)
    own = seconds["ours"] / frames
    size = f"Linear solve to 1e-3, {len(right[0])} points x {frames} frames"
    return [_row(f"{size}: {name} over ours", name, goal, seconds.get(name), own) for name, goal in _GOALS.items()]


def direct_rows(points: int, columns: int, rounds: int) -> list[Row]:
    """Factorising one frame's Hessian and solving for as many right sides as sensitivities ask, in one thread: in
    double precision, as SuperLU does, and in single, as sensitivities do."""
    energy = scene.bar(points, 1)
    tangent = energy.tangent(scene.twisted(energy, 1))
    layout, blocks = Layout.of(energy.elastic), tangent.assembled(slice(0, 1))[0]
    right = np.asfortranarray(np.random.default_rng(0).standard_normal((3 * len(tangent.y[0]), columns)))
    found = {}

    def ours() -> None:
        found["ours"] = layout.cholesky(blocks).solve(right)

    def single() -> None:
        found["single"] = layout.cholesky(blocks.astype(np.float32)).solve(right)

    def superlu() -> None:
        found["SuperLU"] = layout.indefinite(blocks).solve(right)

    _ = layout.dissection, layout.template
    with serial_blas():
        seconds = interleaved({"ours": ours, "single": single, "SuperLU": superlu}, rounds)
    size = np.abs(found["SuperLU"]).max()
    assert np.abs(found["ours"] - found["SuperLU"]).max() <= 1e-8 * size
    assert np.abs(found["single"] - found["SuperLU"]).max() <= 1e-3 * size
    what = f"One factor and {columns} right sides, {len(tangent.y[0])} points, one thread"
    return [
        Row(
            what=f"{what}: {names}",
            figure=f"{ratio(seconds[slow], seconds[fast]):.1f} x "
            f"({milliseconds(seconds[slow])} over {milliseconds(seconds[fast])})",
        )
        for names, slow, fast in (
            ("SuperLU over ours", "SuperLU", "ours"),
            ("ours in double over ours in single precision", "ours", "single"),
        )
    ]


def many_frames_rows(points: int, frames: int, rounds: int) -> list[Row]:
    """Factors in single precision, made and applied on two threads: a few frames at once beside one after another."""
    energy = scene.bar(points, frames)
    tangent = energy.tangent(scene.twisted(energy, frames))
    layout, right = Layout.of(energy.elastic), -energy.gradient(tangent.y)
    blocks = tangent.assembled(slice(None)).astype(np.float32)
    held = DirectFactors.of(tangent, layout)

    def made(together: int) -> None:
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(layout.cholesky, [blocks[t : t + together] for t in range(0, frames, together)]))

    def applied_alone() -> None:
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(lambda factor, v: factor.solve(v.ravel()), held.factors, right))

    jobs = {
        "made together": lambda: made(4), "made alone": lambda: made(1),
        "applied together": lambda: held(right), "applied alone": applied_alone,
    }  # fmt: skip
    with serial_blas():
        seconds = interleaved(jobs, rounds)
    what = f"Factors of {frames} frames, {len(right[0])} points, two threads: one frame at a time over several"
    return [
        Row(
            what=f"{what}, {job}",
            figure=f"{ratio(seconds[f'{job} alone'], seconds[f'{job} together']):.1f} x "
            f"({milliseconds(seconds[f'{job} alone'] / frames)} a frame over "
            f"{milliseconds(seconds[f'{job} together'] / frames)})",
        )
        for job in ("made", "applied")
    ]


def _row(what: str, name: str, goal: float, seconds: np.ndarray | None, own: np.ndarray) -> Row:
    target, few = f">= {goal:g} x", _FEW[name]
    if seconds is None:
        return skipped(what, "cvxopt is not installed", target)
    gain = ratio(seconds / few, own)
    figure = f"{gain:.1f} x ({np.median(seconds) / few:.2f} s a frame, {few} of them, over {np.median(own):.2f} s)"
    return Row(what=what, figure=figure, target=target, reached=gain >= goal)
