"""Which causes make the Neo-Hookean law fit: every one, then sets of them, by evidence; and the verdict on that."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from veo_ti.coupons.curves import Curve
from veo_ti.coupons.data import Data
from veo_ti.coupons.fit import Fit, fit
from veo_ti.coupons.laws import Cause, Reach, laws
from veo_ti.coupons.machine import machine
from veo_ti.coupons.model import Model
from veo_ti.diagnosis.verdict import APART, APART_SHARE, BETTER, EXPLAINED, MISFIT

MOST = 2  # causes at once
_BEAM = 4  # sets of each size that are extended

Catalogue = Callable[[Reach], Sequence[Cause]]


def catalogue(reach: Reach) -> tuple[Cause, ...]:
    """Every cause that stress-stretch curves can show."""
    return (*laws(reach), *machine(reach))


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A set of causes, fitted. gained: nats of evidence over the baseline; explained: share of its excess misfit."""

    fit: Fit
    gained: float
    explained: float
    z: float  # what is left, in standard deviations of noise alone

    @property
    def names(self) -> frozenset[str]:
        """The causes, whatever their form."""
        return frozenset(cause.name for cause in self.fit.model.causes)

    @property
    def name(self) -> str:
        """The forms."""
        return self.fit.model.name


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """kind: named, ambiguous, unexplained or no_misfit. best: the set that was chosen, the baseline where none was.

    named: causes that every set as good as the best holds; rivals: those sets, one for each choice of causes.
    """

    data: Data
    kind: str
    baseline: Candidate
    candidates: tuple[Candidate, ...]  # best first; singles and sets
    best: Candidate
    rivals: tuple[Candidate, ...]

    @property
    def named(self) -> tuple[str, ...]:
        """In the order of the best set."""
        if self.kind != "named":
            return ()
        certain = frozenset.intersection(self.best.names, *(rival.names for rival in self.rivals))
        return tuple(c.name for c in self.best.fit.model.causes if c.name in certain)

    @property
    def applied(self) -> Candidate:
        """What predictions are made with: the best set where a cause was named, else nothing beyond the baseline."""
        return self.best if self.kind == "named" else self.baseline

    @property
    def likely(self) -> tuple[Candidate, ...]:
        """The sets that speak for what is applied: the rivals, and the same causes in other forms within the margin."""
        best = self.applied
        if best is self.baseline:
            return ()
        same = [c for c in self.candidates if c.names == best.names and c.fit.plausible and c is not best]
        return (*self.rivals, *(c for c in same if best.gained - c.gained < APART))

    @property
    def singles(self) -> tuple[Candidate, ...]:
        """Every cause alone, best first."""
        return tuple(c for c in self.candidates if len(c.fit.model.causes) == 1)


def search(
    curves: Sequence[Curve], *, crosshead: bool = False, causes: Catalogue = catalogue, most: int = MOST
) -> Found:
    """Fit every cause, then every cause beside the best sets, and judge.

    A cause more must gain BETTER nats; that is also what a named cause must gain over the baseline.
    """
    data, listed = Data.of(curves), causes(Reach.of(curves, crosshead))
    plain = fit(Model(), data)
    baseline = _candidate(plain, plain, data)
    found: list[Candidate] = []
    beam, chosen = [baseline], baseline
    if baseline.z < MISFIT:
        most = 1  # nothing is wrong: single causes show what would have been seen
    for size in range(1, most + 1):
        grown = [
            _candidate(fit(c.fit.model.with_cause(cause), data, start=c.fit.theta), plain, data)
            for c in beam for cause in listed if _joins(cause, c.fit.model)
        ]  # fmt: skip
        grown = _distinct(grown)
        found += grown
        able = sorted((c for c in grown if c.fit.plausible), key=lambda c: -c.gained)
        beam = able[:_BEAM]
        enough = chosen.gained + BETTER * (size - len(chosen.fit.model.causes))
        if able and able[0].gained > enough:
            chosen = able[0]
        if not able or (size >= 2 and len(chosen.fit.model.causes) < size):  # two may do what neither does alone
            break
    found.sort(key=lambda c: -c.gained)
    return _judge(data, baseline, found, chosen)


def _joins(cause: Cause, model: Model) -> bool:
    """Whether a cause adds something new to a set; of what the machine does wrong, one thing is enough."""
    is_law = type(cause).slope is not Cause.slope
    return all(cause.name != other.name and (is_law or type(other).slope is not Cause.slope) for other in model.causes)


def _distinct(grown: Sequence[Candidate]) -> list[Candidate]:
    """One candidate for every set of forms: the same set is reached in several orders."""
    best: dict[frozenset[str], Candidate] = {}
    for c in grown:
        key = frozenset(cause.form for cause in c.fit.model.causes)
        if key not in best or c.gained > best[key].gained:
            best[key] = c
    return list(best.values())


def _candidate(found: Fit, plain: Fit, data: Data) -> Candidate:
    def excess(f: Fit) -> float:
        return max(f.energy - (len(data.noise) - 1 - len(f.theta)), 0.0)

    free = max(len(data.noise) - 1 - len(found.theta), 1)
    sd = free * np.sqrt(2 / free + (2 * data.unsure) ** 2)  # the noise is an estimate too
    return Candidate(
        fit=found, gained=found.evidence - plain.evidence, z=float((found.energy - free) / sd),
        explained=float(1 - excess(found) / max(excess(plain), 1e-300)) if excess(plain) else 0.0,
    )  # fmt: skip


def _judge(data: Data, baseline: Candidate, found: Sequence[Candidate], chosen: Candidate) -> Found:
    """The rules of `veo_ti.diagnosis.verdict`, for sets of causes and for causes that come in several forms."""
    own = {"data": data, "baseline": baseline, "candidates": tuple(found)}
    if baseline.z < MISFIT:
        return Found(kind="no_misfit", best=baseline, rivals=(), **own)
    if chosen is baseline:
        return _weak(found, own)
    if chosen.explained < EXPLAINED:
        return Found(kind="unexplained", best=baseline, rivals=(), **own)
    margin = max(APART, APART_SHARE * chosen.gained)
    rivals = _rivals([c for c in found if c.gained > 0 and not _rejected(c, chosen)], chosen, margin)
    result = Found(kind="named", best=chosen, rivals=rivals, **own)
    return result if result.named else Found(kind="ambiguous", best=chosen, rivals=rivals, **own)


def _rivals(found: Sequence[Candidate], best: Candidate, margin: float) -> tuple[Candidate, ...]:
    """The best set of every other choice of no more causes within the margin."""
    rivals: dict[frozenset[str], Candidate] = {}
    for c in found:
        if best.gained - c.gained < margin and c.fit.plausible and len(c.names) <= len(best.names):
            rivals.setdefault(c.names, c)
    rivals.pop(best.names, None)
    return tuple(rivals.values())


def _weak(found: Sequence[Candidate], own: dict) -> Found:
    """Clear misfit, but so few data that no cause is proven: ambiguous where single causes explain it nevertheless."""
    able = [c for c in found if len(c.fit.model.causes) == 1 and c.explained > EXPLAINED and c.gained > 0]
    able = [c for c in able if c.fit.plausible]
    if not able:
        return Found(kind="unexplained", best=own["baseline"], rivals=(), **own)
    return Found(kind="ambiguous", best=able[0], rivals=_rivals(able, able[0], APART), **own)


def _rejected(rival: Candidate, best: Candidate) -> bool:
    return best.z < MISFIT and rival.z > 2 * MISFIT
