"""What a coupon's diagnosis leaves in its folder: one file for programs, pictures and a page for people."""

from collections.abc import Mapping
from pathlib import Path

from veo_ti.coupons.facts import facts
from veo_ti.coupons.pictures import draw_fits, draw_gain, draw_library, draw_predictions, draw_ranking
from veo_ti.coupons.predict import LABELS
from veo_ti.coupons.run import CouponDiagnosis
from veo_ti.coupons.sentence import words
from veo_ti.report import Section, Table, write_report
from veo_ti.store import writable_folder, write_json_atomic


def write_coupon(diagnosis: CouponDiagnosis, folder: str | Path) -> dict[str, object]:
    """Write coupon.json, pictures and report.html into folder; returns the facts.

    Raises ValueError in one sentence for a folder that cannot be written.
    """
    folder = writable_folder(folder)
    found = facts(diagnosis)
    write_json_atomic(folder / "coupon.json", found)
    sections = [
        _wrong(found, draw_fits(diagnosis, folder / "fits.png")), *_told(found),
        _evidence(found, draw_ranking(diagnosis, folder / "ranking.png")), *_gained(diagnosis, found, folder),
        *_next(diagnosis, found, folder), _untested(found), _smallest(found),
    ]  # fmt: skip
    write_report(folder / "report.html", f"Coupon: {diagnosis.coupon.name}", found["sentence"], sections)
    return found


def _wrong(found: Mapping, picture: Path) -> Section:
    rows = [
        ["shear modulus of the Neo-Hookean fit [kPa]", f"{found['baseline']['mu_pa'] / 1e3:.4g}"],
        ["smooth error that it leaves, of the stress", f"{found['baseline']['smooth_error_left']:.1%}"],
        ["the same with what was named", f"{found['smooth_error_left']:.1%}"],
        ["misfit, standard deviations above noise", found["misfit_z"]],
        *([f"noise of {mode}, of the stress", f"{level:.2%}"] for mode, level in found["noise"].items()),
    ]
    text = (
        "The best Neo-Hookean law beside the data. Above 4 standard deviations something is wrong that noise, and what "
        "such tests are off by, do not explain."
    )
    return Section(heading="What is wrong", text=text, table=Table(columns=["", ""], rows=rows), pictures=[picture])


def _told(found: Mapping) -> list[Section]:
    if not found["explanations"]:
        return []
    rows = [
        [e["forms"], words([part["name"]]), p["name"], p["value"], f"{p['low']:.4g} to {p['high']:.4g}", p["unit"],
         f"{e['mu_pa'] / 1e3:.4g}"]
        for e in found["explanations"] for part in e["parts"] for p in part["parameters"]
    ]  # fmt: skip
    columns = ["law", "cause", "parameter", "value", "95 % interval", "unit", "mu [kPa]"]
    text = "What every explanation shares is named; the others would do as well, and these data cannot choose."
    heading = "The cause and its size" if not found["ambiguous_with"] else "What it may be"
    return [Section(heading=heading, text=text, table=Table(columns=columns, rows=rows))]


def _evidence(found: Mapping, picture: Path) -> Section:
    tested = [c for c in found["ranking"] if c["testable"]]
    rows = [
        [c["forms"], words(c["causes"]), c["log_evidence_gain"], f"{c['explained']:.0%}",
         f"{c['smooth_error_left']:.1%}", "" if c["plausible"] else "wrong sign"]
        for c in tested[:30]
    ]  # fmt: skip
    text = (
        "Log evidence over the Neo-Hookean law in nats. Every law may leave a smooth error; the smaller it can be, the "
        "better the law. A cause counts from six nats on, and each further one must gain six more."
    )
    table = Table(columns=["law", "causes", "nats", "explains", "leaves", ""], rows=rows)
    return Section(heading="Evidence for and against", text=text, table=table, pictures=[picture])


def _gained(diagnosis: CouponDiagnosis, found: Mapping, folder: Path) -> list[Section]:
    gain = found["gain"]
    if gain is None:
        return []
    shown = [draw_predictions(diagnosis, folder / "predictions.png"), draw_gain(diagnosis, folder / "gain.png")]
    rows = [
        [fold["label"], words([fold["verdict"]]), fold["forms"][0], held["mode"],
         *(_share(held["relative_error"][key]) for key in LABELS), held["r_squared"]["after"] or "",
         held["usual_mooney_rivlin_r_squared"]]
        for fold in found["folds"] for held in fold["held_out"]
    ]  # fmt: skip
    columns = ["fitted -> predicted", "verdict", "best law", "mode", "zero", "hold residual", "refit only",
               "named causes", "R2", "R2 of a usual Mooney-Rivlin fit"]  # fmt: skip
    g = gain["gained"]
    interval = "" if g["low"] is None else f" (95 %: {g['low']:.1%} to {g['high']:.1%})"
    text = (
        f"Errors of curves that chose nothing, root mean square in units of the stress. All together the named causes "
        f"gain {_share(g['value'])}{interval}; {gain['coverage_95']:.0%} of the points lie in their 95 % intervals."
    )
    return [
        Section(heading="What knowing it gained", text=text, table=Table(columns=columns, rows=rows), pictures=shown)
    ]


def _next(diagnosis: CouponDiagnosis, found: Mapping, folder: Path) -> list[Section]:
    experiment = found["separating_experiment"]
    if experiment is None:
        return []
    rows = [
        [e["mode"], e["stretch"], e["separation_sd"], e["noise_units"], "in the data" if e["repeated"] else ""]
        for e in experiment["library"]
    ]
    text = (
        f"{' against '.join(experiment['between'])}: how far a test of eight points would part them, in standard "
        f"deviations of all that is uncertain, and of the noise alone. Advised: {experiment['advised'] or 'none'}."
    )
    columns = ["mode", "largest stretch", "standard deviations", "units of noise", ""]
    picture = draw_library(diagnosis, folder / "next_test.png")
    return [
        Section(heading="What to measure next", text=text, table=Table(columns=columns, rows=rows), pictures=[picture])
    ]


def _untested(found: Mapping) -> Section:
    rows = [[words(c["causes"]), c["why_not"]] for c in found["ranking"] if not c["testable"]]
    text = "This measurement says nothing about these causes; none of them is ruled out."
    return Section(heading="What could not be tested", text=text, table=Table(columns=["cause", "why"], rows=rows))


def _smallest(found: Mapping) -> Section:
    rows = [
        [words(part["causes"]), part["forms"], p["name"], p["smallest_detectable"], p["unit"]]
        for part in found["ranking"] if part["testable"] and len(part["causes"]) == 1
        for p in part["parts"][0]["parameters"]
    ]  # fmt: skip
    text = (
        "The size that each cause, alone, would need to be seen in nine cases of ten, with the smooth error that its "
        "law leaves here."
    )
    table = Table(columns=["cause", "law", "parameter", "smallest size", "unit"], rows=rows)
    return Section(heading="What would have been seen", text=text, table=table)


def _share(value: float | None) -> str:
    return "infinite" if value is None else f"{value:.1%}"
