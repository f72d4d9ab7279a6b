"""Pictures of the beam's motion: measured, quasi-static and named model; errors over time; evidence; gain."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from veo_ti.beam_dynamics.fitting import FREE
from veo_ti.beam_dynamics.heldout import READ
from veo_ti.beam_dynamics.judge import representatives
from veo_ti.beam_dynamics.run import BeamDiagnosis
from veo_ti.plots import INK, LOAD, MODEL, PAPER, PLAIN, REST, saved


def draw_all(d: BeamDiagnosis, folder: Path) -> dict[str, Path]:
    """Every picture that there is something to show in, as .png files in the folder."""
    paths = {
        "tip": tip_over_time(d, folder / "tip_over_time.png"),
        "error": error_over_time(d, folder / "error_over_time.png"),
        "evidence": evidence(d, folder / "evidence.png"),
    }
    if d.gain is not None:
        paths["gain"] = gain(d, folder / "gain.png")
    if d.ringing:
        paths["ringing"] = ringing(d, folder / "ringing.png")
    return paths


def tip_over_time(d: BeamDiagnosis, path: Path) -> Path:
    """Tip height over the settled one in every take."""
    figure, axes = _grid(len(d.releases), (11.0, 6.4))
    for one, r in zip(axes, d.releases, strict=True):
        held = 1e3 * r.tip[0]
        one.plot([r.time[0], 0, 0, r.time[-1]], [held, held, 0, 0], color=PLAIN, lw=1.5, label="quasi-static")
        one.plot(r.time, 1e3 * d.shown[r.name][:, :, 2].mean(axis=1), color=MODEL, lw=2.2, label="best hypothesis")
        one.plot(r.time, 1e3 * r.tip, color=INK, lw=0, marker=".", ms=3.2, label="measured")
        _mark(one, r in d.unseen)
        _dress(one, f"{r.label}{', not fitted' if r in d.unseen else ''}: tip over its settled height [mm]")
    _legend(figure, axes[0])
    return saved(figure, path)


def error_over_time(d: BeamDiagnosis, path: Path) -> Path:
    """Mean distance of the tip markers from each model, frame by frame."""
    figure, axes = _grid(len(d.releases), (11.0, 6.4))
    for one, r in zip(axes, d.releases, strict=True):
        before = np.where((r.time > 0)[:, None, None], r.w, r.w - r.w[0])
        for label, left, colour in (("quasi-static", before, PLAIN), ("best hypothesis", r.w - d.shown[r.name], MODEL)):
            one.plot(r.time, 1e3 * np.linalg.norm(left, axis=2).mean(axis=1), color=colour, lw=1.8, label=label)
        one.plot(r.time, 1e3 * np.abs(r.w[:, :, 1]).mean(axis=1), color=LOAD, lw=1, label="motion across the plane")
        one.set_yscale("log")
        one.set_ylim(5e-3, 40)
        _mark(one, r in d.unseen)
        _dress(one, f"{r.label}{', not fitted' if r in d.unseen else ''}: distance from the measurement [mm]")
    _legend(figure, axes[0])
    return saved(figure, path)


def evidence(d: BeamDiagnosis, path: Path) -> Path:
    """Log evidence of the telling hypotheses over the quasi-static model, and what they leave."""
    j = d.judgement
    shown, zero = representatives(j, d.fits), j.baseline.evidence(j.effective)
    figure = Figure(figsize=(11.0, 1.3 + 0.27 * len(shown)), dpi=160, layout="constrained", facecolor=PAPER)
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.6, 1), subplot_kw={"facecolor": PAPER})
    rows, colours = np.arange(len(shown)), [MODEL if f is j.best else REST for f in shown]
    left.barh(rows, [f.evidence(j.effective) - zero for f in shown], 0.68, color=colours)
    left.axvline(0, color=INK, lw=0.9)
    left.set_yticks(rows, [f.hypothesis.label for f in shown])
    left.set_ylim(len(shown) - 0.4, -0.6)
    _dress(left, "Log evidence over quasi-static [nats]", "x")
    right.barh(rows, [1e3 * f.sigma for f in shown], 0.68, color=colours)
    right.axvline(1e3 * d.setting.tolerance, color=INK, lw=1, ls=":", label="settled poses")
    right.legend(frameon=False, fontsize=8, labelcolor=INK, loc="upper right")
    _dress(right, "What it leaves [mm]", "x")
    return saved(figure, path)


def gain(d: BeamDiagnosis, path: Path) -> Path:
    """Errors on the unseen takes."""
    g = d.gain
    bars = [("no change (held pose)", g.no_change, REST), ("hold the residual at 0.3 s", g.hold_residual, REST),
            ("quasi-static", g.quasi_static, PLAIN), ("quasi-static, refitted", g.refit_only, PLAIN),
            ("replay the other take", g.replay, REST), ("best hypothesis", g.after, MODEL),
            ("motion across the plane, in no model", g.lateral, LOAD)]  # fmt: skip
    figure = Figure(figsize=(9.0, 3.6), dpi=160, layout="constrained", facecolor=PAPER)
    axes = figure.add_subplot(facecolor=PAPER)
    axes.barh([b[0] for b in bars], [b[1] for b in bars], 0.62, color=[b[2] for b in bars])
    for row, (_, value, _) in enumerate(bars):
        axes.annotate(f"{value:.2g}", (value, row), (6, -3), textcoords="offset points", fontsize=8, color=INK)
    axes.invert_yaxis()
    axes.margins(x=0.08)
    _dress(axes, "Error per coordinate on takes that no fit saw, after their first 0.3 s [mm]", "x")
    return saved(figure, path)


def ringing(d: BeamDiagnosis, path: Path) -> Path:
    """Frequency against damping ratio, measured and predicted, with 95 % intervals."""
    figure, axes = _grid(2, (9.0, 3.4))
    names = list(d.ringing)
    labels = [next(r.label for r in d.releases if r.name == name) for name in names]
    rows = np.arange(len(names))
    for one, title, key in ((axes[0], "Frequency [Hz]", "frequency"), (axes[1], "Damping ratio [-]", "ratio")):
        found = [d.ringing[name] for name in names]
        measured = [(getattr(f.measured, key), getattr(f.measured, f"{key}_sd")) for f in found]
        model = [(getattr(f.predicted, key), getattr(f, f"{key}_sd")) for f in found]
        sides = ((-0.12, measured, INK, "measured"), (0.12, model, MODEL, "best hypothesis"))
        for shift, pairs, colour, label in sides:
            value, sd = np.array(pairs).T
            one.errorbar(value, rows + shift, xerr=1.96 * sd, fmt="o", ms=4, color=colour, capsize=3, label=label)
        one.set_yticks(rows, labels)
        one.set_ylim(len(rows) - 0.5, -0.5)
        _dress(one, title, "x")
    _legend(figure, axes[0])
    return saved(figure, path)


def _grid(count: int, size: tuple[float, float]) -> tuple[Figure, Sequence[Axes]]:
    figure = Figure(figsize=size, dpi=160, layout="constrained", facecolor=PAPER)
    rows = (count + 1) // 2
    axes = np.ravel(figure.subplots(rows, min(count, 2), squeeze=False, subplot_kw={"facecolor": PAPER}))
    for spare in axes[count:]:
        spare.set_axis_off()
    return figure, axes[:count]


def _mark(axes: Axes, unseen: bool) -> None:
    """Shade what no fit looked at: the first tenth of a second, and in unseen takes what was predicted."""
    axes.axvspan(0, FREE, color=LOAD, alpha=0.16, lw=0, label="the hand lets go: not judged")
    if unseen:
        axes.axvspan(READ, 1e3, color=INK, alpha=0.05, lw=0)
    low, high = axes.dataLim.x0, axes.dataLim.x1
    axes.set_xlim(low, min(high, 1.5))
    axes.set_xlabel("time after the release [s]", color=INK, fontsize=9)


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=8, labelcolor=INK)


def _dress(axes: Axes, title: str, grid: str = "both") -> None:
    axes.set_title(title, loc="left", color=INK, fontsize=10)
    axes.grid(axis=grid, color="#dddddd", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(colors=INK, length=0, labelsize=8)
    axes.spines[:].set_visible(False)
