"""What a finished identification leaves in its folder: one file for programs, pictures and a page for people."""

from pathlib import Path

import numpy as np

from recon.metrics import DistanceTable
from veo_ti.identification import Identification
from veo_ti.observation import Observation
from veo_ti.plots import error_over_time
from veo_ti.report import Section, Table, write_report
from veo_ti.scene import forces_of
from veo_ti.store import SequenceWriter, write_json_atomic
from veo_ti.view import error_map, frames_strip, lame_map, save_picture, sensitivity_map, turntable


def write_identification(
    result: Identification, observation: Observation, folder: Path, *, paper: DistanceTable | None = None,
    last: bool = True,
) -> dict[str, object]:  # fmt: skip
    """Write object.vtkhdf, metrics.json, pictures and report.html into folder; returns the metrics.

    paper: the row of the paper's Table 1, where the input holds the paper's own results. last: nothing follows that
    may be interrupted, so the checkpoints go.
    """
    metrics = result.metrics
    if paper is not None:
        metrics["error_mm_paper"] = {"mean": paper.mean_mm, "p95": paper.p95_mm, "max": paper.max_mm}
    _write_object(result, observation, metrics, folder)
    write_json_atomic(folder / "metrics.json", metrics)
    pictures = _pictures(result, observation, folder)
    sections = [
        _error_section(metrics, pictures),
        _material_section(result, metrics, pictures),
        _trust_section(result, metrics, pictures),
    ]
    write_report(folder / "report.html", f"Material of {observation.name or 'the object'}", sentence(metrics), sections)
    if last:
        remove_checkpoints(folder)
    return metrics


def remove_checkpoints(folder: Path) -> None:
    """Delete what an interrupted identification or diagnosis would have gone on from."""
    for checkpoint in folder.glob("checkpoint_*.npz"):
        checkpoint.unlink()


def sentence(metrics: dict) -> str:
    """The result in one plain sentence."""
    mu, unexplained = metrics["mu_pa"], metrics["noise_mm"] * np.sqrt(8 / np.pi)
    factor = _factor(metrics, "log_mu_sd")
    source = "the measurement's noise" if metrics["noise_given"] else "noise, or physics that the model lacks,"
    scale = "" if metrics["force_scale_known"] else " Forces are known up to scale only, so the moduli are relative."
    held = metrics["error_mm"]["held_out"] or metrics["error_mm"]["training"]
    plain = metrics["error_mm_homogeneous"]["held_out"] or metrics["error_mm_homogeneous"]["training"]
    where = "on frames it never saw" if metrics["error_mm"]["held_out"] else "on the frames it was fitted to"
    return (
        f"Nine points in ten have a shear modulus of {mu['p5'] / 1e3:.3g} to {mu['p95'] / 1e3:.3g} kPa, at the median "
        f"point known to within a factor of {factor:.2g} (95 %); the simulation is "
        f"{held['mean']:.2f} mm from the measurement {where} (one homogeneous material: {plain['mean']:.2f} mm), "
        f"of which {source} makes about {unexplained:.2f} mm.{scale}{_resolution(metrics)}"
    )


def _factor(metrics: dict, name: str) -> float:
    """Within which mu of the median point is known (95 %)."""
    return float(np.exp(1.96 * metrics[name]["median"]))


def _resolution(metrics: dict) -> str:
    """Whether most of what is not known of the moduli is the discretisation's doing, a sentence to append."""
    whole, own = (metrics[name]["median"] for name in ("log_mu_sd", "log_mu_sd_of_discretisation"))
    if own**2 < whole**2 / 2:
        return ""
    return " Most of what is not known of the moduli is the simulation's own error, which more points would lessen."


def gained(metrics: dict) -> str:
    """What the field of moduli is worth on held-out frames, a sentence to append; empty where it was not measured."""
    found = metrics.get("gained_mm", {}).get("over_homogeneous")
    if found is None:
        return ""
    chance = "" if found["low"] > 0 else ", which may be chance"
    return (
        f" On held-out frames, learning the material point by point gained {found['mean']:.2f} mm over one homogeneous "
        f"material (95 %: {found['low']:.2f} to {found['high']:.2f} mm){chance}."
    )


def _write_object(result: Identification, observation: Observation, metrics: dict, folder: Path) -> None:
    obj, model = result.object, result.model
    attributes = {**obj.attributes, "metrics": metrics}
    forces = forces_of(observation, obj.cloud)
    error = np.linalg.norm(model.target.residual(model.y), axis=2)
    static = {**obj.static, "log_mu_sd": result.fit.log_mu_sd}
    with SequenceWriter(folder / "object.vtkhdf", static=static, attributes=attributes) as writer:
        for t, time in enumerate(observation.time):
            data = {"observed": observation.points[t], "forces": forces[t], "error": error[t]}
            writer.append(float(time), model.y[t], data)


