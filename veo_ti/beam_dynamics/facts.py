"""The diagnosis of the beam's motion as numbers and words for programs: the content of `diagnosis.json`."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from veo_ti.beam import DENSITY, SIZE
from veo_ti.beam_dynamics.fitting import Fit, fitted_part, seen
from veo_ti.beam_dynamics.hypotheses import CREEP, DAMPING, FITTINGS, HUNG, Hypothesis
from veo_ti.beam_dynamics.judge import HAS, SENTENCES, Effect, Question
from veo_ti.beam_dynamics.run import BeamDiagnosis
from veo_ti.beam_dynamics.sentence import sentence
from veo_ti.beam_dynamics.takes import Release

OWN = {"damping": [u.name for kind in DAMPING.values() for u in kind], "viscoelasticity": [u.name for u in CREEP],
       "added_mass": [HUNG.name], "fittings": [FITTINGS.name]}  # fmt: skip
STRETCHES = (0.0, 0.1, 0.3, 0.6, 1.0, 1.5)  # [s] after the release
SEPARATING = {
    "damping": "Hang other weights, from none to several times this one: damping in proportion to stiffness and mass "
    "must rise at both ends of a wide range of frequencies, where that of a relaxing material falls.",
    "added_mass": "Strike the tip along the beam: only a weight that is fixed to it has horizontal inertia.",
}
UNTOLD = "Weigh the markers and what holds them: a few grams at the tip and a hung mass that is a few grams lighter "\
         "ring alike."  # fmt: skip


def facts(d: BeamDiagnosis) -> dict[str, object]:
    """Everything that was found, in SI units but for names that end in _mm; plain Python types only."""
    j = d.judgement
    return {
        "verdict": j.kind, "sentence": sentence(d), "causes": [_cause(d, effect) for effect in j.named],
        "ambiguous_with": [], "open_questions": [_question(q) for q in j.questions],
        "separating_experiment": _separating(d), "ranking": _ranking(d), "hypotheses": _hypotheses(d),
        "noise_mm": 1e3 * float(np.mean([r.settled.noise for r in d.releases])),
        "settled_error_mm": 1e3 * d.setting.tolerance, "noise_correlation": _count(d) / j.effective,
        "independent_residuals": j.effective, "outlier_share": 0.0, "misfit_z": j.z, "misfit_z_after": j.z_after,
        "explained": j.explained, "fitted_error_mm": {"before": 1e3 * j.baseline.sigma, "after": 1e3 * j.best.sigma},
        "error_mm": _errors(d), "ringing": {name: _ringing(d, name) for name in d.ringing},
        "hung_mass": _hung(d), "nuisances": _values(j.best, [u.name for u in j.best.setup.nuisances]),
        "error_over_time_mm": {r.label: _over_time(d, r) for r in d.releases}, "repeats": _repeats(d),
        "cloud": {"points": d.setting.model.cloud.count, "young_pa": d.setting.young,
                  "correction_change_mm": 1e3 * d.correction,
                  "shapes_error_mm": None if d.shapes_error is None else 1e3 * d.shapes_error},
        "fitted": [r.label for r in d.data.releases], "predicted": [r.label for r in d.unseen], "seconds": d.seconds,
    }  # fmt: skip


def parameter(fit: Fit, name: str) -> dict[str, object] | None:
    """A parameter of a fit with its 95 % interval; None where the fit has none of that name."""
    bounds = fit.bounds(name)
    if bounds is None:
        return None
    unit = next(u.unit for u in fit.setup.unknowns if u.name == name)
    return {"name": name, "unit": unit, **dict(zip(("value", "low", "high"), bounds, strict=True))}


def _values(fit: Fit, names: Sequence[str]) -> list[dict[str, object]]:
    return [found for name in names if (found := parameter(fit, name)) is not None]


def _cause(d: BeamDiagnosis, effect: Effect) -> dict[str, object]:
    gained = d.cause_gains.get(effect.name)
    values = _values(d.judgement.best, OWN.get(effect.name, []))
    if effect.name == "added_mass" and d.hung is not None:
        values = _values(d.hung, [HUNG.name])
    if effect.name == "inertia":
        weighed = DENSITY * float(np.prod(SIZE))
        values = [{"name": "beam_mass", "unit": "kg", "value": weighed, "low": weighed, "high": weighed}]
    return {
        "name": effect.name, "sentence": SENTENCES[effect.name], "place": "", "parameters": values,
        "log_evidence_gain": effect.gained, "explained": effect.explained, "converged": True,
        "held_out_gain_mm": None if gained is None else dict(zip(("value", "low", "high"), gained, strict=True)),
    }  # fmt: skip


def _question(q: Question) -> dict[str, object]:
    answers = [{"answer": words, "nats_behind": behind, "open": behind < q.margin} for words, behind in q.answers]
    return {"cause": q.cause, "answers": answers, "margin": q.margin}


def _separating(d: BeamDiagnosis) -> str | None:
    told = [SEPARATING[q.cause] for q in d.judgement.questions if len(q.open) > 1]
    named = {e.name for e in d.judgement.named}
    return " ".join([*told, *([UNTOLD] if "added_mass" in named and "fittings" not in named else [])]) or None


def _ranking(d: BeamDiagnosis) -> list[dict[str, object]]:
    """Each cause: evidence that the best hypothesis has for it, or that it would gain by it."""
    j, rows = d.judgement, []
    inside = {e.name: e for e in j.effects}
    evidence = {id(f): f.evidence(j.effective) for f in d.fits}
    for name, has in HAS.items():
        effect, tried = inside.get(name), [f for f in d.fits if has(f.hypothesis)]
        if effect is not None:
            gained = effect.gained
        elif tried:
            gained = max(evidence[id(f)] for f in tried) - max(evidence[id(f)] for f in d.fits if not has(f.hypothesis))
        else:
            rows.append({"name": name, "log_bayes": None, "testable": False, "why_not": "no take has a hung weight"})
            continue
        share = None if effect is None else effect.explained
        rows.append({"name": name, "log_bayes": gained, "explained": share, "testable": True, "why_not": None})
    return sorted([*rows, _timing(d)], key=lambda r: -(r["log_bayes"] or 0.0))


def _timing(d: BeamDiagnosis) -> dict[str, object]:
    """A late or slow release by itself, which every hypothesis may use: the most that it could have for it."""
    j = d.judgement
    sudden = np.concatenate([seen(fitted_part(r.w, r)) for r in d.data.releases])
    size = max(float(np.sqrt(np.mean(sudden**2))), j.baseline.sigma)
    return {
        "name": "force_timing", "log_bayes": j.effective * float(np.log(size / j.baseline.sigma)),
        "explained": 1 - (j.baseline.sigma / size) ** 2, "testable": True, "why_not": None,
    }  # fmt: skip


def _hypotheses(d: BeamDiagnosis) -> list[dict[str, object]]:
    j = d.judgement
    zero = j.baseline.evidence(j.effective)
    return [
        {"hypothesis": f.hypothesis.label, "log_bayes": f.evidence(j.effective) - zero, "error_mm": 1e3 * f.sigma}
        for f in d.fits
    ]


def _errors(d: BeamDiagnosis) -> dict[str, object] | None:
    """Root mean square error per coordinate on the unseen takes, after their first 0.3 s."""
    g = d.gain
    if g is None:
        return None
    return {
        "no_change": g.no_change, "quasi_static": g.quasi_static, "refit_only": g.refit_only,
        "hold_residual": g.hold_residual, "replay": g.replay, "after": g.after, "lateral_motion": g.lateral,
        "gained": dict(zip(("value", "low", "high"), g.gained, strict=True)),
    }  # fmt: skip


def _ringing(d: BeamDiagnosis, name: str) -> dict[str, object]:
    r = d.ringing[name]
    sides = (("measured", r.measured, r.measured.frequency_sd, r.measured.ratio_sd),
             ("predicted", r.predicted, r.frequency_sd, r.ratio_sd))  # fmt: skip
    return {
        side: {
            "frequency_hz": _interval(ring.frequency, df), "damping_ratio": _interval(ring.ratio, dz),
            "log_decrement": ring.decrement,
        }
        for side, ring, df, dz in sides
    }  # fmt: skip


def _interval(value: float, sd: float) -> dict[str, float]:
    return {"value": value, "low": value - 1.96 * sd, "high": value + 1.96 * sd}


def _over_time(d: BeamDiagnosis, r: Release) -> list[dict[str, float]]:
    """Mean distance of the markers in stretches of a take."""
    left = {"quasi_static": r.w, "best": r.w - d.shown[r.name]}
    rows = []
    for begin, end in pairwise(STRETCHES):
        inside = (r.time >= begin) & (r.time < end)
        mean = {name: 1e3 * float(np.linalg.norm(w[inside], axis=2).mean()) for name, w in left.items()}
        rows.append({"from_s": begin, "to_s": end, **mean})
    return rows


def _repeats(d: BeamDiagnosis) -> dict[str, dict[str, float]]:
    """How far repeats of a loading differ from each other, measured: what no prediction from one of them can beat."""
    found: dict[str, dict[str, float]] = {}
    for kind in dict.fromkeys(r.kind for r in d.releases):
        rings = [d.ringing[r.name].measured for r in d.releases if r.kind == kind and r.name in d.ringing]
        if len(rings) > 1:
            found[kind] = {
                "frequency_hz": float(np.ptp([r.frequency for r in rings])),
                "damping_ratio": float(np.ptp([r.ratio for r in rings])),
            }
    return found


def _hung(d: BeamDiagnosis) -> dict[str, object] | None:
    """The hung mass fitted, beside what the scales say; and what speaks against fixed values, in nats."""
    if d.hung is None:
        return None
    evidence = [(f.evidence(d.judgement.effective), f.hypothesis) for f in d.fits]
    top = evidence[0][0]

    def against(holds: Callable[[Hypothesis], bool]) -> float | None:
        return next((top - value for value, h in evidence if h.inertia and holds(h)), None)

    plain = next((f for f in d.fits if f.hypothesis.fitted and not f.hypothesis.fittings), None)
    return {
        "fitted": parameter(d.hung, HUNG.name), "fittings": parameter(d.hung, FITTINGS.name),
        "fitted_without_fittings": None if plain is None else parameter(plain, HUNG.name),
        "weighed_kg": max(r.weight for r in d.data.releases),
        "nats_against": {
            "no_mass": against(lambda h: h.weight == "force"),
            "weighed_mass_and_fittings": against(lambda h: h.weight != "force" and not h.fitted and h.fittings),
            "weighed_mass_alone": against(lambda h: h.weight != "force" and not h.fitted and not h.fittings),
        },
    }  # fmt: skip


def _count(d: BeamDiagnosis) -> int:
    return len(d.judgement.best.slopes)
