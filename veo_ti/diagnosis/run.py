"""The diagnosis from start to end: baseline, noise, misfit, scores, refits, verdict, gain, and a second cause."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sim.checks import require
from veo_ti.diagnosis.baseline import Baseline
from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.checkpoints import Checkpoints
from veo_ti.diagnosis.effort import STEPS, Effort
from veo_ti.diagnosis.fitted import Refit, everywhere, ours_of
from veo_ti.diagnosis.gain import Gain, measure_gain
from veo_ti.diagnosis.intervals import unsure_of_place
from veo_ti.diagnosis.looks import Progress
from veo_ti.diagnosis.noise import Noise
from veo_ti.diagnosis.pairs import two_at_once
from veo_ti.diagnosis.rounds import Round, look, told_apart, widened, with_more
from veo_ti.diagnosis.verdict import (
    CLEAR,
    Candidate,
    Verdict,
    doubtful,
    either,
    leaves_much,
    nearly_all,
    stands,
    unexplained,
)
from veo_ti.identification import Identification
from veo_ti.kept import key_of


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
    steps: float  # of Newton's for all frames, that it took
    finished: bool = True  # whether all was looked for that was worth a look

    @property
    def verdict(self) -> Verdict:
        """The first round's verdict."""
        return self.rounds[0].verdict

    @property
    def named(self) -> tuple[Candidate, ...]:
        """The causes that were named, in order."""
        return tuple(r.verdict.causes[0] for r in self.rounds if r.verdict.kind == "named")


def diagnose(
    identification: Identification, causes: Sequence[Cause], *, second: bool = True, effort: float = STEPS,
    checkpoints: Path | None = None, progress: Progress | None = None,
    so_far: Callable[[Diagnosis], None] | None = None,
) -> Diagnosis:  # fmt: skip
    """Find what an identified object's simulation gets wrong.

    second: after the first look, look for another cause in what is left, or for two at once, which may take several
    times as long; so_far is given what the first look says before that begins. effort: Newton's steps of all frames,
    after which no further look begins; what such a look would have said is not guessed. checkpoints: a folder where
    every fit's end is kept; an interrupted call with the same measurement, options and causes goes on from there.
    """
    require(effort > 0, "effort", "be positive", effort)
    began, say = time.perf_counter(), progress or (lambda text: None)
    kept = Checkpoints(folder=checkpoints, key=key_of(identification.key, *(cause.name for cause in causes)))
    start = Baseline.of(identification, say, Effort(most=effort), kept)
    reasons = {cause.name: cause.untestable(start.refit.scene) for cause in causes}
    open_causes = [cause for cause in causes if reasons[cause.name] is None]

    def told(rounds: Sequence[Round], *, finished: bool) -> Diagnosis:
        wrong = {c.name: _wrong(c) for found in rounds for c in found.verdict.causes}
        rounds = [_with_places(found, wrong) for found in rounds]
        extended = next((r.extended for r in reversed(rounds) if r.extended is not None), None)
        final = start.refit if extended is None else everywhere(extended)
        return Diagnosis(
            identification=identification, noise=start.noise, baseline=start.refit, final=final, rounds=tuple(rounds),
            untestable={name: reason for name, reason in reasons.items() if reason}, finished=finished,
            gain=_gain(identification, start, final), seconds=time.perf_counter() - began,
            steps=start.model.effort.spent,
        )  # fmt: skip

    first = look(*start.given, open_causes, say)

    def say_after_the_first(text: str) -> None:
        nonlocal so_far
        if so_far is not None:
            so_far(told([first], finished=False))
            so_far = None
        say(text)

    rounds = _rounds(first, start, open_causes if second else (), say_after_the_first)
    if len(rounds) == 1:
        rounds = [told_apart(rounds[0], start.refit, start.model, rounds[0].s2, say)]
    return told(rounds, finished=not start.model.effort.over)


def _wrong(found: Candidate) -> float:
    """Nats that what the simulation gets wrong of a cause may be worth: no more than what it leaves."""
    return min(ours_of(found.refit) ** 2, max(1 - found.explained, 0.0)) * found.gained


def _with_places(found: Round, wrong: Mapping[str, float]) -> Round:
    """A round whose intervals hold how unsure the places of its causes are."""
    refits = [*(c.refit for c in found.verdict.causes), *([] if found.extended is None else [found.extended])]
    placed = {id(r): unsure_of_place(r, wrong) for r in {id(r): r for r in refits}.values()}  # often one and the same
    causes = tuple(replace(c, refit=placed[id(c.refit)]) for c in found.verdict.causes)
    return replace(found, verdict=replace(found.verdict, causes=causes), extended=placed.get(id(found.extended)))


