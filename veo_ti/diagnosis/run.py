"""The diagnosis from start to end: baseline, noise, misfit, scores, refits, verdict, gain, and a second cause."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from veo_ti.diagnosis.baseline import Baseline
from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.gain import Gain, measure_gain
from veo_ti.diagnosis.looks import Progress
from veo_ti.diagnosis.model import OURS, Model, Refit
from veo_ti.diagnosis.noise import Noise, counted, measure_noise
from veo_ti.diagnosis.pairs import two_at_once
from veo_ti.diagnosis.rounds import Round, look, told_apart, with_more
from veo_ti.diagnosis.verdict import CLEAR, MISFIT, Candidate, Verdict, stands, unexplained
from veo_ti.diagnosis.visible import Left
from veo_ti.identification import Identification


@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnosis:
    """What the simulation gets wrong, and how sure that is."""

    identification: Identification
    noise: Noise
    baseline: Refit  # before any cause
    final: Refit  # with the named causes, and the likeliest of what else it may be; the baseline where none is named
    rounds: tuple[Round, ...]
    untestable: dict[str, str]  # cause -> why
    gain: Gain | None
    seconds: float

    @property
    def verdict(self) -> Verdict:
        """The first round's verdict."""
        return self.rounds[0].verdict

    @property
    def named(self) -> tuple[Candidate, ...]:
        """The causes that were named, in order."""
        return tuple(r.verdict.causes[0] for r in self.rounds if r.verdict.kind == "named")


def diagnose(
    identification: Identification, causes: Sequence[Cause], *, second: bool = True, progress: Progress | None = None
) -> Diagnosis:
    """Find what an identified object's simulation gets wrong.

    second: after a cause was named, look for another in what is left.
    """
    began, say = time.perf_counter(), progress or (lambda text: None)
    start = Baseline.of(identification, say)
    baseline, model, noise, modes = start.refit, start.model, start.noise, start.modes
    scene = baseline.scene
    reasons = {cause.name: cause.untestable(scene) for cause in causes}
    open_causes = [cause for cause in causes if reasons[cause.name] is None]

    def narrower(found: Candidate) -> tuple[Model, float]:
        """The model and the floor once a cause is part of it: what it explains was no noise."""
        left = found.refit.left
        less = replace(noise, correlation=min(noise.correlation, measure_noise(left, modes).correlation))
        prior = found.refit.prior[: len(found.refit.coefficients)]
        return replace(model, s2=counted(left, less, modes), prior=prior), less.variance

    first = look(baseline, model, noise.variance, modes, open_causes, say)

    def again(more: Sequence[Refit]) -> Round:
        return with_more(first, more, baseline, model, noise.variance, modes)

    rounds = _rounds(first, narrower, modes, open_causes if second else (), say, again)
    if len(rounds) == 1:
        rounds = [told_apart(rounds[0], baseline, model, rounds[0].s2, say)]
    current = next((r.extended for r in reversed(rounds) if r.extended is not None), baseline)
    return Diagnosis(
        identification=identification, noise=noise, baseline=baseline, final=current, rounds=tuple(rounds),
        untestable={name: reason for name, reason in reasons.items() if reason}, seconds=time.perf_counter() - began,
        gain=measure_gain(
            scene.target, scene.train, sigma=noise.sigma,
            models={
                "before": baseline.shown, "homogeneous": identification.baseline.y,
                "after": current.shown + (scene.target.y - current.scene.target.y), "no_change": identification.rest.y,
            },
        ),
    )  # fmt: skip


def _rounds(
    first: Round, narrower: Callable[[Candidate], tuple[Model, float]], modes: np.ndarray, causes: Sequence[Cause],
    say: Progress, again: Callable[[Sequence[Refit]], Round],
) -> list[Round]:  # fmt: skip
    """The first look; a second one beside what it named, if that explains enough; else two causes at once, which may
    also tell apart those of which each leaves clear misfit.

    None is looked for in what is as small as the simulation's own error, of the motion or of what the named cause does.
    """
    kind, found = first.verdict.kind, first.verdict.causes[:1]
    if kind == "named" and stands(found):
        others = [cause for cause in causes if cause.name != found[0].name]
        model, floor = narrower(found[0])
        if not others or found[0].misfit.z < MISFIT or 1 - found[0].explained < OURS**2:
            return [first]
        taken = found[0].refit.taken_in()
        if not Left.by(taken, model.s2, measure_noise(taken.scene, modes).local, modes, shadow=True).visible:
            return [first]
        more = look(found[0].refit, model, floor, modes, others, say, shadow=True)
        return [first, told_apart(more, found[0].refit, model, more.s2, say)]
    if kind == "no_misfit" or (kind == "ambiguous" and found[0].misfit.z < CLEAR):
        return [first]
    alone = replace(first, verdict=unexplained(found), extended=None) if kind == "named" else first
    return list(two_at_once(alone, narrower, modes, causes, say, again) or [alone])
