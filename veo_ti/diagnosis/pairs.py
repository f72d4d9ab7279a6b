"""Where no cause alone explains what is wrong: two that do together."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.model import Model
from veo_ti.diagnosis.rounds import Progress, Round, look
from veo_ti.diagnosis.verdict import APART, APART_SHARE, BETTER, EXPLAINED, Candidate, named, stands

_STARTS = 2  # causes that a second one is looked for beside


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pair:
    first: Candidate
    second: Candidate  # refitted together with the first
    found: Round

    @property
    def names(self) -> frozenset[str]:
        return frozenset((self.first.name, self.second.name))


def two_at_once(
    alone: Round, narrower: Callable[[Candidate], tuple[Model, float]], modes: np.ndarray, causes: Sequence[Cause],
    say: Progress,
) -> tuple[Round, Round] | None:  # fmt: skip
    """Two rounds that name one cause each, or None: no two explain most of what is wrong, or several pairs do.

    alone: a round whose verdict is "unexplained"; narrower(candidate): model and floor once that cause is part of it.
    A second cause is looked for beside each of the two that explain most, at least half; both are refitted together.
    """
    starts = [
        c for c in alone.candidates if min(c.gained, c.predicted) > BETTER and c.plausible and c.explained > EXPLAINED
    ]
    pairs: list[_Pair] = []
    for start in sorted(starts, key=lambda c: -c.explained)[: _STARTS if causes else 0]:
        say(f"two at once, {start.name} and another")
        model, floor = narrower(start)
        found = look(start.refit, model, floor, modes, [c for c in causes if c.name != start.name], say)
        pairs += [_Pair(first=start, second=c, found=found) for c in found.candidates if _holds(start, c)]
    best = _clear(pairs)
    if best is None:
        return None
    return replace(alone, verdict=named(best.first)), replace(best.found, verdict=named(best.second))


def _holds(first: Candidate, second: Candidate) -> bool:
    """Whether a pair may be named: each adds to the other, and what is wrong is explained."""
    adds = min(second.gained, second.predicted) > BETTER and second.plausible and second.settled
    return adds and stands((first, second))


def _clear(pairs: Sequence[_Pair]) -> _Pair | None:
    """The best pair, unless another one is nearly as good; all are compared at the noise that the best of them left."""
    if not pairs:
        return None
    s2 = min(p.found.s2 for p in pairs)
    worth = {id(p): p.second.refit.evidence(s2) for p in pairs}
    best = max(pairs, key=lambda p: worth[id(p)])
    gained = best.first.gained + best.second.gained
    margin = max(APART, APART_SHARE * gained)
    rivals = [p for p in pairs if p.names != best.names and worth[id(best)] - worth[id(p)] < margin]
    return None if rivals else best
