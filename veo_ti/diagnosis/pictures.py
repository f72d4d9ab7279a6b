"""Pictures of a diagnosis: where and when the simulation is off, what each cause has for it, what it gained."""

from pathlib import Path

import numpy as np
import pyvista as pv
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from veo_ti.diagnosis.missing import MissingForce, missing_force, worst_frame
from veo_ti.diagnosis.run import Diagnosis
from veo_ti.diagnosis.scene import Scene
from veo_ti.plots import INK, MODEL, PAPER, PLAIN, REST, curves_over_time, saved
from veo_ti.stage import Colours, add_arrows, add_bar, add_spheres, limits_of, set_up, spacing_of, write
from veo_ti.view import RADIUS, error_map, frames_strip, save_picture
from veo_ti.viewpoint import look_at

_LONGEST = 0.28  # of the object's longest side
_SHORTEST = 0.2  # of the longest arrow: shorter ones are left out


def per_point_mm(scene: Scene, shown: np.ndarray) -> np.ndarray:
    """Mean distance of each point from what was observed, over the frames that saw it, (N,) [mm]."""
    distance = np.linalg.norm(scene.target.residual(shown), axis=2)
    return 1e3 * distance.sum(axis=0) / np.maximum(scene.target.seen.sum(axis=0), 1)


def per_frame_mm(scene: Scene, shown: np.ndarray) -> np.ndarray:
    """The same of each frame, (T,) [mm]."""
    distance = np.linalg.norm(scene.target.residual(shown), axis=2)
    return 1e3 * distance.sum(axis=1) / np.maximum(scene.target.seen.sum(axis=1), 1)


def residual_map(diagnosis: Diagnosis) -> pv.Plotter:
    """The residual on the object, beside what is left of it where a cause was named."""
    scene = diagnosis.baseline.scene
    x, before = scene.cloud.x, per_point_mm(scene, diagnosis.baseline.shown)
    if not diagnosis.named:
        return error_map(x, before, title="Mean distance from the measurement", up=diagnosis.identification.object.up)
    after = per_point_mm(scene, diagnosis.final.shown)
    names = " and ".join(c.name.replace("_", " ") for c in diagnosis.named)
    return frames_strip(
        np.stack([x, x]), np.stack([before, after]), label="mm", captions=["before", f"with {names}"],
        title="Mean distance from the measurement", up=diagnosis.identification.object.up,
    )  # fmt: skip


def residual_over_time(diagnosis: Diagnosis, path: Path) -> Path:
    """The residual of every frame, before and with the named causes, over the load."""
    scene = diagnosis.baseline.scene
    curves = {"before": (per_frame_mm(scene, diagnosis.baseline.shown), PLAIN if diagnosis.named else MODEL, 2.0)}
    if diagnosis.named:
        curves["with the named cause"] = (per_frame_mm(scene, diagnosis.final.shown), MODEL, 2.4)
    noise = 1e3 * diagnosis.noise.sigma * np.sqrt(8 / np.pi)  # mean length of a vector of three such numbers
    held = ~scene.train & scene.target.seen.any(axis=1)
    return curves_over_time(
        scene.time, curves, held, noise, path, load=scene.total_force, title="Distance from the measurement over time"
    )


def ranking(diagnosis: Diagnosis, path: Path) -> Path:
    """Evidence for (right) and against (left) every cause, and how much of its fingerprint the material leaves."""
    first = diagnosis.rounds[0]
    scores = first.scores[::-1]
    figure = Figure(figsize=(9.6, 1.5 + 0.29 * len(scores)), dpi=160, layout="constrained", facecolor=PAPER)
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(2.2, 1), subplot_kw={"facecolor": PAPER})
    told = {c.name for c in first.verdict.causes}
    colours = [MODEL if s.name in told else REST for s in scores]
    rows = np.arange(len(scores))
    left.barh(rows, [s.log_bayes for s in scores], 0.68, color=colours, label="first-order score")
    place = {s.name: row for s, row in zip(scores, rows, strict=True)}
    if first.candidates:
        gained = [c.gained for c in first.candidates]
        left.scatter(gained, [place[c.name] for c in first.candidates], s=42, marker="D", color=PLAIN,
                     edgecolor=PAPER, zorder=4, label="after a full refit")  # fmt: skip
    left.set_xscale("symlog", linthresh=3, linscale=0.8)
    low, high = left.get_xlim()
    ticks = [t for t in (-300, -100, -30, -10, -3, 0, 3, 10, 30, 100, 300, 1000, 3000, 10000) if low <= t <= high]
    left.set_xticks(ticks, [str(t) for t in ticks])
    left.set_xticks([], minor=True)
    left.axvline(0, color=INK, lw=0.9)
    left.set_yticks(rows, [s.name.replace("_", " ") for s in scores])
    _dress(left, "Log Bayes factor: against | for [nats]")
    figure.legend(loc="outside lower left", ncols=2, frameon=False, fontsize=8, labelcolor=INK)
    right.barh(rows, [100 * s.keep for s in scores], 0.68, color=colours)
    right.set_xlim(0, 100)
    _dress(right, "What the material cannot imitate [%]")
    return saved(figure, path)


