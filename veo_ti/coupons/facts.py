"""A coupon's diagnosis as numbers and words: the content of `coupon.json`."""

import numpy as np

from veo_ti.coupons.curves import Curve
from veo_ti.coupons.machine import UNTESTABLE
from veo_ti.coupons.predict import Fold, mooney_rivlin, r_squared, relative, rms, usual_mooney_rivlin
from veo_ti.coupons.run import CouponDiagnosis
from veo_ti.coupons.search import Candidate
from veo_ti.coupons.sentence import extrapolated, sentence

SEEN = 4.3  # standard deviations: 3 for a false alarm in 700, 1.3 for nine cases in ten


def facts(diagnosis: CouponDiagnosis) -> dict[str, object]:
    """Everything that was found, in SI units; plain Python types; None for a number that is not finite."""
    found, chosen = diagnosis.found, diagnosis.found.best
    told = (chosen, *found.rivals) if found.kind in ("named", "ambiguous") else ()
    return {
        "verdict": found.kind, "sentence": sentence(diagnosis), "named": list(found.named),
        "causes": _causes(diagnosis),
        "ambiguous_with": [sorted(c.names) for c in found.rivals],
        "explanations": [_candidate(c) for c in told],
        "separating_experiment": _experiment(diagnosis),
        "ranking": [_candidate(c) for c in found.candidates] + [
            {"causes": [name], "testable": False, "why_not": why} for name, why in UNTESTABLE.items()
        ],
        "baseline": {"mu_pa": found.baseline.fit.mu, "mu_sd_pa": found.baseline.fit.mu_sd,
                     "smooth_error_left": found.baseline.fit.left},
        "noise": {c.mode: float(level) for c, level in zip(diagnosis.train, found.data.level, strict=True)},
        "misfit_z": found.baseline.z, "misfit_z_after": found.applied.z, "smooth_error_left": found.applied.fit.left,
        "fitted": [_range(c) for c in diagnosis.train], "held_out": [_range(c) for c in diagnosis.held],
        "gain": _gain(diagnosis), "folds": [_fold(fold) for fold in diagnosis.folds], "seconds": diagnosis.seconds,
    }  # fmt: skip


def _causes(diagnosis: CouponDiagnosis) -> list[dict[str, object]]:
    """The named causes; where none is, every single cause of the explanations that cannot be told apart."""
    found = diagnosis.found
    if found.kind == "named":
        return [c for c in _parts(found.best) if c["name"] in found.named]
    return [part for c in (found.best, *found.rivals) for part in _parts(c)] if found.kind == "ambiguous" else []


def _parts(candidate: Candidate) -> list[dict[str, object]]:
    fit = candidate.fit
    pairs = zip(fit.model.causes, fit.model.split(fit.theta), fit.model.split(fit.sd), strict=True)
    return [
        {
            "name": cause.name, "form": cause.form, "sentence": cause.sentence,
            "parameters": [
                {"name": p.name, "unit": p.unit, "value": float(t), "low": float(t - 1.96 * s),
                 "high": float(t + 1.96 * s), "smallest_detectable": float(SEEN * s)}
                for p, t, s in zip(cause.parameters, theta, sd, strict=True)
            ],
        }
        for cause, theta, sd in pairs
    ]  # fmt: skip


def _candidate(c: Candidate) -> dict[str, object]:
    return {
        "causes": sorted(c.names), "forms": c.name, "log_evidence_gain": plain(c.gained),
        "explained": plain(c.explained), "misfit_z": plain(c.z), "smooth_error_left": plain(c.fit.left),
        "plausible": c.fit.plausible, "mu_pa": c.fit.mu, "mu_sd_pa": plain(c.fit.mu_sd), "parts": _parts(c),
        "testable": True, "why_not": None,
    }  # fmt: skip


def _experiment(diagnosis: CouponDiagnosis) -> dict[str, object] | None:
    """The advised test, between which explanations, and the whole library; None where nothing is ambiguous."""
    if diagnosis.rival is None:
        return None
    advised = diagnosis.experiment
    library = [
        {"mode": e.mode, "stretch": e.stretch, "separation_sd": plain(e.separation),
         "noise_units": plain(e.noise_units), "repeated": e.repeated}
        for e in diagnosis.library
    ]  # fmt: skip
    return {
        "between": [diagnosis.found.best.name, diagnosis.rival.name], "advised": advised.sentence if advised else None,
        "mode": advised.mode if advised else None, "stretch": advised.stretch if advised else None,
        "separation_sd": plain(advised.separation) if advised else None, "library": library,
    }  # fmt: skip


def _gain(diagnosis: CouponDiagnosis) -> dict[str, object] | None:
    g = diagnosis.gain
    if g is None:
        return None
    value, low, high = map(plain, g.gained)
    return {
        "relative_error": {k: plain(v) for k, v in g.errors.items()},
        "error_pa": {k: plain(v) for k, v in g.errors_pa.items()},
        "gained": {"value": value, "low": low, "high": high}, "points": g.points, "coverage_95": g.coverage,
        "extrapolated": extrapolated(diagnosis.folds),
    }  # fmt: skip


def _fold(fold: Fold) -> dict[str, object]:
    C1, C2 = usual_mooney_rivlin(fold.train)
    shown = (fold.found.best, *fold.found.rivals)
    return {
        "label": fold.label, "verdict": fold.found.kind, "forms": [c.name for c in shown],
        "held_out": [
            {
                "mode": c.mode,
                "relative_error": {k: plain(rms(relative(c, p))) for k, p in fold.predicted(c).items()},
                "r_squared": {k: plain(r_squared(c, p)) for k, p in fold.predicted(c).items()},
                "explanations": {
                    e.name: {"relative_error": plain(rms(relative(c, p))), "r_squared": plain(r_squared(c, p))}
                    for e in shown for p in [e.fit.stress(c.mode, c.stretch)]
                },
                "usual_mooney_rivlin_r_squared": plain(r_squared(c, mooney_rivlin(c, C1, C2))),
            }
            for c in fold.held
        ],
    }  # fmt: skip


def _range(curve: Curve) -> dict[str, object]:
    return {
        "mode": curve.mode,
        "points": len(curve),
        "from": float(curve.stretch.min()),
        "to": float(curve.stretch.max()),
    }


def plain(value: float) -> float | None:
    """The number, or None where it is not finite."""
    return float(value) if np.isfinite(value) else None
