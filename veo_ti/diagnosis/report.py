"""What a diagnosis leaves in its folder: one file for programs, pictures and a page for people."""

from collections.abc import Mapping
from pathlib import Path

from veo_ti.diagnosis.facts import facts
from veo_ti.diagnosis.pictures import draw_all
from veo_ti.diagnosis.run import Diagnosis
from veo_ti.diagnosis.sentence import amount, words
from veo_ti.report import Section, Table, write_report
from veo_ti.store import writable_folder, write_json_atomic


def write_diagnosis(diagnosis: Diagnosis, folder: str | Path) -> dict[str, object]:
    """Write diagnosis.json, pictures and diagnosis.html into folder; returns the facts.

    Raises ValueError in one sentence for a folder that cannot be written.
    """
    folder = writable_folder(folder)
    found = facts(diagnosis)
    write_json_atomic(folder / "diagnosis.json", found)
    pictures = draw_all(diagnosis, folder)
    sections = [
        _wrong(found, pictures), *_named(found), _evidence(found, pictures), *_missing(pictures),
        *_gained(found, pictures), *_untested(found), _smallest(found),
    ]  # fmt: skip
    name = diagnosis.identification.observation.name or "the object"
    write_report(folder / "diagnosis.html", f"Diagnosis of {name}", found["sentence"], sections)
    return found


def _wrong(found: Mapping, pictures: Mapping[str, Path]) -> Section:
    rows = [
        ["misfit in smooth modes, standard deviations above noise", found["misfit_z"]],
        *([["the same with what was named", found["misfit_z_after"]]] if found["verdict"] == "named" else []),
        ["noise per coordinate [mm]", found["noise_mm"]],
        ["residuals that make one independent one", found["noise_correlation"]],
        ["outliers left out", f"{found['outlier_share']:.2%}"],
        ["Newton's steps of all frames", found["steps"]],
        ["seconds", found["seconds"]],
    ]
    text = (
        "Where and when the best material is off the measurement. Above 4 standard deviations something is wrong "
        "that neither noise nor stiffness explains."
    )
    shown = [pictures["residual"], pictures["over_time"]]
    return Section(heading="What is wrong", text=text, table=Table(columns=["", ""], rows=rows), pictures=shown)


def _named(found: Mapping) -> list[Section]:
    """The causes with their parameters and intervals, where there are any."""
    if not found["causes"]:
        return []
    rows = [
        [words(cause["name"]), cause["place"], p["name"], p["value"], f"{p['low']:.4g} to {p['high']:.4g}", p["unit"],
         f"{cause['explained']:.0%}"]
        for cause in found["causes"] for p in cause["parameters"]
    ]  # fmt: skip
    columns = ["cause", "where", "parameter", "value", "95 % interval", "unit", "of the misfit explained"]
    text = " ".join(dict.fromkeys(cause["sentence"] for cause in found["causes"]))
    heading = "The cause and its size"
    if found["ambiguous_with"]:
        heading, text = "What it may be", f"Each of these would do, and this measurement cannot choose. {text}"
        if found["causes"][-1]["round"]:
            text = f"Two things are wrong, each of them one of several. {text}"
    return [Section(heading=heading, text=text, table=Table(columns=columns, rows=rows))]


def _evidence(found: Mapping, pictures: Mapping[str, Path]) -> Section:
    refitted = {c["name"]: c for c in found["rounds"][0]["refitted"]}
    rows = [
        [
            words(c["name"]), c["log_bayes"], f"{c['keep']:.0%}", f"{c['promised']:.0%}",
            *_refit_cells(refitted.get(c["name"])), _first(c),
        ]
        for c in found["ranking"] if c["log_bayes"] is not None
    ]  # fmt: skip
    columns = ["cause", "log Bayes factor", "survives", "promises", "after refit", "explains", "first-order size"]
    text = (
        "Evidence for (right) and against (left) each cause, in nats: three are worth mentioning, six are strong. "
        "'Survives' is the share of a cause's fingerprint that no change of the material can imitate; 'promises' is "
        "the share of what is wrong that it would explain if little were wrong; the leaders were fitted in full "
        "together with the material."
    )
    return Section(
        heading="Evidence for and against", text=text, table=Table(columns=columns, rows=rows),
        pictures=[pictures["ranking"]],
    )  # fmt: skip


def _refit_cells(candidate: Mapping | None) -> list[object]:
    if candidate is None:
        return ["", ""]
    note = "" if candidate["plausible"] else ", not plausible"
    return [candidate["log_evidence_gain"], f"{candidate['explained']:.0%}{note}"]


def _first(cause: Mapping) -> str:
    return ", ".join(f"{p['name']} {amount(p['value'], p['unit'])}" for p in cause["parameters"])


def _missing(pictures: Mapping[str, Path]) -> list[Section]:
    if "missing_force" not in pictures:
        return []
    text = (
        "Forces on the free surface that would take away what the material cannot explain, in the frame of largest "
        "misfit; the smallest that do. Colours show how far that frame is off."
    )
    return [Section(heading="The missing force", text=text, pictures=[pictures["missing_force"]])]


def _gained(found: Mapping, pictures: Mapping[str, Path]) -> list[Section]:
    errors = found["error_mm"]
    if errors is None:
        return []
    text = "Errors per coordinate on frames that chose nothing: neither the material nor the cause saw them."
    rows = [
        [label, errors[key]]
        for label, key in (
            ("no change (rest pose)", "no_change"), ("one homogeneous material", "homogeneous"),
            ("hold the residual of the nearest training frame", "hold_residual"),
            ("refit of the material only", "refit_only"),
        )
    ]  # fmt: skip
    if found["verdict"] == "named":
        gained = errors["gained"]
        rows.append(["with the named cause", errors["after"]])
        rows.append(["gained", f"{gained['value']:.3g} (95 %: {gained['low']:.3g} to {gained['high']:.3g})"])
    table = Table(columns=["model", "error [mm]"], rows=rows)
    return [Section(heading="What the extension gained", text=text, table=table, pictures=[pictures["gain"]])]


def _untested(found: Mapping) -> list[Section]:
    rows = [[words(c["name"]), c["why_not"]] for c in found["ranking"] if not c["testable"]]
    if not rows and not found["limits"]:
        return []
    about = "This measurement says nothing about these causes; none of them is ruled out."
    text = " ".join([*found["limits"], *([about] if rows else [])])
    return [Section(heading="What could not be tested", text=text, table=Table(columns=["cause", "why"], rows=rows))]


def _smallest(found: Mapping) -> Section:
    rows = [
        [words(c["name"]), p["name"], amount(p["smallest_detectable"], p["unit"])]
        for c in found["ranking"] if c["testable"] for p in c["parameters"] if p["smallest_detectable"] is not None
    ]  # fmt: skip
    text = "The size that each cause would need to be seen in nine cases of ten; smaller ones may be there."
    table = Table(columns=["cause", "parameter", "smallest size"], rows=rows)
    return Section(heading="What would have been seen", text=text, table=table)