def gain(diagnosis: Diagnosis, path: Path) -> Path:
    """Held-out errors of every model as bars, and under them what the cause gained."""
    g = diagnosis.gain
    bars = [("no change (rest pose)", g.no_change_mm, REST), ("one homogeneous material", g.homogeneous_mm, REST),
            ("hold the last residual", g.hold_residual_mm, REST), ("refit only", g.before_mm, PLAIN)]  # fmt: skip
    if diagnosis.named:
        bars.append(("with the named cause", g.after_mm, MODEL))
    figure = Figure(figsize=(9.0, 1.4 + 0.42 * len(bars)), dpi=160, layout="constrained", facecolor=PAPER)
    axes = figure.add_subplot(facecolor=PAPER)
    axes.barh([b[0] for b in bars], [b[1] for b in bars], 0.62, color=[b[2] for b in bars])
    ends = [b[1] for b in bars]
    if diagnosis.named:
        value, low, high = g.gained_mm
        axes.errorbar(
            [value], ["gained, with 95 % interval"], xerr=[[max(value - low, 0.0)], [max(high - value, 0.0)]], fmt="o",
            color=MODEL, ecolor=INK, capsize=4, lw=1.4,
        )  # fmt: skip
        ends.append(value)
    for row, value in enumerate(ends):
        axes.annotate(f"{value:.3g}", (value, row), (7, 7), textcoords="offset points", fontsize=8, color=INK)
    axes.invert_yaxis()
    axes.margins(x=0.08)
    axes.axvline(g.noise_mm, color=INK, lw=1, ls=":", label=f"noise, {g.noise_mm:.2g} mm")
    axes.legend(frameon=False, fontsize=8, labelcolor=INK, loc="lower right")
    _dress(axes, "Error per coordinate on frames that chose nothing [mm]")
    return saved(figure, path)


def missing_force_picture(diagnosis: Diagnosis) -> pv.Plotter:
    """Arrows of the missing force at the frame of largest misfit, on the object coloured by that frame's residual."""
    scene, shown = diagnosis.baseline.scene, diagnosis.baseline.shown
    frame = worst_frame(scene, shown)
    variance = diagnosis.noise.sigma**2 * diagnosis.noise.correlation
    found = missing_force(diagnosis.identification, scene, shown, variance, frame)
    residual = 1e3 * np.linalg.norm(scene.target.residual(shown)[frame], axis=1)
    return force_picture(scene, found, residual, diagnosis.identification.object.up)


def force_picture(scene: Scene, found: MissingForce, residual_mm: np.ndarray, up: np.ndarray) -> pv.Plotter:
    """Arrows at their spots, outside the body; residual_mm (N,) colours the points of that frame."""
    y, radius = scene.y[found.frame], RADIUS * spacing_of(scene.y[found.frame])
    tails, arrows = _outside(scene, found, y, radius)
    view = look_at(np.concatenate([y, tails, tails + arrows]), up=up, pad=radius, like=y)
    time, load = scene.time[found.frame], scene.total_force[found.frame]
    stage = set_up(view, f"Missing force, t = {time:.2f} s under {load:.3g} N")
    colours = Colours(label="mm off", limits=limits_of(residual_mm, zero=True), colormap="YlOrRd", span=(0.02, 0.8))
    add_spheres(stage, y, residual_mm, colours, radius=radius)
    add_arrows(stage, tails, arrows, thickness=0.45 * radius)
    add_bar(stage, colours)
    size = np.linalg.norm(found.force, axis=1).max()
    write(stage, f"longest arrow {size:.2g} N, all together {np.linalg.norm(found.total):.2g} N", (40, 22))
    return stage


def _outside(scene: Scene, found: MissingForce, y: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Tails and arrows (M, 3) [m]: what pushes inwards ends at the surface, what pulls outwards begins there."""
    size = np.linalg.norm(found.force, axis=1)
    drawn = size > _SHORTEST * max(float(size.max()), 1e-300)
    arrows = found.force[drawn] * _LONGEST * scene.extent / max(float(size.max()), 1e-300)
    spots = found.spots[drawn]
    area = np.einsum("nba,nb->na", np.linalg.inv(scene.F[found.frame, spots]), scene.cloud.area[spots])
    normals = area / np.maximum(np.linalg.norm(area, axis=1, keepdims=True), 1e-300)
    at = y[spots] + radius * normals
    inwards = (arrows * normals).sum(axis=1) < 0
    return np.where(inwards[:, None], at - arrows, at), arrows


def draw_all(diagnosis: Diagnosis, folder: Path) -> dict[str, Path]:
    """Every picture that the diagnosis has something to show in, as .png files in the folder."""
    paths = {
        "residual": save_picture(residual_map(diagnosis), folder / "residual.png"),
        "over_time": residual_over_time(diagnosis, folder / "residual_over_time.png"),
        "ranking": ranking(diagnosis, folder / "ranking.png"),
    }
    if diagnosis.verdict.kind != "no_misfit":
        paths["missing_force"] = save_picture(missing_force_picture(diagnosis), folder / "missing_force.png")
    if diagnosis.gain is not None:
        paths["gain"] = gain(diagnosis, folder / "gain.png")
    return paths


def _dress(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", color=INK, fontsize=10)
    axes.grid(axis="x", color="#dddddd", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(colors=INK, length=0, labelsize=9)
    axes.spines[:].set_visible(False)
