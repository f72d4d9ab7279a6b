"""What every cause is held against: material and discretisation fitted together, and the noise that they leave."""

from dataclasses import dataclass, replace

import numpy as np

from sim.basis import Basis
from sim.fit import guess_modulus
from sim.solvers import KeptSolver
from veo_ti.diagnosis.checkpoints import Checkpoints
from veo_ti.diagnosis.columns import discretisation
from veo_ti.diagnosis.effort import Effort
from veo_ti.diagnosis.fitted import Refit, everywhere
from veo_ti.diagnosis.looks import CLOSER, LOOKS, WORTH, Progress
from veo_ti.diagnosis.model import Model
from veo_ti.diagnosis.noise import Noise, counted, measure_noise
from veo_ti.diagnosis.refit import refit
from veo_ti.diagnosis.scene import Scene
from veo_ti.evaluation import judged
from veo_ti.identification import Identification

_SMOOTH = 12  # spatial modes in which misfit is looked for
_CLEARLY = 10.0  # times the noise's variance
_STIFF = 4.0  # times the stiffness that the differences between frames tell, beyond which it is taken from them, and
_AS_STIFF = 0.1  # known so well [nats]


@dataclass(frozen=True, kw_only=True, eq=False)
class Baseline:
    """The best that can be said without a cause."""

    refit: Refit
    model: Model
    noise: Noise
    modes: np.ndarray  # (N, S), smooth in space

    @property
    def given(self) -> tuple[Refit, Model, float, np.ndarray]:
        """What a first look begins with: fit, model, variance of the noise [m2], smooth modes."""
        return self.refit, self.model, self.noise.variance, self.modes

    def beside(self, found: Refit) -> tuple[Model, float]:
        """The model, and the variance of the noise [m2], once a cause is part of it: what it explains was no noise."""
        left, noise = found.left, self.noise
        less = replace(noise, correlation=min(noise.correlation, measure_noise(left, self.modes).correlation))
        prior = found.prior[: len(found.coefficients)]
        return replace(self.model, s2=counted(left, less, self.modes), prior=prior), less.variance

    @classmethod
    def of(
        cls, identification: Identification, say: Progress, effort: Effort, checkpoints: Checkpoints
    ) -> "Baseline":  # fmt: skip
        """The identified material, fitted again together with the discretisation.

        There is no more noise than it leaves, and fewer outliers than before: it is repeated with what it leaves, under
        the prior of highest evidence there, as long as either changes much; so is the refit of a cause.
        """
        scene, basis, start = _identified(identification)
        modes, whole = basis.field.modes[:, :_SMOOTH], scene.target
        say("noise")
        noise = measure_noise(scene, modes)
        scene = _told(scene, whole.seen, noise)
        say("discretisation")
        extra, state = discretisation(scene), identification.fit.state
        prior = np.concatenate([basis.prior(state.length, state.amplitude), np.ones(len(extra))])
        model = Model(
            basis=basis, prior=prior, s2=counted(scene, noise, modes), extra=extra, effort=effort,
            checkpoints=checkpoints, solver=KeptSolver.of(scene.energy, int(scene.train.sum())),
            through_time=KeptSolver.of(scene.energy, len(scene.y)),
        )  # fmt: skip
        say("baseline")
        found = refit(scene, model, np.concatenate([start, np.zeros(len(extra))]), rough=_clearly_wrong(model, noise))
        for _ in range(LOOKS):
            left = replace(found.left, target=replace(found.left.target, seen=whole.seen, sigma=whole.sigma))
            again = measure_noise(left, modes)
            s2 = min(model.s2, counted(_told(left, whole.seen, again), again, modes))
            better = found.tuned(model, s2)
            if s2 > CLOSER * model.s2 and better.evidence(s2) - found.evidence(s2) < WORTH:
                break
            say("closer look at the baseline")
            noise, model = again, replace(model, s2=s2, prior=better.prior)
            told, rough = _told(found.scene, whole.seen, noise), _clearly_wrong(model, noise)
            found = refit(told, model, found.coefficients, rough=rough, onward=found)
        return cls(refit=everywhere(found), model=model, noise=noise, modes=modes)


def _clearly_wrong(model: Model, noise: Noise) -> bool:
    """Whether so much more than noise is left that the last hundredth of it says nothing."""
    return model.s2 > _CLEARLY * noise.variance


def _told(scene: Scene, seen: np.ndarray, noise: Noise) -> Scene:
    """With a noise that was measured, and without its outliers."""
    return replace(scene, target=replace(scene.target, seen=seen & ~noise.stray, sigma=noise.sigma))


def _identified(found: Identification) -> tuple[Scene, Basis, np.ndarray]:
    """The identified object on all frames, the basis that its material is written in, and its coefficients.

    Where what nobody recorded outweighs the nominal loads, the stiffest object fits best, and shows no cause. Then a
    homogeneous one is taken, as stiff as the differences between frames tell.
    """
    energy, reached, a = found.energy, found.model, found.fit.state.a
    basis = Basis.of(energy.elastic.cloud, found.options.fit, float(np.exp(found.fit.centre)))
    stiffness = _by_differences(found)
    if found.fit.centre + a[0] > np.log(_STIFF * stiffness):
        a, options = np.zeros_like(a), replace(found.options.fit, mean_sd=_AS_STIFF)
        basis = Basis.of(energy.elastic.cloud, options, stiffness)
        energy = energy.with_elastic(basis.elastic(energy.elastic, a))
        reached = judged(found.observation, energy, found.rest.y)
    target = replace(reached.target, seen=reached.target.seen & reached.converged[:, None])
    train = np.isin(np.arange(len(target.y)), found.train)
    return Scene(observation=found.observation, energy=energy, y=reached.y, target=target, train=train), basis, a


def _by_differences(found: Identification) -> float:
    """Shear modulus [Pa] that the differences between training frames tell; without loads none is too stiff."""
    energy, target = found.energy.frames(found.train), found.model.target.frames(found.train)
    return guess_modulus(energy, target) if energy.gradient(found.rest.y[found.train]).any() else np.inf