def _gain(identification: Identification, start: Baseline, final: Refit) -> Gain | None:
    """What the final model gains on held-out frames."""
    scene = start.refit.scene
    return measure_gain(
        scene.target, scene.train, sigma=start.noise.sigma,
        models={
            "before": start.refit.shown, "homogeneous": identification.baseline.y,
            "after": final.shown + (scene.target.y - final.scene.target.y), "no_change": identification.rest.y,
        },
    )  # fmt: skip


def _rounds(
    first: Round, start: Baseline, causes: Sequence[Cause], say: Progress, *, wide: bool = False
) -> list[Round]:  # fmt: skip
    """The first look; a second one beside what it named, if that explains enough; else two causes at once, which may
    also tell apart those of which each leaves clear misfit. Before that all that promise something are refitted.

    wide: whether they were. A look that the effort did not last for says nothing.
    """
    kind, found = first.verdict.kind, first.verdict.causes[:1]
    if kind == "named" and stands(found):
        return _besides(first, start, causes, say, wide=wide)
    if kind == "no_misfit" or (kind == "ambiguous" and found[0].misfit.z < CLEAR):
        return [first]
    if wide or not causes or start.model.effort.over:
        return _pair(first, start, causes, say)
    return _rounds(widened(first, *start.given, say), start, causes, say, wide=True)


def _besides(first: Round, start: Baseline, causes: Sequence[Cause], say: Progress, *, wide: bool) -> list[Round]:
    """The first look and one beside what it named.

    Where nothing is known that explains what a named cause leaves, and that is more than it may leave itself, all that
    promise something are refitted: another may explain it. If nothing explains it, that is no reason against another
    which leaves more, but explains nearly all as well: either may be there, beside something else. Without such
    another, the cause itself may only imitate what is there, if what it leaves is clear and more than a little (of a
    plain law more than noise, even where that is below the simulation's own error of the motion), or its fit did not
    come to an end: a prestress passed for a tilt, 1584 standard deviations left (7741). What an exact cause
    leaves may go on like noise and be clear: then it may imitate two that act all the time.
    """
    found, more = first.verdict.causes[0], _second(first.verdict.causes[0], start, causes, say)
    if start.model.effort.over:
        return [_unexplained(first)] if leaves_much(found) else [first]
    both = [first] if more is None else [first, more]
    lost = more is not None and (more.verdict.kind == "unexplained" or (found.refit.cause.plain and leaves_much(found)))
    if (more is not None and more.verdict.causes) or not (lost or (causes and doubtful(found))):
        return both
    wider = first if wide else widened(first, *start.given, say)
    name = wider.verdict.causes[0].name if wider.verdict.kind == "named" else None
    if name != found.name and (name or not lost):
        return _rounds(wider, start, causes, say, wide=True)
    steady = not lost and more is not None and found.refit.cause.exact and found.misfit.z > CLEAR
    if not (lost or steady):
        return both
    near = [c for c in wider.candidates if c.name != found.name and c.able and c.settled and nearly_all(c)]
    if not near:
        unended = found.clear and not found.refit.converged
        return [_unexplained(first)] if lost and (leaves_much(found) or unended) else both
    unsure = replace(wider, verdict=either((found, *near)), extended=None)
    pair = _pair(unsure, start, causes, say, but=found.name)
    return pair if lost or len(pair) == 2 else both


def _second(found: Candidate, start: Baseline, causes: Sequence[Cause], say: Progress) -> Round | None:
    """The look beside a named cause; None in what is as small as the simulation's own error, of the motion or of what
    that cause does."""
    others = [cause for cause in causes if cause.name != found.name]
    if not others or not doubtful(found):
        return None
    model, floor = start.beside(found.refit)
    more = look(found.refit, model, floor, start.modes, others, say, shadow=True)
    return told_apart(more, found.refit, model, more.s2, say)


def _unexplained(found: Round) -> Round:
    """A look that named one, which now is only nearest."""
    return replace(found, verdict=unexplained(found.verdict.causes[:1]), extended=None)


def _pair(first: Round, start: Baseline, causes: Sequence[Cause], say: Progress, *, but: str = "") -> list[Round]:
    """Two causes at once instead of what the first look found alone, or that look, which then names none."""
    alone = _unexplained(first) if first.verdict.kind == "named" else first

    def again(more: Sequence[Refit]) -> Round:
        return with_more(alone, more, *start.given)

    pair = two_at_once(alone, start.beside, start.modes, causes, say, again, but=but)
    return [alone] if pair is None or start.model.effort.over else list(pair)
