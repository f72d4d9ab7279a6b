"""Run blind trials and write what came out: `python -m blind.run --trials 100 --first-seed 1000 --out DIR`.

Seeds below 1000 are for development: thresholds are set on them. Seeds from 1000 on are for judgement: once they have
led to a change of rules, take others. Every trial is one JSON file in DIR, written when it is done; a second call goes
on where the first one stopped. A trial that raises is an error, and counts as one.
"""

import argparse
import json
import multiprocessing
import os
import time
import traceback
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from blind import world
from blind.report import report
from blind.shapes import SIZES
from blind.tracking import SETTINGS


def main() -> None:
    """Parse the arguments, run what is not there yet, write and print the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--first-seed", type=int, default=world.FIRST_JUDGED)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/blind"))
    parser.add_argument("--size", choices=SIZES, default="small")
    parser.add_argument("--mix", choices=world.MIXES, default="default")
    parser.add_argument("--effect", help="hide this in every trial, whatever the mix says")
    parser.add_argument("--setting", choices=SETTINGS, help="measure all like this, whatever the mix says")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    seeds = range(given.first_seed, given.first_seed + given.trials)
    tasks = [(s, given.out, given.size, given.mix, given.effect, given.setting) for s in seeds]
    records = []
    for record in _all(tasks, given.jobs):
        records.append(record)
        print(f"{len(records)}/{given.trials} {_line(record)}", flush=True)
    records.sort(key=lambda r: r["seed"])
    options = {name.replace("_", "-"): value for name, value in vars(given).items() if value and name != "out"}
    text = report(records, command=" ".join(["python -m blind.run", *(f"--{n} {v}" for n, v in options.items())]))
    _write(given.out / "report.md", text)
    print(text)


def _all(tasks: list[tuple], jobs: int) -> Iterator[dict]:
    if jobs <= 1:
        yield from (run_one(*task) for task in tasks)
        return
    # Not ProcessPoolExecutor: with max_tasks_per_child it hangs in Python 3.11 once every worker has been replaced.
    with multiprocessing.get_context("spawn").Pool(jobs, maxtasksperchild=10) as pool:
        yield from pool.imap_unordered(_run_task, tasks, chunksize=1)


def _run_task(task: tuple) -> dict:
    return run_one(*task)


def run_one(seed: int, out: Path, size: str, mix: str, effect: str | None, setting: str | None) -> dict:
    """The record of one trial, made now or read where it was made before."""
    name = "_".join([mix if effect is None else effect, *([setting] if setting else []), size, str(seed)])
    path = out / f"{name}.json"
    if path.exists():
        return json.loads(path.read_text(encoding="utf-8"))
    effects, planned = world.plan(seed, mix) if effect is None else ((effect,), "iid")
    setting = setting or planned
    record = {"seed": seed, "size": size, "mix": mix, "effects": list(effects), "setting": setting}
    with threadpool_limits(1):
        try:
            record |= _made_and_judged(seed, effects, setting, size, mix, out / name)
        except Exception as error:  # whatever the toolkit or the generator raises is this trial's result
            record |= {"outcome": "error", "error": repr(error), "traceback": traceback.format_exc()}
    _write(path, json.dumps(record, indent=1))
    return record


def _made_and_judged(seed: int, effects: tuple[str, ...], setting: str, size: str, mix: str, stem: Path) -> dict:
    from blind import judging  # it starts the toolkit, which making a trial must not need

    measurement, answer = stem.with_suffix(".npz"), stem.with_suffix(".truth.npz")
    began = time.perf_counter()
    given = {"size": size, "setting": setting, "goal": world.CLEAR if mix in world.AIMED else None}
    made = world.trial(seed, effects, **given)
    made.save(measurement, answer)
    seconds = time.perf_counter() - began
    said = judging.verdict_on(measurement, made)
    each = []
    for i in range(len(effects) if len(effects) > 1 else 0):
        alone = world.trial(seed, effects, **given, only=i)
        alone.save(stem.with_suffix(f".{i}.npz"), stem.with_suffix(f".{i}.truth.npz"))
        each.append(judging.left_of(stem.with_suffix(f".{i}.npz"), alone))
    catalogued = [e for e in made.truth["effects"] if e in judging.KNOWN]
    return {
        "truth": made.truth, "said": said, "outcome": judging.outcome(made.truth, said),
        "catalogued": catalogued, "coverage": judging.covered(made.truth, said),
        "detectability": judging.detectability(made.truth, said), "seconds_made": seconds, "each_in_noise": each,
    }  # fmt: skip


def _write(path: Path, text: str) -> None:
    """Whole or not at all."""
    partial = path.with_suffix(".part")
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, path)


def _line(record: dict) -> str:
    what = "+".join(record["effects"]) or "nothing"
    if record["outcome"] == "error":
        return f"seed {record['seed']} {what}: error {record['error']}"
    said = record["said"]
    named = ", ".join(said["named"] or [c["name"] for c in said["causes"]])
    spent = record["seconds_made"], *said["seconds"].values()
    return (
        f"seed {record['seed']} {what} ({record['setting']}, {said['excess_in_noise']:.2f} x noise after refit): "
        f"{record['outcome']} [{said['verdict']} {named}] {np.round(spent, 0)} s"
    )


if __name__ == "__main__":
    main()
