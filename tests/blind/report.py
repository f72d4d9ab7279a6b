"""The tables of a set of blind trials, as markdown."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise

import numpy as np
from scipy.stats import beta

WEAK = 1.3  # times the noise: an effect below it is not expected to be named
CLASSES = {"strong, >= 3 x noise": (3.0, np.inf), "medium, 1.3 to 3 x": (WEAK, 3.0), "weak, < 1.3 x": (0.0, WEAK)}
OUTCOMES = {
    "right": "everything hidden named, nothing else",
    "one of two": "one of two named, nothing else",
    "one of two, other inside": "one of two named, and several left for the other, the truth among them",
    "extra name": "the truth named first, then something that is not there",
    "wrong name": "named first what is not there",
    "ambiguous, truth inside": "several causes left, the truth among them",
    "ambiguous, without": "several causes left, the truth not among them",
    "unexplained": "something is wrong, no name: right where the effect is outside the catalogue",
    "missed": "no misfit where something was hidden",
    "silent": "no misfit where nothing was hidden",
    "error": "the trial ended in an exception",
}
WRONG = ("wrong name", "extra name")
Records = Sequence[dict]


def report(records: Records, *, command: str) -> str:
    """Everything that the trials say."""
    done = [r for r in records if r["outcome"] != "error"]
    parts = [
        f"# Blind trials\n\n`{command}`\n\n{len(records)} trials, {len(records) - len(done)} of them errors. Seeds "
        "below 1000 are for development, the others for judgement. Strength is what the refitted baseline leaves "
        "of the effect in the training frames, RMS over sigma.",
        "\n".join(f"- {name}: {meaning}" for name, meaning in OUTCOMES.items()),
        "## By kind\n\n" + _table("kind", _by(records, _kind)),
        "## By strength, one effect of the catalogue\n\n" + _table("strength", _strengths(done)),
        "## By strength of the weaker one, two effects\n\nEach was also hidden alone.\n\n"
        + _table("strength", _weaker(done)),
        "## By effect\n\n" + _table("hidden", _by(records, lambda r: "+".join(r["effects"]) or "nothing")),
        "## By setting\n\n" + _table("setting", _by(records, lambda r: r["setting"])),
        "## Answers\n\n" + _answers(done),
        "## Figures\n\n" + _figures(records, done),
        "## Predicted detection limit against what was seen\n\n" + _power(done),
    ]
    return "\n\n".join(parts) + "\n"


def clopper_pearson(hits: int, count: int, level: float = 0.95) -> tuple[float, float]:
    """Exact two-sided interval of a proportion (Clopper & Pearson 1934)."""
    tail = (1 - level) / 2
    low = 0.0 if hits == 0 else float(beta.ppf(tail, hits, count - hits + 1))
    return low, 1.0 if hits == count else float(beta.ppf(1 - tail, hits + 1, count - hits))


def share(hits: int, count: int) -> str:
    """A proportion with its interval."""
    if count == 0:
        return "no trial"
    low, high = clopper_pearson(hits, count)
    return f"{hits}/{count} = {hits / count:.0%} ({low:.1%} to {high:.1%})"


def _kind(record: dict) -> str:
    effects = record["effects"]
    if not effects:
        return "nothing"
    if len(effects) == 2:
        return "two effects"
    if record["outcome"] == "error":
        return "error"
    return "one effect" if record["catalogued"] else "outside the catalogue"


def _by(records: Records, key: Callable[[dict], str]) -> dict[str, list[dict]]:
    found: dict[str, list[dict]] = {}
    for record in sorted(records, key=key):
        found.setdefault(key(record), []).append(record)
    return found


def _strengths(done: Records) -> dict[str, list[dict]]:
    return _classed([r for r in done if _kind(r) == "one effect"], lambda r: r["said"]["excess_in_noise"])


def _weaker(done: Records) -> dict[str, list[dict]]:
    return _classed([r for r in done if _kind(r) == "two effects"], lambda r: min(r["each_in_noise"]))


def _classed(records: Records, strength: Callable[[dict], float]) -> dict[str, list[dict]]:
    return {name: [r for r in records if low <= strength(r) < high] for name, (low, high) in CLASSES.items()}


def _table(title: str, rows: dict[str, list[dict]]) -> str:
    seen = {r["outcome"] for group in rows.values() for r in group}
    columns = sorted(seen)
    lines = [f"| {title} | trials | " + " | ".join(columns) + " |", "|---" * (len(columns) + 2) + "|"]
    for name, group in rows.items():
        counts = Counter(r["outcome"] for r in group)
        lines.append(f"| {name} | {len(group)} | " + " | ".join(str(counts[c] or "") for c in columns) + " |")
    return "\n".join(lines)


def _answers(done: Records) -> str:
    lines = ["| seed | hidden | setting | raw / noise | after refit / noise | answer | outcome |", "|---" * 7 + "|"]
    for r in done:
        said = r["said"]
        named = "+".join(said["named"]) or " or ".join(c["name"] for c in said["causes"])
        raw = r["truth"]["raw_in_noise"]
        lines.append(
            f"| {r['seed']} | {'+'.join(r['effects']) or 'nothing'} | {r['setting']} | {raw:.1f} "
            f"| {said['excess_in_noise']:.2f} | {said['verdict']} {named} | {r['outcome']} |"
        )
    return "\n".join(lines)


def _figures(records: Records, done: Records) -> str:
    kinds, strengths = _by(done, _kind), _strengths(done)
    nothing, two = kinds.get("nothing", []), kinds.get("two effects", [])
    both = [r for r in two if min(r["each_in_noise"]) >= WEAK]
    alike = [r for r in nothing if r["setting"] not in ("outliers", "correlated")]
    hard = [r for r in nothing if r["setting"] in ("outliers", "correlated")]
    outside = kinds.get("outside the catalogue", [])
    named = [r for r in done if r["said"]["verdict"] == "named"]
    intervals = [row for r in done for row in r["coverage"]]
    errors = [r for r in records if r["outcome"] == "error"]
    lines = []
    for name, group in strengths.items():
        lines.append((f"right, {name}", _count(group, lambda r: r["outcome"] == "right")))
        lines.append((f"wrongly named, {name}", _count(group, lambda r: r["outcome"] in WRONG)))
    lines += [
        ("false alarms on nulls", _count(alike, lambda r: r["outcome"] != "silent")),
        ("false alarms on nulls, named", _count(alike, lambda r: r["outcome"] == "wrong name")),
        ("false alarms, 1 % outliers or correlated noise", _count(hard, lambda r: r["outcome"] != "silent")),
        ("outside the catalogue, wrongly named", _count(outside, lambda r: r["outcome"] in WRONG)),
        ("two effects, both named", _count(two, lambda r: r["outcome"] == "right")),
        (f"the same, where each alone leaves >= {WEAK} x", _count(both, lambda r: r["outcome"] == "right")),
        ("two effects, something named that is not there", _count(two, lambda r: r["outcome"] in WRONG)),
        ("gain confirmed on held-out frames, of all named", _count(named, lambda r: r["said"]["gain_confirmed"])),
        ("share of the misfit that a refit explains less what its score promised", _promises(done)),
        ("95 % intervals that cover", _count(intervals, lambda row: row["covered"])),
        ("errors", share(len(errors), len(records))),
        ("seconds to make a trial", _seconds(r["seconds_made"] for r in done)),
        ("seconds to identify", _seconds(r["said"]["seconds"]["identify"] for r in done)),
        ("seconds to diagnose", _seconds(r["said"]["seconds"]["diagnose"] for r in done)),
    ]
    return "| figure | value |\n|---|---|\n" + "\n".join(f"| {name} | {value} |" for name, value in lines)


def _promises(done: Records) -> str:
    """How the first look's refits differ from their scores; older records do not hold what those promised."""
    told = [
        (c["explained"], r["said"]["ranking"][c["name"]].get("promised"))
        for r in done for c in r["said"]["rounds"][0]["refitted"]
    ]  # fmt: skip
    more = np.array([explained - promised for explained, promised in told if None not in (explained, promised)])
    if not len(more):
        return "no refit"
    return "{:+.2f} to {:+.2f} in nine of ten, at most {:+.2f}".format(*np.quantile(more, (0.05, 0.95)), more.max())


def _count(rows: Sequence, test: Callable[[dict], bool]) -> str:
    return share(sum(map(test, rows)), len(rows))


def _seconds(values: Iterable[float]) -> str:
    found = np.array(list(values))
    return f"median {np.median(found):.0f}, at most {found.max():.0f}" if len(found) else "none"


def _power(done: Records) -> str:
    """Trials by how many times the smallest detectable size their effect had."""
    edges = [0, 0.5, 1, 2, 4, np.inf]
    known = [(r["detectability"], r["outcome"]) for r in done if r.get("detectability") is not None]
    lines = ["| size / smallest detectable | trials | not missed | right |", "|---" * 4 + "|"]
    for low, high in pairwise(edges):
        group = [o for d, o in known if low <= d < high]
        lines.append(f"| {low:g} to {high:g} | {len(group)} | {sum(o != 'missed' for o in group)} "
                     f"| {group.count('right')} |")  # fmt: skip
    return "\n".join(lines)
