"""What the diagnosis of the beam's motion leaves in its folder: numbers for programs, pictures, and one page."""

from collections.abc import Callable, Mapping
from pathlib import Path

from veo_ti.beam_dynamics.facts import facts
from veo_ti.beam_dynamics.pictures import draw_all
from veo_ti.beam_dynamics.run import BeamDiagnosis, diagnose_beam
from veo_ti.beam_dynamics.takes import read_releases
from veo_ti.report import Section, Table, write_report
from veo_ti.store import writable_folder, write_json_atomic


def run_beam_diagnosis(
    folder: str | Path, out: str | Path, *, progress: Callable[[str], None] = lambda text: None
) -> dict[str, object]:
    """`veo diagnose` on a folder of beam_*.npz takes: diagnosis.json, pictures and report.html; returns the facts.

    Raises ValueError in one sentence for a folder without takes or one that cannot be written.
    """
    releases = read_releases(folder)
    out = writable_folder(out)
    return write_beam_diagnosis(diagnose_beam(releases, progress=progress), out)


def write_beam_diagnosis(d: BeamDiagnosis, folder: Path) -> dict[str, object]:
    """Write everything into an existing folder; returns the facts."""
    found = facts(d)
    write_json_atomic(folder / "diagnosis.json", found)
    pictures = draw_all(d, folder)
    sections = [
        _wrong(found, pictures), _course(found), *_named(found), _evidence(found, pictures), *_open(found),
        *_ringing(found, pictures), *_gained(found, pictures), _limits(found),
    ]  # fmt: skip
    write_report(folder / "report.html", "Diagnosis of the silicone beam's motion", found["sentence"], sections)
    return found


def _wrong(found: Mapping, pictures: Mapping[str, Path]) -> Section:
    rows = [
        ["quasi-static model on the fitted takes [mm]", found["fitted_error_mm"]["before"]],
        ["best hypothesis on the fitted takes [mm]", found["fitted_error_mm"]["after"]],
        ["the static model's own error on settled poses [mm]", found["settled_error_mm"]],
        ["scatter of a settled marker [mm]", found["noise_mm"]],
        ["misfit before, standard deviations beyond the settled poses' error", found["misfit_z"]],
        ["the same after", found["misfit_z_after"]],
        ["residuals that count as one independent one", found["noise_correlation"]],
        ["seconds", found["seconds"]],
    ]
    text = (
        "A quasi-static beam is in its settled pose as soon as nothing holds it. Errors are root mean squares per "
        "coordinate in the plane of the loads, from 0.1 to 1.5 s after the release."
    )
    shown = [pictures["tip"], pictures["error"]]
    return Section(heading="What is wrong", text=text, table=Table(columns=["", ""], rows=rows), pictures=shown)


def _course(found: Mapping) -> Section:
    rows = [
        [take, f"{row['from_s']:g} to {row['to_s']:g}", row["quasi_static"], row["best"]]
        for take, course in found["error_over_time_mm"].items() for row in course
    ]  # fmt: skip
    columns = ["take", "seconds after the release", "quasi-static [mm]", "best hypothesis [mm]"]
    text = (
        "Mean distance of the three tip markers, motion across the plane of the loads included. Until 0.1 s the hand "
        "is still in the motion: no fit looks at it."
    )
    return Section(heading="Errors over time", text=text, table=Table(columns=columns, rows=rows))


def _named(found: Mapping) -> list[Section]:
    if not found["causes"]:
        return []
    rows = [
        [c["name"].replace("_", " "), f"{c['log_evidence_gain']:.0f}", f"{c['explained']:.1%}", _held(c), _sizes(c)]
        for c in found["causes"]
    ]
    columns = ["cause", "evidence [nats]", "explains", "unseen takes, mm (95 %)", "parameters (95 %)"]
    text = "Each cause beside the best hypothesis without it. " + " ".join(c["sentence"] for c in found["causes"])
    return [Section(heading="The causes and their sizes", text=text, table=Table(columns=columns, rows=rows))]


def _held(cause: Mapping) -> str:
    g = cause["held_out_gain_mm"]
    return "" if g is None else f"{g['value']:.2f} ({g['low']:.2f} to {g['high']:.2f})"


def _sizes(cause: Mapping) -> str:
    known = [f"{p['name']} {p['value']:.3g} {p['unit']}" for p in cause["parameters"] if p["low"] == p["high"]]
    free = [
        f"{p['name']} {p['value']:.3g} ({p['low']:.3g} to {p['high']:.3g}) {p['unit']}"
        for p in cause["parameters"] if p["low"] != p["high"]
    ]  # fmt: skip
    return "; ".join(known + free)


