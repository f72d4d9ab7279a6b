"""A diagnosis as numbers and words for programs: the content of `diagnosis.json`."""

from collections.abc import Sequence

import numpy as np

from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.fitted import Refit
from veo_ti.diagnosis.intervals import measured
from veo_ti.diagnosis.limits import limits
from veo_ti.diagnosis.rounds import Round
from veo_ti.diagnosis.run import Diagnosis
from veo_ti.diagnosis.score import Score
from veo_ti.diagnosis.sentence import place, present, sentence
from veo_ti.diagnosis.verdict import TESTABLE, Candidate

_FAR = 3.0  # widths of what is plausible: an effect that must be larger to be seen cannot be tested
_WORTH_A_WORD = 3.0  # nats: what has as much for it was seen, whatever its size


def facts(diagnosis: Diagnosis) -> dict[str, object]:
    """Everything that was found, in SI units but for names that end in _mm; plain Python types only.

    A number that is not finite becomes None.
    """
    first, last = diagnosis.rounds[0], diagnosis.rounds[-1]
    after = last.verdict.causes[0].misfit if last.verdict.kind == "named" else last.misfit
    return {
        "verdict": diagnosis.verdict.kind,
        "finished": diagnosis.finished,
        "sentence": sentence(diagnosis),
        "causes": _causes(diagnosis),
        "ambiguous_with": _rivals(diagnosis),
        "separating_experiment": next((e for r in diagnosis.rounds if (e := _experiment(r))), None),
        "ranking": _ranking(diagnosis),
        "noise_mm": _plain(1e3 * diagnosis.noise.sigma),
        "noise_correlation": _plain(diagnosis.noise.correlation),
        "outlier_share": _plain(diagnosis.noise.outlier_share),
        "misfit_z": _plain(first.misfit.z),
        "misfit_z_after": _plain(after.z),
        "rounds": [_round(r) for r in diagnosis.rounds],
        "error_mm": _errors(diagnosis),
        "limits": list(limits(diagnosis.baseline.scene)),
        "seconds": _plain(diagnosis.seconds),
        "steps": _plain(diagnosis.steps),
    }


def _causes(diagnosis: Diagnosis) -> list[dict[str, object]]:
    """The named causes in order; where the first round cannot tell them apart, all that it may be, and then all that
    may be wrong besides."""
    if diagnosis.verdict.kind == "ambiguous":
        return [_cause(c, c.refit, n) for n, found in enumerate(diagnosis.rounds) for c in found.verdict.causes]
    named = zip(diagnosis.named, present(diagnosis), strict=True)
    return [_cause(c, refit, n) for n, (c, refit) in enumerate(named)]


def _cause(candidate: Candidate, refit: Refit, number: int) -> dict[str, object]:
    cause = refit.cause
    where = [(measure, measure.value, low, high) for measure, low, high in measured(refit)]
    return {
        "name": cause.name, "round": number, "sentence": cause.sentence, "place": place(refit),
        "parameters": [
            {
                "name": p.name, "unit": p.unit, "value": _plain(value), "low": _plain(low), "high": _plain(high),
            }
            for p, value, low, high in [*zip(cause.parameters, refit.theta, *refit.interval, strict=True), *where]
        ],
        "log_evidence_gain": _plain(candidate.gained), "explained": _plain(candidate.explained),
        "converged": bool(refit.converged),
    }  # fmt: skip


def _rivals(diagnosis: Diagnosis) -> list[str]:
    """Causes that could as well be the first one of `causes`."""
    return [c.name for c in diagnosis.verdict.causes[1:]] if diagnosis.verdict.kind == "ambiguous" else []


def _experiment(found: Round) -> dict[str, object] | None:
    """The measurement that would separate a round's first two causes, with the nats expected between them."""
    if found.experiment is None:
        return None
    e, causes = found.experiment, [c.name for c in found.verdict.causes[:2]]
    return {"description": e.description, "causes": causes, "nats_now": _plain(e.now), "nats_then": _plain(e.then)}


def _round(found: Round) -> dict[str, object]:
    tried = [
        {
            "name": c.name, "log_evidence_gain": _plain(c.gained), "explained": _plain(c.explained),
            "log_predictive_gain": _plain(c.predicted), "misfit_z": _plain(c.misfit.z),
            "plausible": bool(c.plausible), "converged": bool(c.refit.converged), "place": place(c.refit),
            "parameters": _values(c.refit.cause, c.refit.theta),
        }
        for c in found.candidates
    ]  # fmt: skip
    verdict = {"verdict": found.verdict.kind, "causes": [c.name for c in found.verdict.causes]}
    told = {"misfit_z": _plain(found.misfit.z), "separating_experiment": _experiment(found)}
    return {**verdict, **told, "refitted": tried}


def _ranking(diagnosis: Diagnosis) -> list[dict[str, object]]:
    """Every cause of the catalogue: those that were scored, best first, then those that could not be."""
    scored = [_scored(diagnosis, score) for score in diagnosis.rounds[0].scores]
    nothing = dict.fromkeys(("log_bayes", "statistic", "keep", "promised")) | {"place": "", "parameters": []}
    return scored + [
        {"name": name, **nothing, "testable": False, "why_not": reason} for name, reason in diagnosis.untestable.items()
    ]


def _scored(diagnosis: Diagnosis, score: Score) -> dict[str, object]:
    why_not = _hidden(diagnosis, score)
    values = _values(score.cause, score.theta)
    smallest = [
        {**value, "smallest_detectable": _plain(d) if _told(score) else None}
        for value, d in zip(values, score.detectable, strict=True)
    ]
    return {
        "name": score.name, "log_bayes": _plain(score.log_bayes), "statistic": _plain(score.statistic),
        "keep": _plain(score.keep), "promised": _plain(score.explained),
        "place": score.cause.describe(diagnosis.baseline.scene, score.place),
        "parameters": smallest, "testable": why_not is None, "why_not": why_not,
    }  # fmt: skip


def _hidden(diagnosis: Diagnosis, score: Score) -> str | None:
    """Why a cause that was scored could not have been seen at any plausible size, or None; one that is named was."""
    if score.name in {c.name for c in diagnosis.named}:
        return None
    widths = score.cause.widths(diagnosis.baseline.scene)
    if _told(score) and (score.log_bayes > _WORTH_A_WORD or (score.detectable <= _FAR * widths).any()):
        return None
    if score.keep < 0.3:
        return f"a change of the material imitates it: only {score.keep:.0%} of its effect would be left to see"
    return "at any plausible size its effect is lost in noise and in whatever else is wrong"


def _told(score: Score) -> bool:
    """Whether enough of a cause's effect is left to see for a smallest size to be told."""
    return bool(score.keep > TESTABLE)


def _values(cause: Cause, theta: Sequence[float] | np.ndarray) -> list[dict[str, object]]:
    pairs = zip(cause.parameters, theta, strict=True)
    return [{"name": p.name, "unit": p.unit, "value": _plain(value)} for p, value in pairs]


def _errors(diagnosis: Diagnosis) -> dict[str, object] | None:
    """Root mean square error per coordinate on the held-out frames."""
    g = diagnosis.gain
    if g is None:
        return None
    value, low, high = g.gained_mm
    return {
        "homogeneous": _plain(g.homogeneous_mm), "refit_only": _plain(g.before_mm), "after": _plain(g.after_mm),
        "hold_residual": _plain(g.hold_residual_mm), "no_change": _plain(g.no_change_mm),
        "gained": {"value": _plain(value), "low": _plain(low), "high": _plain(high)},
    }  # fmt: skip


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
