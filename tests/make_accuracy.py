"""The table of docs/accuracy.md: `python tests/make_accuracy.py > docs/accuracy.md` (about three minutes)."""

import fem_scenes
import numpy as np
from fem_ratios import SAMPLINGS, block_ratio, cantilever_ratios
from test_sim_fit import NOISE, problem, solve

from sim.fit import check_gradient

HEAD = """# Accuracy

How far simulated bodies of about 4000 points move, over how far finite elements of the same material do (1 is right;
scikit-fem, quadratic hexahedra, see `tests/fem_scenes.py`). Made by `python tests/make_accuracy.py`.

| body | load | points | consistent (default) | paper's plain scheme |
|---|---|---|---|---|"""


def cantilever_rows() -> list[str]:
    """One row a sampling and load."""
    rows = []
    for kind in SAMPLINGS:
        modes = (cantilever_ratios(kind, mode) for mode in ("consistent", "paper"))
        ratios = zip((8, 22, 41), *modes, strict=True)
        rows += [f"| cantilever | tip drops {p} % | {kind} | {a:.3f} | {b:.3f} |" for p, a, b in ratios]
    return rows


def block_rows() -> list[str]:
    """One row a direction of the pull."""
    found = {way: [block_ratio(axis, mode)[0] for mode in ("consistent", "paper")] for way, axis in WAYS.items()}
    return [f"| two-material block | {way} | poisson | {a:.3f} | {b:.3f} |" for way, (a, b) in found.items()]


WAYS = {"pulled, halves end to end": 0, "pulled, halves side by side": 2}


def recovery() -> str:
    """What the fit makes of finite-element data with noise."""
    sequence = fem_scenes.two_region_sequence(NOISE)
    energy, target = problem(sequence, np.arange(len(sequence.points)))
    result = solve(energy, target)
    error = np.abs(np.log10(result.lame.mu / sequence.mu_true))
    sigma = 1e3 * result.state.sigma
    return (
        f"A beam of two stiffnesses (25 and 5 kPa), {len(error)} points, {len(sequence.points)} frames, noise {NOISE} "
        f"spacings: the fit's mu is off by {np.median(error):.3f} decades in the median and "
        f"{np.quantile(error, 0.9):.3f} at 90 %; it estimates the noise at {sigma:.3f} mm (true: "
        f"{1e3 * sequence.sigma:.3f} mm); its gradient is within {check_gradient(energy, target, result):.0e} of "
        "finite differences."
    )


if __name__ == "__main__":
    print("\n".join([HEAD, *cantilever_rows(), *block_rows(), "", recovery()]))
