"""`python -m benchmarks`: measure every target of the design against the other ways of computing the same."""

import argparse
from pathlib import Path

from benchmarks.fitting import fit_rows
from benchmarks.growth import growth_rows
from benchmarks.hessian import hessian_rows
from benchmarks.iterate import check_rows, iterate_rows
from benchmarks.linear import direct_rows, linear_rows, many_frames_rows
from benchmarks.table import chosen, publish, report

_WORDS = (
    "How fast this simulator is beside other ways of computing the same. All peers took turns in this one run, so the "
    "ratios hold even where the machine was busy; every peer's result was checked."
)
_SMALL = "This was `--quick`: bodies too small for the targets, which are meant for the full run."

FULL = {
    "Hessian product": lambda: hessian_rows(12000, 32, 7),
    "linear solve": lambda: linear_rows(10000, 32, 2),
    "many right sides": lambda: [*direct_rows(600, 90, 5), *direct_rows(1500, 90, 3), *direct_rows(5000, 90, 1)],
    "many frames": lambda: [*many_frames_rows(600, 24, 5), *many_frames_rows(1500, 24, 5)],
    "warm solve and adjoint": lambda: iterate_rows(10000, 8),
    "adjoint against differences": lambda: check_rows(1000, 2),
    "fit and Adam": lambda: fit_rows(600, 6, 150),
    "growth": lambda: growth_rows((1000, 2000, 5000, 10000, 20000, 50000), (1, 100), 2),
}
QUICK = {
    "Hessian product": lambda: hessian_rows(600, 4, 3),
    "linear solve": lambda: linear_rows(600, 2, 1),
    "many right sides": lambda: direct_rows(300, 9, 1),
    "many frames": lambda: many_frames_rows(300, 5, 1),
    "warm solve and adjoint": lambda: iterate_rows(600, 2),
    "adjoint against differences": lambda: check_rows(300, 1),
    "fit and Adam": lambda: fit_rows(300, 2, 8),
    "growth": lambda: growth_rows((600, 1200), (1, 100), 1),
}


def main() -> None:
    """Measure, print and, on request, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="The table of timings, as markdown.")
    parser.add_argument("--quick", action="store_true", help="small bodies: does everything run?")
    parser.add_argument("--only", nargs="*", help="sections, by their first word")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the markdown here too")
    given = parser.parse_args()
    # Taichi compiles every kernel on its first use: once over the small bodies first keeps that out of the times.
    for measure in chosen(QUICK, given.only).values():
        measure()
    sections = chosen(QUICK if given.quick else FULL, given.only)
    publish(report(_WORDS, sections, note=_SMALL if given.quick else ""), given.out)


if __name__ == "__main__":
    main()
