"""The diagnosis of the beam's motion: from takes to a judged hypothesis, its gain on unseen takes, and its ringing."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from veo_ti.beam_dynamics.fitting import Data, Fit, effective_count, fit, fitted_part
from veo_ti.beam_dynamics.heldout import Gain, Ringing, cause_gain, measure_gain, predicted, read_start, ringing
from veo_ti.beam_dynamics.hypotheses import REFERENCE, WEIGHTS, Hypothesis, grid
from veo_ti.beam_dynamics.judge import Judgement, judge
from veo_ti.beam_dynamics.setting import POINTS, Setting
from veo_ti.beam_dynamics.takes import Release, split

GUESS = 60.0  # independent residuals, before any are known
CLOSE = 0.05e-3  # [m] change of the correction that is small enough
PASSES = 4
MAY_LEAD = 30.0  # nats behind the best from which a hypothesis' relatives are not looked at


@dataclass(frozen=True, kw_only=True, eq=False)
class BeamDiagnosis:
    """Everything that was found."""

    setting: Setting
    data: Data
    releases: tuple[Release, ...]  # fitted ones first
    fits: tuple[Fit, ...]  # best first
    judgement: Judgement
    hung: Fit | None  # the best hypothesis with the hung mass and the fittings as parameters
    correction: float  # [m] root mean square of the last change of full simulation minus shapes
    shown: Mapping[str, np.ndarray]  # take -> the best hypothesis, (T, 3, 3) [m]; of unseen takes by full simulation
    shapes_error: float | None  # [m] root mean square of shapes minus full simulation on the unseen takes
    gain: Gain | None
    cause_gains: Mapping[str, tuple[float, float, float]]  # cause -> [mm]
    ringing: Mapping[str, Ringing]  # of each take
    seconds: float

    @property
    def unseen(self) -> tuple[Release, ...]:
        """The takes that were predicted."""
        return self.releases[len(self.data.releases) :]


def diagnose_beam(
    releases: Mapping[str, Release], *, points: int = POINTS, seed: int = 0, passes: int = PASSES,
    hypotheses: Sequence[Hypothesis] | None = None, progress: Callable[[str], None] = lambda text: None,
) -> BeamDiagnosis:
    """Fit every hypothesis to the `a` takes, judge them, and predict the others.

    passes: of the full simulation over the fitted takes; 0 leaves the shapes uncorrected and the prediction to them.
    hypotheses: those to compare, the quasi-static one among them; default all.
    """  # fmt: skip
    began = time.perf_counter()
    fitted, unseen = split(releases)
    progress("modulus from the settled poses")
    setting = Setting.of(fitted, unseen, points=points, seed=seed)
    data = Data(releases=tuple(fitted), ritz=setting.ritz, defect={})
    data, correction = corrected(setting, data, passes, progress)
    fits = compared(data, hypotheses, progress)
    judgement = judge(fits, fits[0].effective, setting.tolerance)
    best, shown = judgement.best, dict(zip([r.name for r in fitted], _shown(data, judgement.best), strict=True))
    data = replace(data, defect=data.defect | {r.name: _borrowed(data, r) for r in unseen})
    whole = best.hypothesis.inertia and passes > 0
    for r in unseen:
        progress(f"prediction of {r.label}")
        shown[r.name] = _whole(setting, data, best, r) if whole else predicted(data, best, r)
    by_shapes = {r.name: predicted(data, best, r) for r in unseen}
    off = [shown[name] - w for name, w in by_shapes.items()]
    plain = {r.name: predicted(data, judgement.baseline, r) for r in unseen}
    replay = {r.name: _replayed(fitted, r) for r in unseen}
    progress("ringing")
    rings = best.hypothesis.inertia and judgement.kind != "no_misfit"
    return BeamDiagnosis(
        setting=setting, data=data, releases=(*fitted, *unseen), fits=tuple(fits), judgement=judgement,
        hung=_hung(fits, judgement), correction=correction, shown=shown,
        shapes_error=float(np.sqrt(np.mean(np.square(off)))) if whole and off else None,
        gain=measure_gain(unseen, {"refit_only": plain, "after": shown}, replay) if unseen else None,
        cause_gains={e.name: cause_gain(data, best, e.without, unseen) for e in judgement.effects} if unseen else {},
        ringing={r.name: ringing(data, best, r, shown[r.name]) for r in (*fitted, *unseen)} if rings else {},
        seconds=time.perf_counter() - began,
    )  # fmt: skip


def corrected(setting: Setting, data: Data, passes: int, progress: Callable[[str], None]) -> tuple[Data, float]:
    """The data with the full simulation minus the shapes at the reference hypothesis, and its last change [m]."""
    change = {r.name: np.inf for r in data.releases}
    for number in range(passes):
        reference = fit(REFERENCE, data, effective=GUESS)
        for i, r in enumerate(data.releases):
            if change[r.name] < CLOSE:
                continue
            progress(f"full simulation of {r.label}, pass {number + 1}")
            defect = setting.defect(reference, i)
            change[r.name] = float(np.sqrt(np.mean((defect - data.defect.get(r.name, 0.0)) ** 2)))
            data = replace(data, defect=data.defect | {r.name: defect})
    return data, max(change.values()) if passes else 0.0


def compared(
    data: Data, hypotheses: Sequence[Hypothesis] | None = None, progress: Callable[[str], None] = lambda text: None
) -> list[Fit]:
    """Fits of the hypotheses, best first; by default of the grid, then of its leaders' relatives.

    All count as many independent residuals as the best one leaves.
    """
    fits: dict[Hypothesis, Fit] = {}

    def ensure(wanted: Sequence[Hypothesis]) -> None:
        for number, h in enumerate(new := [h for h in wanted if h not in fits], 1):
            progress(f"hypothesis {number} of {len(new)}")
            fits[h] = fit(h, data, effective=GUESS)

    ensure(grid(any(r.load > 0 for r in data.releases)) if hypotheses is None else hypotheses)
    if hypotheses is None:
        ensure(relatives(fits))
    best = max(fits.values(), key=lambda f: f.evidence(GUESS))
    count = effective_count([fitted_part(r, x) for r, x in zip(best.residuals, data.releases, strict=True)])
    found = [replace(f, effective=count) for f in fits.values()]
    return sorted(found, key=lambda f: -f.evidence(count))


def relatives(fits: Mapping[Hypothesis, Fit]) -> list[Hypothesis]:
    """The leaders that carry the hung mass, with every way of hanging it, its mass weighed or fitted, and fittings."""
    top = max(f.evidence(GUESS) for f in fits.values())
    close = [h for h, f in fits.items() if top - f.evidence(GUESS) < MAY_LEAD and h.weight != "force"]
    plain = dict.fromkeys(replace(h, weight="mass", fittings=False) for h in close)
    ways = list(product(list(WEIGHTS)[1:], (False, True), (False, True)))
    return [replace(h, weight=way, fitted=free, fittings=more) for h in plain for way, free, more in ways]


def _shown(data: Data, best: Fit) -> list[np.ndarray]:
    return [r.w - left for r, left in zip(data.releases, best.residuals, strict=True)]


def _borrowed(data: Data, release: Release) -> np.ndarray:
    """The correction of a fitted take of the same loading, on this take's frames; zero where there is none."""
    other = next((r for r in data.releases if r.kind == release.kind and r.name in data.defect), None)
    return np.zeros_like(release.w) if other is None else _on_clock(other, data.defect[other.name], release)


def _on_clock(other: Release, w: np.ndarray, release: Release) -> np.ndarray:
    flat = w.reshape(len(w), -1)
    return np.stack([np.interp(release.time, other.time, c) for c in flat.T], axis=1).reshape(release.w.shape)


def _replayed(fitted: Sequence[Release], release: Release) -> np.ndarray:
    """The motion of the first fitted take of the same loading; standing still where there is none."""
    other = next((r for r in fitted if r.kind == release.kind), None)
    return np.zeros_like(release.w) if other is None else _on_clock(other, other.w, release)


def _whole(setting: Setting, data: Data, best: Fit, release: Release) -> np.ndarray:
    """An unseen take by the full simulation."""
    return setting.full(best.setup.physics(best.theta, release), read_start(data, best, release), release)


def _hung(fits: Sequence[Fit], judgement: Judgement) -> Fit | None:
    """The best fit in which both the hung mass and the fittings are free: neither can hide in the other."""
    free = [f for f in fits if f.hypothesis.fitted and f.hypothesis.fittings]
    return free[0] if free and judgement.best.hypothesis.weight != "force" else None
