"""Which further test would tell two explanations apart: the predicted difference over a small library of tests."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from veo_ti.coupons.curves import NAMES, Curve, first_invariant, principal
from veo_ti.coupons.data import pieces_of
from veo_ti.coupons.search import Candidate, Found

SHARES = (0.25, 0.5, 0.75, 1.0)  # of the greatest stretch of a mode
CLEAR = 3.0  # standard deviations from which a difference decides
NEARLY = 0.8
_POINTS = 8
_HIGHEST = 30.0


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """A test that was not made. separation: predicted difference in standard deviations of what is known of it."""

    mode: str
    stretch: float
    invariant: float  # I = I1 - 3 there: how hard the material is worked
    separation: float
    noise_units: float  # the same in units of the measurement's noise alone
    repeated: bool  # whether the data hold this mode up to that stretch already

    @property
    def sentence(self) -> str:
        """What to do."""
        return f"measure {NAMES[self.mode]} to a stretch of {self.stretch:.3g}"


def experiments(found: Found, first: Candidate, second: Candidate) -> tuple[Experiment, ...]:
    """Every test of the library, most telling first.

    `separation^2 = d^T C^-1 d` with d the relative difference of the two predictions and C what is uncertain of it: the
    parameters of both, the smooth error that either law leaves, shared by the points of a piece, and the noise. No test
    goes beyond the I that the material has survived in the data.
    """
    highest = max(float(first_invariant(principal(c.mode, c.stretch)).max()) for c in found.data.curves)
    made = {c.mode: float(c.stretch.max()) for c in found.data.curves}
    library = []
    for mode in NAMES:
        end = _stretch_at(mode, highest)
        for share in SHARES:
            top = 1 + share * (end - 1)
            library.append(_experiment(found, first, second, mode, top, made.get(mode, 0.0)))
    return tuple(sorted(library, key=lambda e: -e.separation))


def advised(library: Sequence[Experiment]) -> Experiment | None:
    """The gentlest of the new tests that tell nearly as much as the most telling one; None where none decides."""
    new = [e for e in library if not e.repeated]  # what is in the data has been used
    most = max((e.separation for e in new), default=0.0)
    if most < CLEAR:
        return None
    return min((e for e in new if e.separation >= NEARLY * most), key=lambda e: e.invariant)


def _stretch_at(mode: str, invariant: float) -> float:
    """The stretch > 1 at which a mode reaches I."""
    return float(brentq(lambda x: first_invariant(principal(mode, np.array([x])))[0] - invariant, 1.0, _HIGHEST))


def _experiment(found: Found, first: Candidate, second: Candidate, mode: str, top: float, reached: float) -> Experiment:
    stretch = np.linspace(1, top, _POINTS + 1)[1:]
    a, b = (c.fit.stress(mode, stretch) for c in (first, second))
    scale = np.abs(a) + np.abs(b)
    usable = np.isfinite(scale)
    stretch, a, b, scale = stretch[usable], a[usable], b[usable], scale[usable] / 2
    level = float(np.median(found.data.level))
    left = max(first.fit.left, second.fit.left)
    piece = pieces_of(Curve(mode=mode, stretch=stretch, stress=a))
    C = level**2 * np.eye(len(stretch)) + left**2 * (piece[:, None] == piece)
    for c in (first, second):
        J = c.fit.derivative(mode, stretch) / scale[:, None]
        C = C + J @ c.fit.covariance @ J.T
    d = (a - b) / scale
    worked = float(first_invariant(principal(mode, np.array([top])))[0])
    return Experiment(
        mode=mode, stretch=float(top), invariant=worked, repeated=reached >= top,
        separation=float(np.sqrt(d @ np.linalg.solve(C, d))), noise_units=float(np.sqrt((d**2).sum()) / level),
    )  # fmt: skip
