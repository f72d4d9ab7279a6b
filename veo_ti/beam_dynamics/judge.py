"""What the evidence allows to be said about the beam's motion, with the thresholds of `veo_ti.diagnosis.verdict`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from veo_ti.beam_dynamics.fitting import Fit
from veo_ti.beam_dynamics.hypotheses import KINDS, QUASI_STATIC, WEIGHTS, Hypothesis
from veo_ti.diagnosis.verdict import APART, APART_SHARE, BETTER, EXPLAINED, MISFIT

TIE = 1.0  # nats that decide nothing: of such hypotheses one is shown that the full simulation integrates exactly

HAS: dict[str, Callable[[Hypothesis], bool]] = {  # cause -> whether a hypothesis holds it
    "inertia": lambda h: h.inertia,
    "added_mass": lambda h: h.inertia and h.weight != "force",
    "damping": lambda h: bool(h.damping),
    "viscoelasticity": lambda h: h.creep,
    "fittings": lambda h: h.fittings,
}
SENTENCES = {
    "inertia": "The beam's own mass keeps it from taking every equilibrium at once: it overshoots and rings.",
    "added_mass": "The hung weight acts as a mass, not as a force alone.",
    "damping": "Something takes the ringing's energy within a few periods.",
    "viscoelasticity": "The material creeps: a part of the way to the settled pose takes several periods.",
    "fittings": "The tip carries a few grams that the model leaves out: markers and what holds them.",
    "force_timing": "The support gave way late or slowly.",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Effect:
    """A cause in the best hypothesis, beside the best one without it."""

    name: str
    gained: float  # nats
    explained: float  # share of what is wrong without it
    without: Fit

    @property
    def named(self) -> bool:
        """Whether the evidence is beyond doubt."""
        return self.gained > BETTER


@dataclass(frozen=True, kw_only=True)
class Question:
    """How a cause works: the answers that the takes leave open, best first, and those they reject."""

    cause: str
    answers: tuple[tuple[str, float], ...]  # words, nats behind the best
    margin: float  # nats by which an answer must lie behind to be rejected

    @property
    def open(self) -> tuple[str, ...]:
        """The answers that stay."""
        return tuple(words for words, behind in self.answers if behind < self.margin)


@dataclass(frozen=True, kw_only=True, eq=False)
class Judgement:
    """kind: named, ambiguous, unexplained or no_misfit."""

    kind: str
    best: Fit
    baseline: Fit
    effective: float  # independent residuals among all that were fitted
    effects: tuple[Effect, ...]  # of the best hypothesis, in the order of HAS
    questions: tuple[Question, ...]
    z: float  # misfit of the quasi-static model, in standard deviations beyond its own error on settled poses
    z_after: float
    explained: float

    @property
    def named(self) -> tuple[Effect, ...]:
        """The causes that are beyond doubt."""
        return tuple(e for e in self.effects if e.named) if self.kind == "named" else ()


def judge(fits: Sequence[Fit], effective: float, tolerance: float) -> Judgement:
    """Compare fits of the same takes, the quasi-static one among them; tolerance [m]: its error on settled poses."""
    evidence = {fit.hypothesis: fit.evidence(effective) for fit in fits}
    top = max(evidence.values())
    leaders = sorted((f for f in fits if top - evidence[f.hypothesis] < TIE), key=lambda f: -evidence[f.hypothesis])
    best = next((f for f in leaders if f.hypothesis.native), leaders[0])
    baseline = next(f for f in fits if f.hypothesis == QUASI_STATIC)
    z, after = (misfit(f.sigma, tolerance, effective) for f in (baseline, best))
    explained = 1 - best.sigma**2 / baseline.sigma**2
    effects = []
    for name, has in HAS.items():
        others = [f for f in fits if not has(f.hypothesis)]
        if has(best.hypothesis) and others:
            rival = max(others, key=lambda f: evidence[f.hypothesis])
            gained = evidence[best.hypothesis] - evidence[rival.hypothesis]
            share = 1 - best.sigma**2 / rival.sigma**2
            effects.append(Effect(name=name, gained=gained, explained=share, without=rival))
    total = evidence[best.hypothesis] - evidence[QUASI_STATIC]
    if z < MISFIT:
        kind = "no_misfit"
    elif total < BETTER or explained < EXPLAINED:
        kind = "unexplained"
    else:
        kind = "named" if any(e.named for e in effects) else "ambiguous"
    return Judgement(
        kind=kind, best=best, baseline=baseline, effective=effective, effects=tuple(effects), z=z, z_after=after,
        explained=explained, questions=tuple(_questions(fits, evidence, effects)),
    )  # fmt: skip


def misfit(sigma: float, tolerance: float, effective: float) -> float:
    """z of residuals of size sigma [m] against `tolerance` [m]: (E - mean) / sd of their energy."""
    return float((sigma**2 / tolerance**2 - 1) * np.sqrt(effective / 2))


def _questions(fits: Sequence[Fit], evidence: dict, effects: Sequence[Effect]) -> list[Question]:
    """How the damping works, and how the weight hangs: the best evidence of each answer."""
    found = []
    for cause, key in (("damping", lambda h: h.damping), ("added_mass", lambda h: h.weight)):
        effect = next((e for e in effects if e.name == cause and e.named), None)
        if effect is None:
            continue
        tops: dict[object, float] = {}
        for fit in fits:
            if HAS[cause](fit.hypothesis):
                answer = key(fit.hypothesis)
                tops[answer] = max(tops.get(answer, -np.inf), evidence[fit.hypothesis])
        top = max(tops.values())
        ranked = sorted(((_words(cause, answer), top - value) for answer, value in tops.items()), key=lambda a: a[1])
        margin = max(APART, APART_SHARE * effect.gained)
        found.append(Question(cause=cause, answers=tuple(ranked), margin=margin))
    return found


def _words(cause: str, answer: object) -> str:
    return WEIGHTS[answer] if cause == "added_mass" else KINDS[answer]


def representatives(j: Judgement, fits: Sequence[Fit]) -> list[Fit]:
    """The few fits that tell the story, best first: each answer's best, the best without each cause, those at rest."""
    ranked = sorted(fits, key=lambda f: -f.evidence(j.effective))
    keys = (lambda h: h.damping, lambda h: h.weight, lambda h: (h.fitted, h.fittings))
    chosen = [j.best, *(e.without for e in j.effects)]
    for key in keys:
        answers = {key(f.hypothesis): f for f in reversed(ranked) if f.hypothesis.inertia == j.best.hypothesis.inertia}
        chosen += answers.values()
    chosen += [f for f in fits if not f.hypothesis.inertia or f.hypothesis == Hypothesis(inertia=True)]
    return [f for f in ranked if any(f is c for c in chosen)]