def _evidence(found: Mapping, pictures: Mapping[str, Path]) -> Section:
    rows = [[h["hypothesis"], h["log_bayes"], h["error_mm"]] for h in found["hypotheses"]]
    text = (
        "Every hypothesis has the same nuisances: the modulus within its static interval, how far each loading falls, "
        "and when and how slowly the hand let go. Residuals that move together count once."
    )
    table = Table(columns=["hypothesis", "log evidence over quasi-static", "leaves [mm]"], rows=rows)
    return Section(heading="Evidence", text=text, table=table, pictures=[pictures["evidence"]])


def _open(found: Mapping) -> list[Section]:
    rows = [
        [q["cause"].replace("_", " "), a["answer"], a["nats_behind"], "possible" if a["open"] else "rejected"]
        for q in found["open_questions"] for a in q["answers"]
    ]  # fmt: skip
    if not rows:
        return []
    text = _mass(found) + (found["separating_experiment"] or "Nothing is left open.")
    columns = ["cause", "how it works", "nats behind the best", ""]
    return [Section(heading="What can be told apart", text=text, table=Table(columns=columns, rows=rows))]


def _mass(found: Mapping) -> str:
    hung = found["hung_mass"]
    if hung is None or hung["nats_against"]["weighed_mass_alone"] is None:
        return ""
    against, m = hung["nats_against"], hung["fitted"]
    return (
        f"The hung mass fitted together with what else the tip may carry: {1e3 * m['value']:.1f} g (95 %: "
        f"{1e3 * m['low']:.1f} to {1e3 * m['high']:.1f}), weighed {1e3 * hung['weighed_kg']:.1f} g. Against no mass "
        f"at all: {against['no_mass']:.0f} nats; against the weighed mass alone: {against['weighed_mass_alone']:.0f}; "
        f"against it with a few grams of fittings: {against['weighed_mass_and_fittings']:.1f}. "
    )


def _ringing(found: Mapping, pictures: Mapping[str, Path]) -> list[Section]:
    if "ringing" not in pictures:
        return []
    rows = [
        [name.replace("_V2_", " ").replace("load52", "52 g"), *[_cell(r[side][key]) for key in
         ("frequency_hz", "damping_ratio") for side in ("measured", "predicted")]]
        for name, r in found["ringing"].items()
    ]  # fmt: skip
    columns = ["take", "Hz, measured", "Hz, model", "damping ratio, measured", "damping ratio, model"]
    apart = [f"{r['frequency_hz']:.2g} Hz and {r['damping_ratio']:.1g}" for r in found["repeats"].values()]
    text = (
        "The same damped sinusoid on a creeping offset, fitted to measured and modelled tip heights after 0.3 s. "
        f"Repeats of a loading differ from each other by {', and by '.join(apart) or 'an unknown amount'}."
    )
    table = Table(columns=columns, rows=rows)
    return [Section(heading="Frequency and damping", text=text, table=table, pictures=[pictures["ringing"]])]


def _cell(value: Mapping) -> str:
    return f"{value['value']:.4g} ({value['low']:.4g} to {value['high']:.4g})"


def _gained(found: Mapping, pictures: Mapping[str, Path]) -> list[Section]:
    if "gain" not in pictures:
        return []
    g = found["error_mm"]["gained"]
    text = (
        f"Of {', '.join(found['predicted'])} only frames 0.1 to 0.3 s after the release were used, for when the hand "
        f"let go. Gained over a quasi-static refit: {g['value']:.2f} mm (95 %: {g['low']:.2f} to {g['high']:.2f})."
    )
    return [Section(heading="What the extension gained", text=text, pictures=[pictures["gain"]])]


def _limits(found: Mapping) -> Section:
    cloud = found["cloud"]
    rows = [
        ["points", cloud["points"]], ["Young's modulus fitted on this cloud [kPa]", cloud["young_pa"] / 1e3],
        ["last change of full simulation minus shapes [mm]", cloud["correction_change_mm"]],
        ["shapes against full simulation on unseen takes [mm]",
         "" if cloud["shapes_error_mm"] is None else cloud["shapes_error_mm"]],
    ]  # fmt: skip
    text = (
        "Hypotheses move the beam on ten shapes about its settled pose, corrected by the full simulation of the "
        "reference hypothesis (both damping coefficients, creep, masses at the tip)."
    )
    return Section(heading="How it was computed", text=text, table=Table(columns=["", ""], rows=rows))
