"""Pictures of a coupon's diagnosis: fits, predictions of what was held out, evidence, gain, and the next test."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from veo_ti.coupons.curves import NAMES, Curve
from veo_ti.coupons.fit import Fit
from veo_ti.coupons.predict import LABELS, spread
from veo_ti.coupons.run import CouponDiagnosis
from veo_ti.coupons.separate import CLEAR
from veo_ti.plots import INK, LOAD, MODEL, PAPER, PLAIN, REST, saved

_SETS = 12  # of several causes, in the ranking


def draw_fits(diagnosis: CouponDiagnosis, path: Path) -> Path:
    """Every mode: the data (filled: fitted, open: held out), the Neo-Hookean law, what was found, and its rival."""
    found = diagnosis.found
    modes = [m for m in NAMES if any(c.mode == m for c in (*diagnosis.train, *diagnosis.held))]
    figure, panels = _panels(len(modes))
    for axes, mode in zip(panels, modes, strict=True):
        own = [c for c in (*diagnosis.train, *diagnosis.held) if c.mode == mode]
        whole = Curve(mode=mode, stretch=_line(own), stress=_line(own))
        _curve(axes, found.baseline.fit, whole, PLAIN, "--", "Neo-Hookean, refitted")
        if found.kind != "no_misfit" and found.best is not found.baseline:
            _curve(axes, found.best.fit, whole, MODEL, "-", found.best.name)
        if found.kind == "named":
            shown, sd = found.best.fit.stress(mode, whole.stretch), spread(found, whole)
            reach = np.stack([shown - 1.96 * sd, shown + 1.96 * sd]) / 1e6
            axes.fill_between(whole.stretch, *reach, color=MODEL, alpha=0.12, lw=0, label="95 %")
        for rival in found.rivals[:2]:
            _curve(axes, rival.fit, whole, LOAD, ":", f"rival: {rival.name}")
        _points(axes, [c for c in diagnosis.train if c.mode == mode], INK, "fitted")
        _points(axes, [c for c in diagnosis.held if c.mode == mode], "none", "held out")
        _finish(axes, own, NAMES[mode])
    _legend(figure, panels)
    return saved(figure, path)


def draw_predictions(diagnosis: CouponDiagnosis, path: Path) -> Path:
    """Every held-out curve as it was predicted by those that taught."""
    pairs = [(fold, curve) for fold in diagnosis.folds for curve in fold.held]
    figure, panels = _panels(len(pairs))
    for axes, (fold, curve) in zip(panels, pairs, strict=True):
        whole = Curve(mode=curve.mode, stretch=_line([curve]), stress=_line([curve]))
        _curve(axes, fold.found.baseline.fit, whole, PLAIN, "--", LABELS["refit_only"])
        if fold.found.kind == "named":
            shown, sd = fold.found.best.fit.stress(curve.mode, whole.stretch), spread(fold.found, whole)
            _curve(axes, fold.found.best.fit, whole, MODEL, "-", "predicted with the named causes")
            reach = np.stack([shown - 1.96 * sd, shown + 1.96 * sd]) / 1e6
            axes.fill_between(whole.stretch, *reach, color=MODEL, alpha=0.12, lw=0, label="95 %")
        else:
            for c in (fold.found.best, *fold.found.rivals) if fold.found.kind == "ambiguous" else ():
                _curve(axes, c.fit, whole, LOAD, ":", "explanations that training cannot tell apart")
        _points(axes, [curve], "none", "held out")
        taught = ", ".join(c.mode for c in fold.train)
        _finish(axes, [curve], f"{NAMES[curve.mode]}, predicted from {taught}: {fold.found.best.name}")
    _legend(figure, panels)
    return saved(figure, path)


def draw_ranking(diagnosis: CouponDiagnosis, path: Path) -> Path:
    """Evidence over the Neo-Hookean law of every cause and set."""
    found = diagnosis.found
    sets = [c for c in found.candidates if len(c.fit.model.causes) > 1]
    shown = sorted([*found.singles, *sets[:_SETS]], key=lambda c: c.gained)
    told = {found.best.name, *(r.name for r in found.rivals)} if found.kind in ("named", "ambiguous") else set()
    figure = Figure(figsize=(9.0, 1.2 + 0.27 * len(shown)), dpi=160, layout="constrained", facecolor=PAPER)
    axes = figure.add_subplot(facecolor=PAPER)
    colours = [MODEL if c.name in told else REST if c.fit.plausible else "#e4d9d5" for c in shown]
    axes.barh([c.name for c in shown], [c.gained for c in shown], 0.68, color=colours)
    axes.axvline(0, color=INK, lw=0.9)
    _dress(axes, "Evidence over the Neo-Hookean law [nats]; green: told, pale: wrong sign")
    return saved(figure, path)


def draw_gain(diagnosis: CouponDiagnosis, path: Path) -> Path:
    """Errors on held-out data by every way of predicting."""
    errors = {LABELS[key]: 100 * value for key, value in diagnosis.gain.errors.items() if np.isfinite(value)}
    figure = Figure(figsize=(9.0, 2.6), dpi=160, layout="constrained", facecolor=PAPER)
    axes = figure.add_subplot(facecolor=PAPER)
    colours = [
        MODEL if label == LABELS["after"] else PLAIN if label == LABELS["refit_only"] else REST for label in errors
    ]
    bars = axes.barh(list(errors), list(errors.values()), 0.62, color=colours)
    axes.bar_label(bars, fmt="%.3g", padding=4, fontsize=8, color=INK)
    axes.invert_yaxis()
    axes.margins(x=0.1)
    _dress(axes, "Root mean square error on held-out data [% of the stress]")
    return saved(figure, path)


def draw_library(diagnosis: CouponDiagnosis, path: Path) -> Path:
    """How far further tests would part the two best explanations."""
    figure = Figure(figsize=(7.5, 3.8), dpi=160, layout="constrained", facecolor=PAPER)
    axes = figure.add_subplot(facecolor=PAPER)
    for mode, colour in zip(NAMES, (INK, MODEL, PLAIN), strict=True):
        own = sorted((e for e in diagnosis.library if e.mode == mode), key=lambda e: e.stretch)
        axes.plot([e.stretch for e in own], [e.separation for e in own], "o-", color=colour, ms=5, label=NAMES[mode])
    axes.set_xlabel("largest stretch of the test", color=INK)
    axes.axhline(CLEAR, color=INK, lw=0.8, ls=":")
    axes.legend(frameon=False, fontsize=8, labelcolor=INK)
    _dress(axes, f"{diagnosis.found.best.name} against {diagnosis.rival.name}: standard deviations apart")
    return saved(figure, path)


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(max(4.2 * count, 6.0), 4.2), dpi=140, layout="constrained", facecolor=PAPER)
    return figure, list(np.ravel(figure.subplots(1, count, subplot_kw={"facecolor": PAPER})))


def _line(curves: list[Curve]) -> np.ndarray:
    ends = [c.stretch for c in curves]
    low, high = min(e.min() for e in ends), max(e.max() for e in ends)
    return np.linspace(min(low, 1.0), max(high, 1.0), 160)


def _curve(axes: Axes, fit: Fit, at: Curve, colour: str, style: str, label: str) -> None:
    axes.plot(at.stretch, fit.stress(at.mode, at.stretch) / 1e6, color=colour, ls=style, lw=1.6, label=label)


def _points(axes: Axes, curves: list[Curve], face: str, label: str) -> None:
    for c in curves:
        axes.scatter(c.stretch, c.stress / 1e6, s=16, facecolors=face, edgecolors=INK, lw=0.9, label=label, zorder=4)


def _finish(axes: Axes, curves: list[Curve], title: str) -> None:
    top = max(float(c.stress.max()) for c in curves) / 1e6
    low = min(0.0, *(float(c.stress.min()) for c in curves)) / 1e6
    axes.set_ylim(low - 0.05 * top, 1.25 * top)
    axes.set_xlabel("stretch", color=INK)
    _dress(axes, f"{title} [MPa]")


def _legend(figure: Figure, panels: list[Axes]) -> None:
    found = {}
    for axes in panels:
        found |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(
        found.values(), found.keys(), loc="outside lower center", ncols=4, frameon=False, fontsize=8, labelcolor=INK
    )


def _dress(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", color=INK, fontsize=9)
    axes.grid(color="#dddddd", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(colors=INK, length=0, labelsize=8)
    axes.spines[:].set_visible(False)
