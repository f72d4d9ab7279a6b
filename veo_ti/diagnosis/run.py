"""The diagnosis from start to end: baseline, noise, misfit, scores, refits, verdict, gain, and a second cause."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.basis import Basis
from sim.fit import guess_modulus
from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.columns import discretisation
from veo_ti.diagnosis.gain import Gain, measure_gain
from veo_ti.diagnosis.leaders import WORTH, Progress, counted
from veo_ti.diagnosis.model import OURS, Model, Refit
from veo_ti.diagnosis.noise import Noise, measure_noise
from veo_ti.diagnosis.pairs import two_at_once
from veo_ti.diagnosis.refit import refit
from veo_ti.diagnosis.rounds import Round, look, with_more
from veo_ti.diagnosis.scene import Scene
from veo_ti.diagnosis.verdict import CLEAR, MISFIT, Candidate, Verdict, stands, unexplained
from veo_ti.diagnosis.visible import Left
from veo_ti.evaluation import judged
from veo_ti.identification import Identification

SMOOTH = 12  # spatial modes in which misfit is looked for
_STIFF = 4.0  # times the stiffness that the differences between frames tell, beyond which it is taken from them, and
_AS_STIFF = 0.1  # known so well [nats]


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
    scene, basis, start = _scene(identification)
    modes = basis.field.modes[:, :SMOOTH]
    say("noise")
    noise = measure_noise(scene, modes)
    seen = scene.target.seen & ~noise.stray
    scene = replace(scene, target=replace(scene.target, seen=seen, sigma=noise.sigma))
    state = identification.fit.state
    say("discretisation")
    extra = discretisation(scene)
    prior = np.concatenate([basis.prior(state.length, state.amplitude), np.ones(len(extra))])
    model = Model(basis=basis, prior=prior, s2=counted(scene, noise, modes), extra=extra)
    say("baseline")
    start = np.concatenate([start, np.zeros(len(extra))])
    baseline = refit(scene, model, start)
    better = baseline.tuned(model, model.s2)
    if better.evidence(model.s2) - baseline.evidence(model.s2) > WORTH:
        model = replace(model, prior=better.prior)
        baseline = refit(scene, model, baseline.coefficients)
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
        return [first, look(found[0].refit, model, floor, modes, others, say, shadow=True)]
    if kind == "no_misfit" or (kind == "ambiguous" and found[0].misfit.z < CLEAR):
        return [first]
    alone = replace(first, verdict=unexplained(found), extended=None) if kind == "named" else first
    return list(two_at_once(alone, narrower, modes, causes, say, again) or [alone])


def _scene(found: Identification) -> tuple[Scene, Basis, np.ndarray]:
    """The identified object on all frames, the basis that its material is written in, and its coefficients.

    Where what nobody recorded outweighs the nominal loads, the stiffest object fits best, and shows no cause. Then a
    homogeneous one is taken, as stiff as the differences between frames tell.
    """
    energy, reached, a = found.energy, found.model, found.fit.state.a
    basis = Basis.of(energy.elastic.cloud, found.options.fit, float(np.exp(found.fit.centre)))
    stiffness = _told(found)
    if found.fit.centre + a[0] > np.log(_STIFF * stiffness):
        a, options = np.zeros_like(a), replace(found.options.fit, mean_sd=_AS_STIFF)
        basis = Basis.of(energy.elastic.cloud, options, stiffness)
        energy = energy.with_elastic(basis.elastic(energy.elastic, a))
        reached = judged(found.observation, energy, found.rest.y)
    target = replace(reached.target, seen=reached.target.seen & reached.converged[:, None])
    train = np.isin(np.arange(len(target.y)), found.train)
    return Scene(observation=found.observation, energy=energy, y=reached.y, target=target, train=train), basis, a


def _told(found: Identification) -> float:
    """Shear modulus [Pa] that the differences between training frames tell; without loads none is too stiff."""
    energy, target = found.energy.frames(found.train), found.model.target.frames(found.train)
    return guess_modulus(energy, target) if energy.gradient(found.rest.y[found.train]).any() else np.inf
