"""Ask the toolkit for its verdict on a measurement, and compare that with the truth."""

import time
from pathlib import Path

import numpy as np

from blind.world import Trial
from sim.runtime import ensure
from veo_ti.diagnosis.causes import CATALOGUE
from veo_ti.diagnosis.facts import facts
from veo_ti.diagnosis.fitted import Refit
from veo_ti.diagnosis.run import Diagnosis, diagnose
from veo_ti.identification import identify
from veo_ti.observation import Observation

_ROUNDED = 1e-6  # a measurement holds positions in single precision, and a spot on a level face has a height without sd
KNOWN = frozenset(cause.name for cause in CATALOGUE)  # what the toolkit could name


def verdict_on(measurement: Path, made: Trial) -> dict[str, object]:
    """What the toolkit says about a measurement, as `veo diagnose` does, in plain values.

    What was made is not shown to it: it measures what of the effect the refitted baseline left.
    """
    ensure(threads=1)
    began = time.perf_counter()
    identified = identify(Observation.load(measurement))
    seconds = time.perf_counter() - began
    found = diagnose(identified, CATALOGUE)
    said = facts(found)
    rows = [{**row, "rank": i} for i, row in enumerate(said["ranking"])]
    return {
        **{name: value for name, value in said.items() if name != "ranking"},
        "named": [candidate.name for candidate in found.named],
        "ranking": {row["name"]: row for row in rows},
        "excess_in_noise": _excess(found, found.baseline, made),
        "excess_after_in_noise": _excess(found, found.final, made),
        "gain_confirmed": bool(found.gain is not None and found.gain.confirmed),
        "seconds": {"identify": seconds, "diagnose": found.seconds},
    }


def left_of(measurement: Path, made: Trial) -> float:
    """What a refitted baseline leaves of what is hidden, RMS over sigma; no cause is asked for."""
    ensure(threads=1)
    found = diagnose(identify(Observation.load(measurement)), ())
    return _excess(found, found.baseline, made)


def _excess(found: Diagnosis, fitted: Refit, made: Trial) -> float:
    """RMS per coordinate, over sigma, between fitted positions and the noise-free truth where the fit could see it."""
    scene = found.baseline.scene
    counted = scene.target.seen & scene.train[:, None]
    return float(np.sqrt(np.mean((fitted.shown - made.clean)[counted] ** 2))) / (1e-3 * made.truth["sigma_mm"])


def outcome(truth: dict, said: dict) -> str:
    """What became of a trial in one word; see `blind.report.OUTCOMES`.

    An effect that the toolkit's catalogue does not hold counts as one from outside.
    """
    verdict, named = said["verdict"], said["named"]
    effects, catalogued = set(truth["effects"]), set(truth["effects"]) & KNOWN
    if verdict == "no_misfit":
        return "missed" if effects else "silent"
    if verdict == "unexplained":
        return "unexplained"
    if verdict == "ambiguous":
        return "ambiguous, truth inside" if catalogued & {c["name"] for c in said["causes"]} else "ambiguous, without"
    if not set(named) <= effects:
        return "extra name" if named[0] in effects else "wrong name"
    if len(named) == len(effects):
        return "right"
    last = said["rounds"][-1]
    either = last["verdict"] == "ambiguous" and catalogued - set(named) <= set(last["causes"])
    return "one of two, other inside" if either else "one of two"


def covered(truth: dict, said: dict) -> list[dict[str, object]]:
    """For every parameter of a rightly named cause whose formula is the truth's: truth, interval, whether it covers."""
    if truth["setting"]["name"] == "force_scale":  # forces and stiffnesses are then in units nobody knows
        return []
    told = {planted["name"]: planted["tells"] for planted in truth["planted"]}
    rows = []
    for cause in said["causes"] if said["verdict"] == "named" else []:
        for p in cause["parameters"]:
            value = told.get(cause["name"], {}).get(p["name"])
            if value is not None and p["low"] is not None:
                inside = p["low"] - _ROUNDED * abs(value) <= value <= p["high"] + _ROUNDED * abs(value)
                rows.append({"cause": cause["name"], **p, "truth": value, "covered": bool(inside)})
    return rows


def detectability(truth: dict, said: dict) -> float | None:
    """How many times the smallest detectable size the effect has, where its amount compares with the toolkit's."""
    if len(truth["planted"]) != 1 or truth["setting"]["name"] == "force_scale":
        return None
    planted = truth["planted"][0]
    row = said["ranking"].get(planted["name"], {"parameters": []})
    sizes = [abs(planted["tells"][p["name"]]) / p["smallest_detectable"] for p in row["parameters"]
             if p["name"] in planted["tells"] and p.get("smallest_detectable")]  # fmt: skip
    return max(sizes, default=None)
