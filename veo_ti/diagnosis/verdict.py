"""The verdict: what the scores and the refits allow to be said, with the thresholds in one place."""

from collections.abc import Sequence
from dataclasses import dataclass

from veo_ti.diagnosis.refit import Refit
from veo_ti.diagnosis.score import Misfit

MISFIT = 4.0  # standard deviations of the misfit's energy below which nothing is wrong
BETTER = 6.0  # nats that a cause must gain over the baseline
APART = 5.0  # nats, and
APART_SHARE = 0.15  # share of the best cause's gain, by which the next one must lie behind
EXPLAINED = 0.5  # share of the misfit's excess that a named cause must explain


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A refitted cause beside the baseline."""

    refit: Refit
    gained: float  # nats of evidence over the baseline
    misfit: Misfit  # what is left under it
    explained: float  # share of the baseline's excess
    plausible: bool  # sign and size are what physics allows

    @property
    def name(self) -> str:
        """The cause's name."""
        return self.refit.cause.name


@dataclass(frozen=True, kw_only=True, eq=False)
class Verdict:
    """kind: named, ambiguous, unexplained or no_misfit; causes: the named one, or those that cannot be told apart."""

    kind: str
    causes: tuple[Candidate, ...]
    sentence: str


def _rejected(rival: Candidate, best: Candidate) -> bool:
    """Whether what is left tells the two apart: nothing but noise under one, clear misfit under the other."""
    return best.misfit.z < MISFIT and rival.misfit.z > 2 * MISFIT


def judge(misfit: Misfit, candidates: Sequence[Candidate]) -> Verdict:
    """The verdict on one round."""
    if misfit.z < MISFIT:
        return Verdict(
            kind="no_misfit", causes=(), sentence="The simulation is as good as the measurement's noise allows."
        )
    accepted = [c for c in candidates if c.gained > BETTER and c.plausible]
    accepted.sort(key=lambda c: -c.gained)
    if not accepted or accepted[0].explained < EXPLAINED:
        best = f" The nearest is {accepted[0].name}, which explains {accepted[0].explained:.0%}." if accepted else ""
        return Verdict(
            kind="unexplained", causes=(),
            sentence=f"The simulation is wrong beyond noise, and no known cause explains most of it.{best}",
        )  # fmt: skip
    best = accepted[0]
    margin = max(APART, APART_SHARE * best.gained)
    rivals = [c for c in accepted[1:] if best.gained - c.gained < margin and not _rejected(c, best)]
    if rivals:
        names = ", ".join(c.name for c in (best, *rivals))
        return Verdict(
            kind="ambiguous", causes=(best, *rivals),
            sentence=f"This measurement cannot tell these causes apart: {names}.",
        )  # fmt: skip
    return Verdict(kind="named", causes=(best,), sentence=best.refit.cause.sentence)
