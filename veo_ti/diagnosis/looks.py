"""One cause refitted, and again where that is worth it: at what it leaves, elsewhere, beyond the first order."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.causes.beside import Beside
from veo_ti.diagnosis.fitted import Refit
from veo_ti.diagnosis.model import Model
from veo_ti.diagnosis.noise import counted, measure_noise
from veo_ti.diagnosis.placing import Spot, better_place
from veo_ti.diagnosis.problem import Problem
from veo_ti.diagnosis.refit import refit
from veo_ti.diagnosis.scene import Scene
from veo_ti.diagnosis.score import Score

CLOSER = 0.9  # share of the variance that a cause, or none, must leave to be worth a second fit, and
LOOKS = 4  # at most that it gets; and
_FALLING = 0.5  # of it, less than which it may leave still less; and
_LOST = 1.5  # times the variance, which one at the same place may leave instead and count; and
_BEYOND = 3  # beyond the first order, where it is followed to that only
WORTH = 5.0  # nats of evidence, that another prior of the material must bring
IN_REACH, NEARBY = 2.0, 5.0  # times the least that any leaves, to be fitted again; and if another place is better
_CREPT = 0.02  # of its cost, more than which a fit that ended early still promises
_NO_WORSE = 1.5  # times the cost of staying, more than which another place may not promise

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Tried:
    """A cause that was refitted under a model, and the variance [m2] at which what it leaves counts."""

    result: Refit
    model: Model
    left: float
    fine: bool  # whether the refit went to its end
    roams: int = 2  # 2: to any place, 1: along courses only, as another brought little or nothing, 0: no more
    spent: bool = False  # whether another look at this one did
    anew: bool = False  # whether it was begun anew

    @classmethod
    def of(cls, result: Refit, model: Model, modes: np.ndarray, *, fine: bool) -> "Tried":
        """Once it is refitted."""
        scene = result.left
        left = counted(scene, measure_noise(scene, modes), modes)
        return cls(result=result, model=model, left=left, fine=fine or result.converged)

    @cached_property
    def tuned(self) -> Refit:
        """Under the prior of highest evidence at what it leaves."""
        return self.result.tuned(self.model, self.left)

    def then(self, result: Refit, modes: np.ndarray, *, fine: bool) -> "Tried":
        """After another look, which knows what became of those before."""
        return replace(Tried.of(result, self.following, modes, fine=fine), roams=self.roams, anew=self.anew)

    @property
    def crept(self) -> bool:
        """Whether the fit ended on a way that goes on, though what it leaves hardly falls any more."""
        return self.result.short > _CREPT * self.result.cost and self.left > _FALLING * self.model.s2

    @cached_property
    def following(self) -> Model:
        """The model of the next fit."""
        return replace(self.model, s2=self.left, prior=self.tuned.prior[: len(self.tuned.coefficients)])

    @cached_property
    def staying(self) -> float:
        """What it costs under that model to stay."""
        return cost_under(self.following, self.result)

    @cached_property
    def spot(self) -> Spot:
        """Where the next fit begins."""
        return better_place(self.tuned, self.following, roams=self.roams)


def cost_under(model: Model, result: Refit) -> float:
    """What the end of a fit costs under another model than its own."""
    problem = Problem.of(result.without, model, result.cause, result.place)
    return problem.cost(result.scene, result.coefficients, result.theta)


def tried_once(found: Score, current: Refit, model: Model, say: Progress, most: float) -> Refit:
    """A cause refitted at the place of its score, beside what `current` holds; given up where it promises to cost over
    `most` even at its end."""
    say(f"refit with {found.name}")
    here = current.coefficients
    place, start, _ = _begun(found.cause, found.place, here, model)
    far = found.cause.known(found.place)  # of another size its fingerprint would be another one
    if current.cause is not None:
        both, own = Beside(current.cause, found.cause), np.zeros(len(found.theta)) if far is None else far
        theta = np.concatenate([current.theta, own])
        where = (current.place, place)
        return refit(current.without, model, start, cause=both, place=where, theta=theta, rough=True, most=most)
    theta, shift = (found.theta, found.nuisances - here) if far is None else (far, None)
    return refit(
        current.scene, model, start, cause=found.cause, place=place, theta=theta, shift=shift, rough=True, most=most
    )  # fmt: skip


def looked(tried: Tried, least: float, enough: float, modes: np.ndarray, say: Progress) -> Tried:
    """The same cause, refitted again if that is worth it: at what it leaves, and at the place that shows beside the
    refitted material; to the end if it leaves little `enough`; once anew, if its fit crept. As it was, if that leads
    away; another place must leave less, and clearly less for there to be yet another."""
    if tried.spent or tried.model.effort.over or tried.left > NEARBY * least:
        return tried
    result, s2, spot = tried.tuned, tried.left, tried.spot
    cause, more = result.cause, result.evidence(s2) - tried.result.evidence(s2)
    moved = spot.place is not result.place  # places may be arrays
    # To the end where it stays, and not while it goes on to leave far less: then another look follows.
    fine = s2 < enough and not moved and s2 > _FALLING * tried.model.s2
    closer = s2 < CLOSER * tried.model.s2 or more > WORTH or (fine and not tried.fine)
    anew = not moved and tried.crept and not tried.anew
    if not moved and not ((closer or anew) and s2 < IN_REACH * least):
        return tried
    if anew:
        return _begun_anew(tried, modes, say, fine=fine)
    say(f"{cause.name} at a better place" if moved else f"closer look at {cause.name}")
    place, start, theta, shift, since, most = spot.place, result.coefficients, spot.theta, None, None, np.inf
    if moved:
        place, start, far = _begun(cause, place, start, tried.model)
        if far is not None:
            theta = far
        else:
            shift, since = spot.coefficients - result.coefficients, result.theta
            most = _NO_WORSE * tried.staying
    again = refit(
        result.without, tried.following, start, cause=cause, place=place, theta=theta, shift=shift, since=since,
        rough=not fine, most=most, onward=None if moved else result,
    )  # fmt: skip
    after = tried.then(again, modes, fine=fine)
    if moved:  # it may lead back and forth
        better = after if after.left < tried.left else tried
        return replace(better, roams=tried.roams - (after.left > CLOSER * tried.left))
    return after if after.left < _LOST * tried.left else replace(tried, spent=True)


def _begun_anew(tried: Tried, modes: np.ndarray, say: Progress, *, fine: bool) -> Tried:
    """Fitted from a homogeneous object without the cause, or where that says: the material that was fitted before the
    cause was known had to imitate it, and a fit that starts there may creep along a valley. As it was, where that
    leaves more."""
    result = tried.tuned
    scene, cause, basis = result.without, result.cause, tried.model.basis
    say(f"{cause.name} anew, from a homogeneous object")
    place, start, theta = _begun(cause, result.place, np.zeros_like(result.coefficients), tried.model)
    begun = cause.anew(_of_that_material(scene, tried.model, start), place)
    if begun is not None:
        tried.model.effort.spend(begun.steps)
        scene, start, theta = scene.moved(scene.energy, begun.y), basis.stiffer(start, begun.stiffer), begun.theta
    again = refit(
        scene, tried.following, start, cause=cause, place=place,
        theta=np.zeros_like(result.theta) if theta is None else theta, rough=not fine,
    )  # fmt: skip
    after = tried.then(again, modes, fine=fine)
    return replace(after if after.left < tried.left else tried, anew=True)


def _of_that_material(scene: Scene, model: Model, coefficients: np.ndarray) -> Scene:
    """The same motion in the object that coefficients (K + E,) tell of."""
    return scene.of_material(Problem.of(scene, model).energy(coefficients).elastic)


def beyond(tried: Tried, modes: np.ndarray, say: Progress) -> Tried:
    """With what the cause does beyond the first order, as long as clearly less is left with it; on its courses it may
    then be elsewhere."""
    for _ in range(_BEYOND):
        if not tried.result.cause.followed or tried.model.effort.over:
            break
        result, spot = tried.tuned, better_place(tried.tuned, tried.following, roams=1)
        closer = result.cause.closer(result.scene, spot.theta, spot.place)
        if closer is None:
            break
        say(f"{result.cause.name} beyond the first order")
        place, theta = closer
        again = Tried.of(
            refit(result.without, tried.following, spot.coefficients, cause=result.cause, place=place, theta=theta),
            tried.following, modes, fine=True,
        )  # fmt: skip
        if again.left > tried.left:
            break
        last, tried = tried, again
        if tried.left > CLOSER * last.left:
            break
    return tried


def _begun(
    cause: Cause, place: Any, coefficients: np.ndarray, model: Model
) -> tuple[Any, np.ndarray, np.ndarray | None]:
    """Where a fit at a place begins: place, coefficients, and theta where that is too far for the first order."""
    at, stiffer = cause.begin(place)
    return at, model.basis.stiffer(coefficients, stiffer), cause.known(place) if stiffer else None
