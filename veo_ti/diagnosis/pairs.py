"""Where no cause alone explains what is wrong: two that do together."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.fitted import OURS, Refit
from veo_ti.diagnosis.looks import Progress
from veo_ti.diagnosis.model import Model
from veo_ti.diagnosis.refit import refit
from veo_ti.diagnosis.rounds import Round, look, told_apart
from veo_ti.diagnosis.verdict import (
    BETTER,
    CHANCE,
    CLEAN,
    EXPLAINED,
    LITTLE,
    MISFIT,
    TOGETHER,
    Candidate,
    either,
    explained_by,
    lawful_up_to,
    named,
    rivals,
    stands,
)

_STARTS, _MOST = 2, 4  # causes that a second one is looked for beside; and with those that explain
_ALIKE = 0.05  # less at most; a share of half is no sharp bound for two that each do half;
_SOME = 0.3  # and where none explains half, so much has to be: two may hide each other
_SURELY = 5.0  # times what counts, from which on a second cause is there wherever the first one is


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pair:
    first: Candidate
    second: Candidate  # refitted together with the first
    found: Round
    model: Model

    @property
    def names(self) -> frozenset[str]:
        return frozenset((self.first.name, self.second.name))

    def worth(self, s2: float) -> float:
        """Log evidence of both at a variance of the noise [m2]."""
        return self.second.refit.tuned(self.model, s2).evidence(s2)

    @property
    def needs_both(self) -> bool:
        """Whether the first one is worth as much beside the second as the second has to be beside it."""
        return _borne_out(self.second.refit.apart()[0]) > BETTER

    def alone(self, known: Sequence[Candidate], say: Progress) -> list[Refit]:
        """Either one refitted alone where it is beside the other, if it was not at that place and might do without."""
        at = replace(self.model, s2=self.found.s2)
        places = {c.name: c.refit.place for c in known if c.settled}
        parts, new = self.second.refit.apart(), []
        for own, other in (parts, parts[::-1]):
            cause, place = own.cause, own.place
            tried = cause.name in places and places[cause.name] is place  # places may be arrays
            if tried or _borne_out(other) > _SURELY * BETTER:
                continue
            say(f"{cause.name} alone, where it is beside {other.cause.name}")
            new.append(refit(self.first.refit.without, at, own.coefficients, cause=cause, place=place, theta=own.theta))
        return [one.tuned(at, at.s2) for one in new]

    def part(self, name: str) -> Candidate:
        """The one of that name, with the parameters that both have together."""
        chosen = self.first if self.first.name == name else self.second
        own = next(r for r in self.second.refit.apart() if r.cause.name == name)
        return replace(chosen, refit=own, coincidence=own.cause.coincidence(own.scene, own.theta, own.spread))

    def chance(self, name: str, others: frozenset[str]) -> float:
        """Bayes' factor of one of others against the one of that name, beside the other one of the two."""
        own, left = self.part(name), self.second.left  # of what the first one leaves
        if own.name == self.first.name:
            left *= (1 - self.first.explained) / self.first.explained
        return own.chance(others - self.names, left, own.refit.worth)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen:
    """What was found beside some starts."""

    pairs: tuple[_Pair, ...] = ()
    poorer: tuple[_Pair, ...] = ()  # that explain too little
    lone: tuple[Refit, ...] = ()  # one of two, refitted alone where it is beside the other

    def with_pair(self, pair: _Pair, alone: Round, say: Progress) -> "_Seen":
        """And another one, unless the first is worth too little in it, or either of the two does as well alone."""
        if not _explain(pair.first, pair.second, alone):
            return replace(self, poorer=(*self.poorer, pair))
        own, s2 = pair.alone(alone.candidates, say), pair.found.s2
        both = pair.needs_both and all(pair.worth(s2) - one.evidence(s2) > BETTER for one in own)
        return replace(self, pairs=(*self.pairs, pair) if both else self.pairs, lone=(*self.lone, *own))