def _pictures(result: Identification, observation: Observation, folder: Path) -> dict[str, Path]:
    obj, model = result.object, result.model
    shown = int(np.argmax(np.where(model.converged, result.rest.per_frame_mm, -1.0)))
    held = np.isin(np.arange(len(observation.time)), result.held_out)
    load = np.linalg.norm(forces_of(observation, obj.cloud), axis=2).sum(axis=1)
    error = 1e3 * np.linalg.norm(model.target.residual(model.y)[shown], axis=1)
    drawn = {
        "mu": lame_map(obj.x, obj.lame.mu, title="Shear modulus mu", up=obj.up),
        "lam": lame_map(obj.x, obj.lame.lam, title="First Lame parameter lam", up=obj.up),
        "sensitivity": sensitivity_map(obj.x, result.fit.determined, up=obj.up),
        "error": error_map(obj.x, model.per_point_mm, title="Mean error of each point", up=obj.up),
        "motion": frames_strip(
            np.stack([obj.x, model.y[shown]]), np.stack([np.zeros(len(obj.x)), error]), label="mm",
            captions=["at rest", f"simulated, t = {observation.time[shown]:.2f} s"], title="Largest motion", up=obj.up,
        ),
    }  # fmt: skip
    paths = {name: save_picture(plotter, folder / f"{name}.png") for name, plotter in drawn.items()}
    paths["over_time"] = error_over_time(
        observation.time, model.per_frame_mm, result.baseline.per_frame_mm, result.rest.per_frame_mm, held,
        1e3 * result.fit.state.sigma * np.sqrt(8 / np.pi), folder / "error_over_time.png", load=load,
    )  # fmt: skip
    paths["turntable"] = turntable(
        obj.x, obj.lame.mu / 1e3, folder / "mu.mp4", label="kPa", title="Shear modulus mu", log=True, up=obj.up
    )
    return paths


def _error_section(metrics: dict, pictures: dict[str, Path]) -> Section:
    rows = []
    for label, key in (
        ("per-point material", "error_mm"),
        ("one homogeneous material", "error_mm_homogeneous"),
        ("no change (rest pose)", "error_mm_no_change"),
    ):
        for part in ("training", "held_out"):
            if metrics[key][part] is not None:
                table = metrics[key][part]
                rows.append([label, part.replace("_", " "), table["mean"], table["p95"], table["max"]])
    if "error_mm_paper" in metrics:
        rows.append(["the paper's own simulation", "its validation frames", *metrics["error_mm_paper"].values()])
    columns = ["model", "frames", "mean [mm]", "95 % [mm]", "max [mm]"]
    text = "Distances between simulated and observed surface points, as in the paper's Table 1; smaller is better."
    text += gained(metrics)
    shown = [pictures["over_time"], pictures["motion"], pictures["error"]]
    return Section(heading="How far it is off", text=text, table=Table(columns=columns, rows=rows), pictures=shown)


def _material_section(result: Identification, metrics: dict, pictures: dict[str, Path]) -> Section:
    rows = [
        [name, *(metrics[key][part] / scale for part in ("min", "p5", "median", "p95", "max"))]
        for name, key, scale in (
            ("mu [kPa]", "mu_pa", 1e3), ("lam [kPa]", "lam_pa", 1e3), ("Young's modulus [kPa]", "young_pa", 1e3),
            ("Poisson's ratio", "poisson", 1.0),
        )
    ]  # fmt: skip
    text = "The material over the object: dark is soft, bright is stiff."
    table = Table(columns=["", "smallest", "5 %", "median", "95 %", "largest"], rows=rows)
    shown = [pictures[name] for name in ("mu", "lam", "turntable")]
    return Section(heading="The material", text=text, table=table, pictures=shown)


def _trust_section(result: Identification, metrics: dict, pictures: dict[str, Path]) -> Section:
    rows = [
        [f"noise per coordinate [mm], {'given' if metrics['noise_given'] else 'estimated'}", metrics["noise_mm"]],
        ["shear modulus of the median point, known to within a factor of (95 %)", _factor(metrics, "log_mu_sd")],
        ["the same, of the discretisation alone", _factor(metrics, "log_mu_sd_of_discretisation")],
        ["adjoint gradient against finite differences", f"{metrics['gradient_check']:.1e}"],
        ["Gauss-Newton steps", metrics["iterations"]],
        ["frames without equilibrium", len(metrics["frames"]["not_converged"])],
        ["seconds", metrics["seconds"]],
    ]
    text = (
        "Where the second picture is pale, the value is the prior's guess: no load strained that part enough to tell. "
        f"The fit {metrics['status']}."
    )
    table = Table(columns=["", ""], rows=rows)
    return Section(heading="How far to trust it", text=text, table=table, pictures=[pictures["sensitivity"]])
