"""The verdict: what the scores and the refits allow to be said, with the thresholds in one place."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from veo_ti.diagnosis.causes.beside import Beside
from veo_ti.diagnosis.fitted import Refit, ours_of
from veo_ti.diagnosis.misfit import Misfit

MISFIT = 4.0  # standard deviations of the misfit's energy below which nothing is wrong
BETTER = 6.0  # nats that a cause must gain over the baseline
APART = 5.0  # nats, and
APART_SHARE = 0.15  # share of the best cause's gain, by which the next one must lie behind; but
CLEAN = 10.0  # standard deviations of misfit below which a cause leaves so little that its evidence can be trusted,
NOTHING = 5e-4  # or share of what is wrong, however clear:
SURE = 12.0  # nats then, or as many as what it leaves is worth, or as the simulation's own error can turn about
BY_CHANCE = 0.3  # of noise that neighbours share, what one of two that leave it may take up better than the other
EXPLAINED = 0.5  # share of the misfit's excess that a cause must explain to be weighed at all
LEFT = 0.1  # share that a cause may leave and still reject others by what they leave,
MORE = 5.0  # times as much
NOISE_ALONE = 5e-4  # share by which one cause that leaves noise rejects another, of which
ENDED = 0.05  # of the cost, at most, is still promised
CHANCE = 0.05  # of alike causes, by which all but one would look like that one by coincidence: it is that one
TOGETHER = 0.9  # share that a named cause must explain: of what is wrong, or of what the first one leaves; and
BOTH = 0.96  # two together, where none of them does alone: two can imitate more than one; and
CLEAR = 20.0  # standard deviations of misfit, beyond which no more than half as much may be left, of two an eighth, and
LITTLE = 0.02  # no more than this share where nothing explains it
TESTABLE = 0.05  # share of a fingerprint that the nuisances must leave for the cause to be told by it, and
SURVIVES = 0.5  # in the shadow of one that explains most


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A refitted cause beside the baseline."""

    refit: Refit
    gained: float  # nats of evidence over the baseline
    predicted: float  # nats by which it predicts training blocks better that were left out
    misfit: Misfit  # what is left under it
    explained: float  # share of the baseline's excess
    plausible: bool  # sign and size are what physics allows
    settled: bool  # the refit came to an end, or near enough to it to be compared
    coincidence: float = 1.0  # how likely its parameters are by chance, over how likely a law of theirs makes them
    unlike: Mapping[str, np.ndarray] = field(default_factory=dict)  # how far others are from it, at P places, (P, n)
    testable: bool = True  # a change of the material does not imitate it
    certain: bool = True  # the interval of one of its own parameters leaves out that it is absent
    like_noise: bool = False  # what is left goes on as evenly as noise that neighbours share
    visible: bool = True  # what is left is more than the simulation's own error beside the cause may be

    @property
    def able(self) -> bool:
        """Whether it may be the cause: evidence, what was left out and physics speak for it."""
        return min(self.gained, self.predicted) > BETTER and self.plausible

    @property
    def promised(self) -> float:
        """Nats that a further step only promises: what was gained counts them."""
        return 0.0 if self.refit.converged else self.refit.short

    @property
    def sure(self) -> float:
        """Nats that were gained without them."""
        return self.gained - self.promised

    @property
    def left(self) -> float:
        """Share of what is wrong that it leaves; where that goes on like noise, as much as may differ by chance."""
        return (BY_CHANCE if self.like_noise else 1.0) * (1 - self.explained)

    @property
    def clear(self) -> bool:
        """Whether clear misfit stays that does not go on like noise."""
        return self.misfit.z > CLEAR and not self.like_noise

    @property
    def name(self) -> str:
        """The cause's name."""
        return self.refit.cause.name

    def chance(self, others: Iterable[str], left: float, nats: float) -> float:
        """Bayes' factor of one of others against this one, which explains all but the share `left` of `nats`.

        Another one would obey the law of this one's parameters by chance, and act by chance where and how this one can
        imitate it: but for twice what this one leaves, or what would be seen.
        """
        near = 2 * np.sqrt(max(left, SURE / max(nats, 1e-300)))
        there = [self.unlike.get(name) for name in others]
        shares = [1.0 if u is None else (1 + (u < near).mean() * len(u)) / (1 + len(u)) for u in there]
        return self.coincidence * max(shares, default=1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Verdict:
    """kind: named, ambiguous, unexplained or no_misfit; causes: the named one, or those that cannot be told apart."""

    kind: str
    causes: tuple[Candidate, ...]
    sentence: str


def _rejected(rival: Candidate, best: Candidate) -> bool:
    """Whether what is left tells the two apart: next to nothing under the best one, clearly more under the other, and
    more than our own error of its effect, which the true one may leave as well; the other's refit came to an end: of
    one that stopped on its way, nobody knows what it would leave.

    A wrong cause hardly takes up our error of the true one as well: where one alone leaves noise, that counts less.
    """
    left, other = 1 - best.explained, 1 - rival.explained
    noise, alone = best.misfit.z < MISFIT, not isinstance(rival.refit.cause, Beside)
    ended = rival.promised < ENDED * rival.refit.cost
    ours = NOISE_ALONE if noise and alone and ended else ours_of(best.refit, rival.refit) ** 2
    clean = noise or left < LEFT
    return clean and rival.settled and rival.misfit.z > 2 * MISFIT and other > max(MORE * left, ours)


def _alone_leaves_little(cause: Candidate, able: Sequence[Candidate], little: float) -> bool:
    """Whether it does, and all others leave clearly more: of such a cause enough was seen, however much of its effect a
    change of the material imitates."""
    left, others = 1 - cause.explained, [c for c in able if c is not cause]
    return left < little and all(c.misfit.z > 2 * MISFIT and 1 - c.explained > MORE * left for c in others)


def _margin(best: Candidate, rival: Candidate, wide: bool) -> float:
    """Nats by which another cause must lie behind: much, unless the best one leaves next to nothing unexplained. What
    goes on like noise that neighbours share is nothing as well once all that promise something were fitted: before
    that, it may be what the true cause does that is like noise.

    An effect of s standard deviations gains s^2/2 nats, and causes that show it d apart differ by d^2/2 of them. Our
    error of OURS s turns the order about where d < 2 OURS s.
    """
    if best.misfit.z < CLEAN or 1 - best.explained < NOTHING or (wide and best.like_noise):
        ours = (2 * ours_of(best.refit, rival.refit)) ** 2
        return max(SURE, best.left / best.explained * best.gained, ours * best.gained)
    return max(APART, APART_SHARE * best.gained)


def rivals(best: Candidate, others: Sequence[Candidate], *, wide: bool = False) -> list[Candidate]:
    """Those of others that may as well be the cause: nearly as likely, and not ruled out by what they leave; wide:
    whether all that promise something are among them."""
    near = [c for c in others if c is not best and best.sure - c.gained < _margin(best, c, wide)]
    return [c for c in near if not _rejected(c, best)]


def nothing(*, even: bool = False, faint: bool = False) -> Verdict:
    """What is left is noise, or as small as the simulation's own error; even: noise that neighbours share; faint: more
    than either, but little, and no known cause explains it."""
    sentence = "Nothing is wrong that this measurement could show: the simulation is as good as its noise allows."
    if faint:
        sentence = "Hardly more is left than noise and the simulation's own error, and no known cause explains it."
    if even:
        sentence += " What is left is as strong in all frames, whatever the load: noise that neighbours share."
    return Verdict(kind="no_misfit", causes=(), sentence=sentence)


def judge(
    misfit: Misfit, candidates: Sequence[Candidate], *, shadow: bool = False, wide: bool = False
) -> Verdict:  # fmt: skip
    """The verdict on one round; shadow: whether it is beside a cause that explains most, where one must explain more to
    be named or one of several; wide: whether all that promise something were refitted. What may well be absent is not
    named, nor what is not testable, unless it alone leaves little (in the shadow, no more than it must); but another is
    not either beside it. One that obeys a law is told by it unless it leaves clear misfit, and another clearly less."""
    if misfit.z < MISFIT:
        return nothing()
    least, little = (TOGETHER, 1 - TOGETHER) if shadow else (EXPLAINED, LITTLE if wide else -math.inf)
    able = [c for c in candidates if c.able]
    told = [c for c in able if c.testable or _alone_leaves_little(c, able, little)]
    accepted = sorted((c for c in told if c.settled and c.certain), key=lambda c: -c.sure)
    if not accepted or accepted[0].explained < least:
        return unexplained(accepted[:1])
    best = accepted[0]
    near = rivals(best, able, wide=wide)
    if near and best.explained < TOGETHER and not best.like_noise:
        return unexplained(accepted[:1])
    alike = (best, *near)
    names = {c.name for c in alike}
    lawful = [
        c for c in alike
        if c in accepted and c.explained > TOGETHER and c.misfit.z <= lawful_up_to(alike)
        and c.chance(names - {c.name}, c.left, c.gained) < CHANCE
    ]  # fmt: skip
    if near and len(lawful) != 1:
        return either(alike)
    return named(lawful[0] if near else best)


def lawful_up_to(alike: Iterable[Candidate]) -> float:
    """Standard deviations of misfit beyond which no law tells one: it leaves clear misfit, and another clearly less."""
    return MISFIT + max(0.0, min(c.misfit.z for c in alike))


def either(causes: Sequence[Candidate]) -> Verdict:
    """Each of several causes would do."""
    sentence = "This measurement cannot tell these causes apart: " + ", ".join(c.name for c in causes) + "."
    return Verdict(kind="ambiguous", causes=tuple(causes), sentence=sentence)


def named(cause: Candidate) -> Verdict:
    """One cause explains what is wrong."""
    return Verdict(kind="named", causes=(cause,), sentence=cause.refit.cause.sentence)


def unexplained(nearest: Sequence[Candidate]) -> Verdict:
    """Nothing known explains it well enough; what comes nearest is mentioned, not named."""
    near = "".join(f" The nearest is {c.name}, which explains {c.explained:.0%}." for c in nearest)
    sentence = f"The simulation is wrong beyond noise, and no known cause explains it well enough.{near}"
    return Verdict(kind="unexplained", causes=(), sentence=sentence)


def stands(causes: Sequence[Candidate]) -> bool:
    """Whether the causes named one after the other explain enough together for any of them to be named: all but noise
    that neighbours share, or nearly all."""
    last = causes[-1]
    may_leave, of_it = (1 - TOGETHER, 1 / 2) if len(causes) == 1 else (1 - BOTH, 1 / 8)
    return last.like_noise or 1 - explained_by(causes) <= may_leave * (of_it if last.clear else 1)


def doubtful(candidate: Candidate) -> bool:
    """Whether it leaves more than noise and our own error, of the motion and of what it does."""
    return candidate.visible and candidate.misfit.z > MISFIT and 1 - candidate.explained > ours_of(candidate.refit) ** 2


def leaves_clearly(candidate: Candidate) -> bool:
    """Whether that is clear misfit: another may be the cause."""
    return candidate.clear and doubtful(candidate)


def leaves_much(candidate: Candidate) -> bool:
    """Whether too much is left, and clearly, for its name if nothing explains that; of a plain law, all but noise."""
    if candidate.refit.cause.plain:
        return candidate.misfit.z > CLEAN and doubtful(candidate) and not candidate.like_noise
    return candidate.clear and 1 - candidate.explained > LITTLE


def sufficient(candidate: Candidate) -> bool:
    """Whether it may be all that is wrong: possible, no image of another material, not absent, explaining enough."""
    return candidate.plausible and candidate.testable and candidate.certain and stands([candidate])


def nearly_all(candidate: Candidate) -> bool:
    """Whether it is, and leaves little: much that goes on like noise is none where another cause leaves less."""
    return sufficient(candidate) and candidate.explained > TOGETHER


def explained_by(causes: Sequence[Candidate]) -> float:
    """Share of what was wrong that causes explain together, each found beside those before it."""
    return 1 - math.prod(1 - c.explained for c in causes)