def two_at_once(
    alone: Round, narrower: Callable[[Refit], tuple[Model, float]], modes: np.ndarray, causes: Sequence[Cause],
    say: Progress, again: Callable[[Sequence[Refit]], Round], *, but: str = "",
) -> tuple[Round, ...] | None:  # fmt: skip
    """Two rounds that name one cause each, or None: no two explain most of what is wrong, or several pairs do.

    alone: a round that named none; narrower(refit): model and floor once that cause is part of it; again(refits):
    the round with further refits; but: no start, since it was one before. Where one of two only had to move, and
    beside it the other adds too little, that round names it alone. A second cause is fitted beside each of the two
    that explain most, at least half (else as much as the one that explains most; where none does much, of those
    that promise far more together), and, if one is found, beside those that explain nearly as much. Then beside the
    second ones of the best pairs, or of the best that is fair: the first one may only imitate what goes with them.
    Where all pairs that come near have one cause in common, it is named and the second round ambiguous, unless one
    only of the others obeys a law; where each is one of some beside one of others, and the best leaves noise, both
    are.
    """
    able = [c for c in alone.candidates if c.able and c.testable and c.name != but]
    some = [c for c in able if c.explained > _SOME] or [c for c in able if c.name in alone.both]
    able = sorted(some, key=lambda c: -c.explained)
    able = [c for c in able if c.explained > min(EXPLAINED, able[0].explained - _ALIKE)]

    def beside(seen: _Seen, start: Candidate) -> _Seen:
        model, floor = narrower(start.refit)
        if model.effort.over:
            return seen
        say(f"two at once, {start.name} and another")
        others = [c for c in causes if c.name != start.name]
        least = min((p.found.tried.least for p in seen.pairs), default=np.inf)
        found = look(start.refit, model, floor, modes, others, say, shadow=stands([start]), least=least)
        for second in (c for c in found.candidates if c.able):
            seen = seen.with_pair(_Pair(first=start, second=second, found=found, model=model), alone, say)
        return seen

    starts, seen, begun = able[: _MOST if causes else 0], _Seen(), 0
    starts = [c for c in starts if c.explained > starts[:_STARTS][-1].explained - _ALIKE]
    for n, start in enumerate(starts):
        if n < _STARTS or seen.pairs or seen.lone:
            seen, begun = beside(seen, start), n + 1
    share, name = max(((explained_by((p.first, p.second)), p.second.name) for p in seen.poorer), default=(0.0, ""))
    partners = {p.second.name for p in _near(seen.pairs)} or ({name} if share > TOGETHER else set())
    for partner in [c for c in able if c not in starts[:begun] and c.name in partners]:
        seen = beside(seen, partner)
    single = again(seen.lone) if seen.lone else alone
    pairs = [p for p in seen.pairs if _explain(p.first, p.second, single)]
    enough = single.verdict.kind == "named" and stands(single.verdict.causes)
    if enough and (not pairs or single.verdict.causes[0].misfit.z < MISFIT):
        return (single,)
    near = _near(pairs, seen.poorer)
    if not near or not near[0].second.settled:
        return None
    best = near[0] if len(near) == 1 else _lawful(near)
    if best:
        return (
            replace(alone, verdict=named(best.first), extended=best.first.refit),
            replace(best.found, verdict=named(best.second), extended=best.second.refit),
        )
    sides = _sides(near)
    return _each_of(alone, near, *sides, say) if sides else None


def _lawful(near: Sequence[_Pair]) -> _Pair | None:
    """Of pairs that have one cause in common, the only one whose other cause obeys a law of its parameters as others
    would by chance alone; None where there is no such one."""
    common = frozenset.intersection(*(p.names for p in near))
    if len(common) != 1:
        return None
    others = frozenset.union(*(p.names for p in near)) - common
    most = lawful_up_to(p.second for p in near)
    able = [p for p in near if p.second.settled and p.second.misfit.z <= most]
    told = [p for p in able if p.chance(*(p.names - common), others) < CHANCE]
    return told[0] if len(told) == 1 else None


