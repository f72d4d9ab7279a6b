"""What the beam's identification is shown as: numbers, pictures and one page."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from recon.files import replacing
from recon.metrics import DistanceTable, distance_table
from veo_ti.beam import CLOUDS, PUBLISHED, PUBLISHED_DROP_MM, BeamResult, identify_beam, read_settled
from veo_ti.plots import INK, LOAD, MODEL, PAPER, PLAIN, REST
from veo_ti.report import Section, Table, write_report
from veo_ti.store import writable_folder, write_json_atomic
from veo_ti.view import frames_strip, save_picture

HUES = (MODEL, PLAIN, LOAD)
FITTED = {"all": "both a takes", "gravity_V2_a": "gravity a only", "load52_V2_a": "52 g a only"}


def run_beam(folder: str | Path, out: str | Path, *, clouds: Mapping[int, int] = CLOUDS) -> dict[str, object]:
    """Identify the beam of a folder of beam_*.npz takes; metrics.json, pictures and report.html go to `out`.

    Returns the metrics. Raises ValueError in one sentence for a folder without takes or one that cannot be written.
    """
    takes = read_settled(folder)
    out = writable_folder(out)
    result = identify_beam(takes, clouds=clouds)
    metrics = metrics_of(result)
    write_json_atomic(out / "metrics.json", metrics)
    pictures = [
        draw_drops(result, out / "tip_drop.png"),
        draw_side_view(result, out / "side_view.png"),
        draw_refinement(result, out / "refinement.png"),
        draw_bent(result, out / "bent_beam.png"),
    ]
    write_page(result, metrics, pictures, out / "report.html")
    return metrics


def metrics_of(result: BeamResult) -> dict[str, object]:
    """The numbers of `metrics.json`."""
    low, high = result.young.bounds
    lame = {"mu_pa": result.young.value / (2 * (1 + result.joint.poisson))}
    lame["lam_pa"] = lame["mu_pa"] * 2 * result.joint.poisson / (1 - 2 * result.joint.poisson)
    noise = float(np.mean([take.noise for take in result.takes.values()]))
    held_out = [name for name in result.predicted["all"] if name not in result.train]
    return {
        "young_pa": {"value": result.young.value, "low": low, "high": high, "published": PUBLISHED},
        "young_relative_sd": dict(result.young.parts), "young_pa_each_take": _scaled(result, result.single),
        "young_pa_by_cloud": [asdict(cloud) for cloud in result.refinement],
        "poisson_fixed": result.joint.poisson, "discretisation_factor": result.factor,
        "tip_drop_mm": {name: _drops(result, name) for name in result.predicted["all"]},
        "error_mm": {"training": _table(result, result.train), "held_out": _table(result, held_out)},
        "error_mm_no_change": {
            "training": _table(result, result.train, rest=True), "held_out": _table(result, held_out, rest=True)
        },
        "noise_mm": 1e3 * noise, "creep_mm_per_s": {n: 1e3 * t.creep for n, t in result.takes.items()},
        "base_moved_mm": {n: (1e3 * t.base).tolist() for n, t in result.takes.items()},
        "gradient_check": result.slope_error, "iterations": result.joint.steps, "status": "every equilibrium converged",
        "seconds": result.seconds, **{k: {"min": v, "median": v, "max": v} for k, v in lame.items()},
    }  # fmt: skip


def _scaled(result: BeamResult, young: dict[str, float]) -> dict[str, float]:
    return {name: value * result.factor for name, value in young.items()}


def _drops(result: BeamResult, take: str) -> dict[str, object]:
    predicted = {FITTED.get(name, name): _mm(part[take]) for name, part in result.predicted.items()}
    published = PUBLISHED_DROP_MM.get(result.takes[take].kind)
    return {"measured": result.takes[take].drop_mm, "predicted_from": predicted, "published_model": published}


def _mm(displacement: np.ndarray) -> float:
    return 1e3 * float(displacement[:, 2].mean())


def _table(result: BeamResult, names: Sequence[str], *, rest: bool = False) -> dict[str, float] | None:
    if not len(names):
        return None
    measured = np.stack([result.takes[name].displacement for name in names])
    predicted = np.zeros_like(measured) if rest else np.stack([result.predicted["all"][name] for name in names])
    table: DistanceTable = distance_table(predicted, measured)
    return {"mean": table.mean_mm, "p95": table.p95_mm, "max": table.max_mm}


def draw_drops(result: BeamResult, path: Path) -> Path:
    """Measured and predicted tip drops of every take, and how far each prediction is off."""
    figure, (left, right) = _figure(2, (10.5, 4.4))
    names = list(result.predicted["all"])
    place = np.arange(len(names))
    measured = np.array([result.takes[name].drop_mm for name in names])
    left.scatter(place, measured, s=110, color=INK, marker="_", lw=3, label="measured")
    for offset, hue, (fitted, part) in zip((-0.18, 0, 0.18), HUES, result.predicted.items(), strict=False):
        drops = np.array([_mm(part[name]) for name in names])
        seen = [name in (result.train if fitted == "all" else (fitted,)) for name in names]
        left.scatter(place + offset, drops, s=30, color=hue, label=f"fitted to {FITTED.get(fitted, fitted)}", zorder=3)
        fill = [REST if used else hue for used in seen]
        right.bar(place + offset, drops - measured, 0.16, color=fill, edgecolor=hue, lw=1.2)
    right.axhline(0, color=INK, lw=0.8)
    for axes, title in ((left, "Tip drop [mm]"), (right, "Predicted minus measured [mm]; grey: used in that fit")):
        axes.set_xticks(place, [name.replace("_V2_", " ").replace("load52", "52 g") for name in names])
        _dress(axes, title)
    left.legend(frameon=False, fontsize=8, labelcolor=INK)
    return _saved(figure, path)


def draw_side_view(result: BeamResult, path: Path) -> Path:
    """The middle of the beam from the side, straight and settled, with the markers measured and predicted."""
    figure, axes = _figure(len(result.train), (10.5, 3.6))
    x = result.model.cloud.x
    near = np.flatnonzero(np.abs(x[:, 1] - 0.015) < 1.2 * result.model.cloud.spacing)
    for one, name, y in zip(np.ravel(axes), result.train, result.joint.y, strict=True):
        take = result.takes[name]
        simulated, measured = (1e3 * (take.held + d) for d in (result.predicted["all"][name], take.displacement))
        one.scatter(*(1e3 * x[near][:, [0, 2]]).T, s=7, color=REST, lw=0, label="straight")
        one.scatter(*(1e3 * y[near][:, [0, 2]]).T, s=7, color=MODEL, lw=0, label="simulated")
        one.scatter(*simulated[:, [0, 2]].T, s=70, facecolors="none", edgecolors=MODEL, label="marker, simulated")
        one.scatter(*measured[:, [0, 2]].T, s=45, color=INK, marker="x", label="marker, measured")
        one.set_aspect("equal")
        one.set_xlabel("x [mm]", color=INK)
        _dress(one, f"{name.replace('_V2_', ' ').replace('load52', '52 g')}: side view, z [mm]")
    handles, labels = np.ravel(axes)[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=8, labelcolor=INK)
    return _saved(figure, path)


def draw_refinement(result: BeamResult, path: Path) -> Path:
    """E against the square of the spacing, with its limit, its interval and the published value."""
    figure, axes = _figure(1, (7.0, 4.4))
    h, young = np.array([(cloud.spacing, cloud.young) for cloud in result.refinement]).T
    slope, limit = np.polyfit(h**2, np.log(young), 1)
    line = np.linspace(0, 1.05 * (h**2).max(), 50)
    axes.plot(1e6 * line, 1e-3 * np.exp(limit + slope * line), color=MODEL, lw=1.4, label="log E = log E0 + b h²")
    axes.scatter(1e6 * h**2, 1e-3 * young, s=40, color=MODEL, zorder=3)
    for cloud in {cloud.points: cloud for cloud in result.refinement}.values():
        place = (1e6 * cloud.spacing**2, 1e-3 * cloud.young)
        axes.annotate(f"{cloud.points} points", place, (8, 4), textcoords="offset points", fontsize=8, color=INK)
    axes.set_xlim(right=1.2e6 * (h**2).max())
    kilo, (low, high) = result.young.value / 1e3, np.array(result.young.bounds) / 1e3
    reach, label = [[kilo - low], [high - kilo]], "E at zero spacing, 95 % interval"
    axes.errorbar([0], [kilo], reach, color=INK, fmt="o", capsize=4, label=label)
    axes.axhline(PUBLISHED / 1e3, color=PLAIN, lw=1.2, ls="--", label="published, 263.8 kPa")
    axes.set_xlabel("squared spacing [mm²]", color=INK)
    axes.legend(frameon=False, fontsize=8, labelcolor=INK)
    _dress(axes, "Young's modulus fitted on finer and finer clouds [kPa]")
    return _saved(figure, path)


def draw_bent(result: BeamResult, path: Path) -> Path:
    """The straight beam and its simulated settled poses, coloured by displacement."""
    poses = np.concatenate([result.model.cloud.x[None], result.joint.y])
    moved = 1e3 * np.linalg.norm(poses - poses[0], axis=2)
    captions = ["straight", *(name.replace("_V2_", " ").replace("load52", "52 g") for name in result.train)]
    return save_picture(frames_strip(poses, moved, label="mm", captions=captions, title="Displacement"), path)


def _figure(columns: int, size: tuple[float, float]) -> tuple[Figure, np.ndarray | Axes]:
    figure = Figure(figsize=size, dpi=160, layout="constrained", facecolor=PAPER)
    return figure, figure.subplots(1, columns, subplot_kw={"facecolor": PAPER})


def _dress(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", color=INK, fontsize=10)
    axes.grid(color="#dddddd", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(colors=INK, length=0)
    axes.spines[:].set_visible(False)


def _saved(figure: Figure, path: Path) -> Path:
    with replacing(path) as partial:
        FigureCanvasAgg(figure).print_figure(partial)
    return path


def write_page(result: BeamResult, metrics: dict[str, object], pictures: Sequence[Path], path: Path) -> Path:
    """The result as one page."""
    predictions = Section(
        heading="Tip drop, measured and predicted",
        text="Mean vertical displacement of the three tip markers in mm. Each column is one fit; takes that it did not "
        "see are predictions.",
        table=_drop_table(metrics["tip_drop_mm"]),
        pictures=[pictures[0], pictures[1], pictures[3]],
    )
    sections = [predictions, _interval_section(result, pictures[2])]
    return write_report(path, "Silicone beam", sentence_of(result), sections)


def sentence_of(result: BeamResult) -> str:
    """The result in one sentence."""
    low, high = (bound / 1e3 for bound in result.young.bounds)
    return (
        f"Young's modulus of the silicone beam is {result.young.value / 1e3:.0f} kPa, 95 % interval {low:.0f} to "
        f"{high:.0f} kPa (published: {PUBLISHED / 1e3:.1f} kPa), at Poisson's ratio {result.joint.poisson}."
    )


def _drop_table(drops: dict[str, dict]) -> Table:
    fitted = next(iter(drops.values()))["predicted_from"]
    columns = ["take", "measured", *(f"from {name}" for name in fitted), "published model"]
    rows = [[n, d["measured"], *d["predicted_from"].values(), d["published_model"] or ""] for n, d in drops.items()]
    return Table(columns=columns, rows=rows)


def _interval_section(result: BeamResult, picture: Path) -> Section:
    parts = [[name, f"{100 * part:.1f} %"] for name, part in result.young.parts.items()]
    return Section(
        heading="Where the interval comes from",
        text="Relative standard uncertainties, taken as independent; the interval is two of their root sum of squares. "
        "'Between loads' is half of the disagreement between the two takes fitted alone. "
        "'Discretisation' is half of the step from the finest cloud to zero spacing.",
        table=Table(columns=["part", "of E"], rows=[*parts, ["together", f"{100 * result.young.relative_sd:.1f} %"]]),
        pictures=[picture],
    )
