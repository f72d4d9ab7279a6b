"""`python -m benchmarks.reconstruction`: reconstruct rig recordings, and measure it against the truth beside them."""

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.reconstruction_rows import (
    Filmed,
    bent_rows,
    cloud_rows,
    correspondence_row,
    grey_row,
    object_rows,
    picture_row,
    stiffness_row,
    timed,
    truth_row,
)
from benchmarks.table import Row, chosen, publish, report
from recon.radiance.device import use
from recon.radiance.extraction import ExtractOptions, extract
from recon.radiance.fields import FieldOptions
from recon.radiance.hashgrid import HashGrid
from recon.radiance.options import TrainOptions
from recon.rig.make import make_rig
from recon.rig.motion import SHAPES
from recon.rig.options import RigOptions
from recon.rig.truth import lend_mattes, read_truth
from sim.runtime import ARCHITECTURES
from veo_ti.reconstruction.loop import run_recording
from veo_ti.reconstruction.run import ReconstructChoice

_WORDS = (
    "How well synthetic recordings are reconstructed, whose truth is known, and what that costs. Mattes are the true "
    "ones; two cameras judge and taught nothing. Times are those of this machine as busy as it was."
)
_SMALL = "This was `--quick`: pictures too small for the targets, which are meant for the full run."
_TEST = ("cam0004", "cam0010")


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is measured: the recordings, their training sizes [px] and the steps of each training."""

    static: RigOptions
    static_resolution: int
    single: TrainOptions  # of its one frame
    few: RigOptions
    few_test: tuple[str, ...]
    few_steps: int
    moving: RigOptions
    unseen: str  # a shape that no training's settings were chosen for
    resolution: int
    short: TrainOptions  # for two minutes
    long: TrainOptions  # for five
    points: int
    loop: RigOptions
    shapes: tuple[str, ...]
    choice: ReconstructChoice
    modes: int
    every: int
    test: tuple[str, ...] = _TEST


FULL = Plan(
    static=RigOptions(frames=2, size=480, greys=False), static_resolution=256,
    single=TrainOptions(canonical_steps=640, motion_steps=0, field_rate=6e-2, cells=136,
                        field=FieldOptions(grid=HashGrid(finest=300, log2_table=16))),
    few=RigOptions(cameras=9, frames=2, size=240), few_test=("cam0002", "cam0005"), few_steps=750,
    moving=RigOptions(frames=12, size=240, greys=False), unseen="pillow", resolution=128,
    short=TrainOptions(canonical_steps=250, motion_steps=700),
    long=TrainOptions(canonical_steps=500, motion_steps=1900),
    points=12_000, loop=RigOptions(frames=48, size=240, greys=False), shapes=SHAPES,
    choice=ReconstructChoice(resolution=128, test=_TEST, train=TrainOptions(canonical_steps=300, motion_steps=2000),
                             extract=ExtractOptions(points=2500)),
    modes=40, every=4,
)  # fmt: skip
_FEW = TrainOptions(canonical_steps=250, motion_steps=100, samples=4096)
QUICK = Plan(
    static=RigOptions(cameras=8, frames=2, size=96, greys=False), static_resolution=48,
    single=TrainOptions(canonical_steps=250, motion_steps=0, samples=4096),
    few=RigOptions(cameras=6, frames=2, size=96), few_test=("cam0002",), few_steps=100,
    moving=RigOptions(cameras=8, frames=4, size=96, greys=False), unseen="pillow", resolution=48, short=_FEW,
    long=_FEW, points=700,
    loop=RigOptions(cameras=8, frames=4, size=96, greys=False), shapes=SHAPES[:1],
    choice=ReconstructChoice(resolution=48, test=("cam0003",), train=_FEW, extract=ExtractOptions(points=700)),
    modes=6, every=2, test=("cam0003",),
)  # fmt: skip


def sections(place: Path, plan: Plan) -> dict[str, Callable[[], list[Row]]]:
    """What is measured in which order."""
    out = {
        "one frame": lambda: static_rows(place, plan),
        "grey sensors": lambda: grey_rows(place, plan),
        "short training": lambda: short_rows(place, plan),
        "long training": lambda: long_rows(place, plan),
    }
    return out | {f"the whole way, {shape}": lambda shape=shape: loop_rows(place, plan, shape) for shape in plan.shapes}


def static_rows(place: Path, plan: Plan) -> list[Row]:
    """One frame at twice the resolution, also of a shape that no setting was chosen for."""
    rows = []
    for shape in (plan.static.shape, plan.unseen):
        folder = _recorded(place / f"static-{shape}", replace(plan.static, shape=shape))
        filmed = Filmed.of(folder, plan.static_resolution, plan.test).only_first_frame()
        what = f"One frame of the {shape}, {plan.static_resolution} pixels"
        rows.append(picture_row(filmed, timed(filmed, plan.single), what, least=33, most=30))
    return rows


def grey_rows(place: Path, plan: Plan) -> list[Row]:
    """What the grey sensors add where devices are few."""
    folder, both = _recorded(place / "few", plan.few), []
    for greys in (False, True):
        filmed = Filmed.of(folder, plan.resolution, plan.few_test, greys=greys).only_first_frame()
        both.append((filmed, timed(filmed, replace(plan.long, canonical_steps=plan.few_steps, motion_steps=0))))
    return [grey_row(*both)]


def short_rows(place: Path, plan: Plan) -> list[Row]:
    """All frames, two minutes, also of a shape that no setting was chosen for."""
    rows = []
    for shape in (plan.moving.shape, plan.unseen):
        filmed, what = _moving(place, plan, shape)
        work, what = timed(filmed, plan.short), f"{what}, short training"
        rows.append(picture_row(filmed, work, what, least=28, most=120))
        rows.append(correspondence_row(filmed, work, what, mean=1, median=0.3))
    return rows


def long_rows(place: Path, plan: Plan) -> list[Row]:
    """All frames, five minutes; the cloud of that training, and pictures bent by it."""
    filmed, what = _moving(place, plan, plan.moving.shape)
    work = timed(filmed, plan.long)
    long = f"{what}, long training"
    cloud = extract(work.trained, filmed.views, ExtractOptions(points=plan.points))
    return [
        picture_row(filmed, work, long, least=31, most=300),
        correspondence_row(filmed, work, long, mean=0.5, median=None),
        *cloud_rows(filmed, cloud, long), *bent_rows(filmed, work.trained, cloud, long),
    ]  # fmt: skip


def loop_rows(place: Path, plan: Plan, shape: str) -> list[Row]:
    """`veo run` of one shape: our Tables 1 and 2."""
    folder = _recorded(place / f"loop-{shape}", replace(plan.loop, shape=shape))
    out, begin = place / f"out-{shape}", time.perf_counter()
    found = run_recording(folder, out, plan.choice, modes=plan.modes, every=plan.every)
    size = f"{plan.loop.cameras} cameras, {plan.loop.frames} frames, {plan.choice.resolution} pixels"
    took = Row(what=f"`veo run`, {shape} ({size})", figure=f"{time.perf_counter() - begin:.0f} s")
    truth = read_truth(folder)
    held = truth_row(shape, found, out, truth), stiffness_row(shape, out, truth)
    return [took, *object_rows(shape, found, out), *held]


def _moving(place: Path, plan: Plan, shape: str) -> tuple[Filmed, str]:
    folder = _recorded(place / f"moving-{shape}", replace(plan.moving, shape=shape))
    filmed = Filmed.of(folder, plan.resolution, plan.test)
    cameras = len(filmed.views.cameras) + len(filmed.judges.cameras)
    return filmed, f"{shape}, {len(filmed.views.times)} frames x {cameras} cameras x {plan.resolution} pixels"


def _recorded(folder: Path, options: RigOptions) -> Path:
    """Made where it is not there yet, with the true mattes; one that was begun is gone on with."""
    if not folder.exists():
        begun = folder.with_name(f"{folder.name}.begun")
        make_rig(begun, options)
        lend_mattes(begun)
        begun.rename(folder)
    return folder


def main() -> None:
    """Measure, print and, on request, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reconstruction", description="As markdown.")
    parser.add_argument("--quick", action="store_true", help="small recordings: does everything run?")
    parser.add_argument("--only", nargs="*", help="sections, by their first word")
    parser.add_argument("--folder", type=Path, help="keep the recordings here, and go on with those that are there")
    parser.add_argument("--device", choices=ARCHITECTURES, default="cpu", help="what trains and renders")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the markdown here too")
    given = parser.parse_args()
    use(given.device)
    with tempfile.TemporaryDirectory() as place:
        measured = sections(given.folder or Path(place), QUICK if given.quick else FULL)
        publish(report(_WORDS, chosen(measured, given.only), note=_SMALL if given.quick else ""), given.out)


if __name__ == "__main__":
    main()