def _sides(near: Sequence[_Pair]) -> tuple[list[str], list[str]] | None:
    """The causes of which every pair has one, and the others of which it has one too, best first; the shorter first.

    None where the pairs are not of that kind, or leave too much to say that it must be one of these.
    """
    best = near[0]
    sides = [best.first.name], [best.second.name]
    for p in near * len(near):  # one that joins others may come after them
        for side, other in (sides, sides[::-1]):
            if not p.names.isdisjoint(other):
                side += sorted(p.names - {*side, *other})
    single = min(map(len, sides)) == 1
    apart = all(len(p.names & set(side)) == 1 for p in near for side in sides)
    if not apart or not (single or best.second.misfit.z < CLEAN):
        return None
    return sides if len(sides[0]) <= len(sides[1]) else sides[::-1]


def _each_of(
    alone: Round, near: Sequence[_Pair], some: Sequence[str], others: Sequence[str], say: Progress
) -> tuple[Round, Round]:
    """The cause that all pairs have in common, or those of which each has one, and those that could stand beside it."""
    best, joint = near[0], near[0].second.refit
    first, second = ([next(p for p in near if n in p.names).part(n) for n in side] for side in (some, others))
    single = len(first) == 1
    extended = joint if single else None
    one = replace(alone, verdict=named(first[0]) if single else either(first), extended=extended)
    other = replace(best.found, verdict=either(second), extended=extended)
    one, other = (told_apart(r, joint, best.model, best.found.s2, say) for r in (one, other))
    return one, other


def _explain(first: Candidate, second: Candidate, alone: Round) -> bool:
    """Whether two explain what is wrong, and the second one, which is able, is not absent.

    Where some cause explains nearly all alone, testable or not, two may be its image, and have to explain nearly all
    that it leaves, or most of it and all but our own error.
    """
    left = 1 - explained_by((first, second))
    there = second.certain and (second.testable or left < LITTLE)
    least = min((1 - c.explained for c in alone.candidates if c.plausible and stands([c])), default=None)
    if least is None:
        return there and stands((first, second))
    little = (1 - TOGETHER) * least
    return there and left <= max(little, min(2 * little, OURS**2))


def _borne_out(part: Refit) -> float:
    """Nats that one of two refitted causes is worth beside the other, to second order (Wald's test)."""
    return float(np.max((part.theta / np.maximum(part.sd, 1e-300)) ** 2)) / 2


def _near(pairs: Sequence[_Pair], poorer: Sequence[_Pair] = ()) -> list[_Pair]:
    """The best pair, then others that are nearly as good; all are compared at the noise that the best of them left.

    What a refit that did not end only promises counts for a rival, not for the best. What goes on like noise that
    neighbours share is nothing: no further look follows. poorer: pairs that explain too little to be named, which
    stand beside the best nevertheless where more evidence speaks for them.
    """
    if not pairs:
        return []
    s2 = min(p.found.s2 for p in pairs)
    worth = {id(p): p.worth(s2) for p in (*pairs, *poorer)}
    best, *others = sorted(pairs, key=lambda p: p.second.promised - worth[id(p)])
    gained = best.first.gained + best.second.gained

    def joint(p: _Pair) -> Candidate:
        """Both as one, beside nothing."""
        more = worth[id(p)] - worth[id(best)]
        return replace(p.second, gained=gained + more, explained=explained_by((p.first, p.second)))

    whole, near = joint(best), {best.names: best}
    for p in (*others, *(p for p in poorer if worth[id(p)] > worth[id(best)])):
        if rivals(whole, [joint(p)], wide=True):
            near.setdefault(p.names, p)
    return list(near.values())
