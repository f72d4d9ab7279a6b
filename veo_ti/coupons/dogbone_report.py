"""What a filmed strip leaves in its folder: numbers, a picture, and a page that says what they cannot tell."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from veo_ti.coupons.dogbone import DogboneFacts, Estimate
from veo_ti.plots import INK, MODEL, PAPER, PLAIN, saved
from veo_ti.report import Section, Table, write_report
from veo_ti.store import writable_folder, write_json_atomic

LOOK_ALIKES = ("fibre_anisotropy", "volumetric_law", "camera_scale")  # of a contraction that is not a half
CANNOT = {
    "stress scale": "no force was recorded: every multiple of the energy moves the points alike",
    "volume": "the thickness was not tracked: isotropic with loss of volume, or anisotropic without, look the same",
    "steady slip": "no point of a grip was tracked: slipping a little in every step looks like a longer strip",
    "camera scale": "stretches do not know it, and the grip does not fix it: the length outside the view is unknown",
    "rate and history": "one slow pull, nothing held or unloaded",
}


def facts_of(found: DogboneFacts) -> dict[str, object]:
    """The content of `coupon.json` for a film without force."""
    matches = found.contraction.low <= 0.5 <= found.contraction.high
    return {
        "verdict": "no_misfit" if matches else "ambiguous", "sentence": sentence(found),
        "causes": [] if matches else [{"name": name, "parameters": []} for name in LOOK_ALIKES],
        "ambiguous_with": [] if matches else [[name] for name in LOOK_ALIKES[1:]],
        "contraction": vars(found.contraction), "camera_scale_growth_needed": vars(found.needed_scale),
        "yeoh_beta": vars(found.beta), "stretch_noise": {"axial": found.noise[0], "lateral": found.noise[1]},
        "axial_stretch_last": found.axial[-1].tolist(), "relative_stiffness": found.stiffness.tolist(),
        "relative_stiffness_sd": found.stiffness_sd, "free_length_mm": (1e3 * found.free_length).tolist(),
        "share_of_travel_seen": list(found.seen_share),
        "odd_states": [{"state": t, "strain": off} for t, off in found.odd],
        "slips": [{"state": t, "mm": 1e3 * size} for t, size in found.slips],
        "smallest_slip_seen_mm": 1e3 * found.slip_limit, "cannot_tell": CANNOT,
        "separating_experiment": {"advised": "track the thickness too, and pull a second strip cut across"},
    }  # fmt: skip


def sentence(found: DogboneFacts) -> str:
    """The result in plain words."""
    c = found.contraction
    shrinks = f"The strip narrows by {c.value:.3f} ({c.low:.3f} to {c.high:.3f}) of its logarithmic lengthening"
    if c.low <= 0.5 <= c.high:
        return f"{shrinks}, as isotropic incompressible solids do; without a force nothing is known of its stiffness."
    return (
        f"{shrinks}, not by the 0.5 of an isotropic incompressible solid; whether it is anisotropic, loses volume, or "
        f"the cameras' scale grew by {found.needed_scale.value:.1%}, these data cannot tell, nor how stiff it is."
    )


def write_dogbone(found: DogboneFacts, folder: str | Path) -> dict[str, object]:
    """Write coupon.json, a picture and report.html into folder; returns the facts."""
    folder = writable_folder(folder)
    facts = facts_of(found)
    write_json_atomic(folder / "coupon.json", facts)
    told = Section(
        heading="What the film tells",
        text="Intervals come from drawing the pieces of the strip anew.",
        table=Table(columns=["", "value", "95 % interval"], rows=_rows(found)),
        pictures=[draw(found, folder / "strip.png")],
    )
    not_told = Section(
        heading="What it cannot tell", text="None of these is ruled out.",
        table=Table(columns=["", "why"], rows=list(CANNOT.items())),
    )  # fmt: skip
    write_report(folder / "report.html", "A strip pulled without a load cell", facts["sentence"], [told, not_told])
    return facts


def _rows(found: DogboneFacts) -> list[list[object]]:
    k, sd, free = found.stiffness, found.stiffness_sd, 1e3 * found.free_length
    odd = ", ".join(f"state {t}: strain off by {off:.1e}" for t, off in found.odd) or "none"
    slips = ", ".join(f"before state {t}: {1e3 * size:.2g} mm" for t, size in found.slips) or "none"
    return [
        ["-ln(lateral) / ln(axial stretch)", *_cells(found.contraction)],
        ["growth of the camera scale that would make it 0.5", *_cells(found.needed_scale)],
        ["strain stiffening beta, from unlike pieces under one force", *_cells(found.beta)],
        ["stiffness of the pieces over their mean", f"{k.min():.3f} to {k.max():.3f}", f"each ± {1.96 * sd:.1e}"],
        ["noise of a piece's axial, lateral stretch", f"{found.noise[0]:.1e}, {found.noise[1]:.1e}", ""],
        [
            "length over which the grip's travel spreads, first to last state [mm]",
            f"{free[0]:.1f} to {free[-1]:.1f}",
            "",
        ],
        ["states that are off alone", odd, ""],
        ["sudden slips of a grip", slips, f"from {1e3 * found.slip_limit:.2g} mm on one would have been seen"],
    ]


def _cells(estimate: Estimate) -> list[str]:
    return [f"{estimate.value:.3g}", f"{estimate.low:.3g} to {estimate.high:.3g}"]


def draw(found: DogboneFacts, path: Path) -> Path:
    """Lateral against axial stretch, the stretch along the strip, and the length that the travel spreads over."""
    figure = Figure(figsize=(12.5, 3.9), dpi=150, layout="constrained", facecolor=PAPER)
    first, second, third = figure.subplots(1, 3, subplot_kw={"facecolor": PAPER})
    a, b = np.log(found.axial), np.log(found.lateral)
    first.scatter(a, b, s=5, color=INK, label="pieces of the strip")
    line = np.array([0, float(a.max())])
    first.plot(line, -found.contraction.value * line, color=MODEL, label=f"slope {-found.contraction.value:.3f}")
    first.plot(line, -0.5 * line, color=PLAIN, ls="--", label="isotropic, incompressible: -0.5")
    first.legend(frameon=False, fontsize=8, labelcolor=INK)
    order = np.sort(found.data.x[:, 0])
    at = [1e3 * float(part.mean()) for part in np.array_split(order, found.axial.shape[1])]
    for t in range(3, len(found.axial), 4):
        second.plot(at, found.axial[t], "o-", ms=4, color=MODEL, alpha=0.3 + 0.7 * t / len(found.axial))
    third.plot(1e3 * found.data.grip[1:], 1e3 * found.free_length, "o-", ms=4, color=INK)
    titles = ("ln lateral against ln axial stretch", "axial stretch along the strip [x in mm]",
              "grip travel over strain [mm] against travel [mm]")  # fmt: skip
    for axes, title in zip((first, second, third), titles, strict=True):
        axes.set_title(title, loc="left", color=INK, fontsize=9)
        axes.grid(color="#dddddd", lw=0.6)
        axes.tick_params(colors=INK, length=0, labelsize=8)
        axes.spines[:].set_visible(False)
    return saved(figure, path)
