"""The diagnosis of a coupon: what the fitted curves say is wrong, what that gains, and what to measure next."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sim.checks import require
from veo_ti.coupons.curves import FEWEST, Coupon, Curve
from veo_ti.coupons.predict import Fold, Gain, measure_gain
from veo_ti.coupons.search import Candidate, Catalogue, Found, catalogue, search
from veo_ti.coupons.separate import Experiment, advised, experiments

_KEPT = 0.7  # of ln stretch, from which a single curve has to predict the rest

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class CouponDiagnosis:
    """found: what the training curves say. folds: divisions whose held-out curves chose nothing.

    library: how far every further test would part the best explanation and its first rival.
    """

    coupon: Coupon
    train: tuple[Curve, ...]
    held: tuple[Curve, ...]  # that the caller asked to hold out
    found: Found
    folds: tuple[Fold, ...]
    gain: Gain | None
    rival: Candidate | None  # what the next test should tell the best from
    library: tuple[Experiment, ...]
    seconds: float

    @property
    def experiment(self) -> Experiment | None:
        """The test that would decide."""
        return advised(self.library)


def diagnose_coupon(
    coupon: Coupon,
    *,
    modes: Sequence[str] | None = None,
    up_to: float | None = None,
    causes: Catalogue = catalogue,
    progress: Progress | None = None,
) -> CouponDiagnosis:
    """Find what the incompressible Neo-Hookean law gets wrong on a coupon.

    modes, up_to: fit these modes only, and stretches up to this one; everything else is predicted and judged. Without
    them all data name the cause, and the gain is measured by leaving out each mode in turn (a single curve: its
    upper part), the causes chosen anew without it. Raises ValueError in one sentence.
    """
    began, say = time.perf_counter(), progress or (lambda text: None)
    curves = tuple(curve.thinned() for curve in coupon.curves)
    say("every cause, then sets of them")
    if modes is None and up_to is None:
        train, held = curves, ()
        divisions = _divisions(curves)
    else:
        train, held = divided(curves, coupon.modes if modes is None else modes, up_to)
        divisions = []
    found = search(train, crosshead=coupon.crosshead, causes=causes)
    folds = [Fold(train=train, held=held, found=found)] if held else []
    for taught, kept in divisions:
        say(f"without {', '.join(c.mode for c in kept)}")
        folds.append(Fold(train=taught, held=kept, found=search(taught, crosshead=coupon.crosshead, causes=causes)))
    rival = found.rivals[0] if found.rivals else None
    return CouponDiagnosis(
        coupon=coupon, train=train, held=held, found=found, folds=tuple(folds), gain=measure_gain(folds), rival=rival,
        library=experiments(found, found.best, rival) if rival else (), seconds=time.perf_counter() - began,
    )  # fmt: skip


def divided(
    curves: Sequence[Curve], modes: Sequence[str], up_to: float | None
) -> tuple[tuple[Curve, ...], tuple[Curve, ...]]:
    """The curves to fit and those to predict."""
    known = [curve.mode for curve in curves]
    for mode in modes:
        require(mode in known, "fit", f"name modes of the coupon, {', '.join(known)}", mode)
    limit = np.inf if up_to is None else up_to
    require(limit > 1, "up-to", "be a stretch above 1", up_to)
    train, held = [], []
    for curve in curves:
        inside = (curve.stretch <= limit) & (curve.mode in modes)
        require(
            not inside.any() or inside.sum() >= FEWEST, f"the fitted part of {curve.mode}",
            f"have at least {FEWEST} points", int(inside.sum()),
        )  # fmt: skip
        train += [curve.part(inside)] if inside.any() else []
        held += [curve.part(~inside)] if not inside.all() else []
    require(bool(train), "fit", "leave something to fit", f"no point up to {limit:g}")
    return tuple(train), tuple(held)


def _divisions(curves: Sequence[Curve]) -> list[tuple[tuple[Curve, ...], tuple[Curve, ...]]]:
    """Each mode left out in turn; of a single curve, what lies beyond most of its stretch."""
    if len(curves) > 1:
        return [(tuple(c for c in curves if c is not kept), (kept,)) for kept in curves]
    limit = float(np.exp(_KEPT * np.log(curves[0].stretch.max())))
    inside = curves[0].stretch <= limit
    enough = inside.sum() >= FEWEST and (~inside).any()
    return [((curves[0].part(inside),), (curves[0].part(~inside),))] if enough else []
