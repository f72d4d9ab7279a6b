"""Curves over time, drawn without a display and written straight to a file."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from recon.files import replacing
from sim.checks import as_array

INK, MODEL, PLAIN, REST, LOAD, PAPER = "#2b2d33", "#0b7a75", "#e08e1b", "#a6a8ad", "#6f7fb5", "#fbfbf9"


def error_over_time(time: np.ndarray, model_mm: np.ndarray, homogeneous_mm: np.ndarray, rest_mm: np.ndarray,
                    held_out: np.ndarray, noise_mm: float | None, path: str | Path, *,
                    load: np.ndarray | None = None, load_label: str = "applied force [N]",
                    title: str = "Distance between model and measurement") -> Path:
    """The mean error of each frame for the model, for one homogeneous material and for no change at all.

    time (T,) [s]; the errors (T,) [mm]; held_out (T,) bool: frames the fit never saw, shaded; noise_mm: of the
    measurement itself, dotted; load (T,) e.g. [N], on the right axis. Returns the path written (.png, .svg or .pdf).
    Raises ValueError on wrong shapes or NaN.
    """
    curves = {"per-point material": (model_mm, MODEL, 2.4), "one homogeneous material": (homogeneous_mm, PLAIN, 1.6),
              "no change (rest pose)": (rest_mm, REST, 1.6)}
    return curves_over_time(time, curves, held_out, noise_mm, path, load=load, load_label=load_label, title=title)


def curves_over_time(time: np.ndarray, curves: Mapping[str, tuple[np.ndarray, str, float]], held_out: np.ndarray,
                     noise_mm: float | None, path: str | Path, *, load: np.ndarray | None = None,
                     load_label: str = "applied force [N]", title: str) -> Path:
    """The same for any curves: label -> (error of each frame (T,) [mm], colour, line width)."""
    time = as_array("time", time, (None,))
    figure = Figure(figsize=(9.0, 4.6), dpi=160, layout="constrained", facecolor=PAPER)
    axes = figure.add_subplot(facecolor=PAPER)
    _shade(axes, time, as_array("held_out", held_out, time.shape, bool))
    for label, (error_mm, colour, width) in curves.items():
        axes.plot(time, as_array(label, error_mm, time.shape), color=colour, lw=width, label=label, zorder=3)
    if noise_mm is not None:
        axes.axhline(noise_mm, color=INK, lw=1, ls=":", label=f"noise of the measurement, {noise_mm:.2g} mm")
    if load is not None:
        _draw_load(axes, time, as_array("load", load, time.shape), load_label)
    _dress(axes, title)
    return saved(figure, path)


def saved(figure: Figure, path: str | Path) -> Path:
    """Write a figure (.png, .svg or .pdf) without a display; the file is whole or absent."""
    with replacing(path) as partial:
        FigureCanvasAgg(figure).print_figure(partial)
    return Path(path)


def _shade(axes: Axes, time: np.ndarray, held_out: np.ndarray) -> None:
    """Shade each run of held-out frames from half a frame before to half a frame after."""
    half = np.diff(time).mean() / 2 if len(time) > 1 else 0.5
    edges = np.flatnonzero(np.diff(np.concatenate([[False], held_out, [False]]).astype(int)))
    for number, (first, last) in enumerate(edges.reshape(-1, 2)):
        label = "held out: never shown to the fit" if number == 0 else None
        axes.axvspan(time[first] - half, time[last - 1] + half, color=INK, alpha=0.07, lw=0, label=label, zorder=0)


def _draw_load(axes: Axes, time: np.ndarray, load: np.ndarray, label: str) -> None:
    right = axes.twinx()
    right.set_facecolor(PAPER)
    right.fill_between(time, load, color=LOAD, alpha=0.13, lw=0)
    right.plot(time, load, color=LOAD, lw=1, alpha=0.8)
    right.set_ylim(0, 3.2 * max(float(load.max()), 1e-12))
    right.set_ylabel(label, color=LOAD)
    right.tick_params(colors=LOAD, length=0)
    right.spines[:].set_visible(False)
    axes.set_zorder(right.get_zorder() + 1)
    axes.patch.set_visible(False)


def _dress(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", color=INK, fontsize=12, pad=34)
    axes.set_xlabel("time [s]", color=INK)
    axes.set_ylabel("mean error [mm]", color=INK)
    axes.set_ylim(bottom=0)
    axes.margins(x=0.01)
    axes.grid(axis="y", color="#dddddd", lw=0.7)
    axes.tick_params(colors=INK, length=0)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=3, frameon=False, fontsize=8, labelcolor=INK,
                borderaxespad=0.1, columnspacing=1.4, handlelength=1.8)
