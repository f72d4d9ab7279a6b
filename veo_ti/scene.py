"""From a measurement to what the simulator takes: a cloud, its loads and supports, and the positions to reach."""

from functools import partial

import numpy as np

from sim.cloud import CloudOptions, RestCloud
from sim.elastic import Elastic
from sim.energy import Energy
from sim.fit import guess_modulus
from sim.follower import Load, deformed_area
from sim.lame import Lame
from sim.target import Target
from sim.terms.base import Term
from sim.terms.handles import Handles
from sim.terms.jet import Jet, jet_forces
from sim.terms.loads import AppliedForce
from veo_ti.observation import Observation


def cloud_of(observation: Observation, options: CloudOptions | None = None) -> RestCloud:
    """The cloud of the reference pose (frame 0)."""
    return RestCloud.build(
        observation.points[0], volume=observation.volume, surface=observation.surface, options=options
    )


def forces_of(observation: Observation, cloud: RestCloud) -> np.ndarray:
    """The applied forces (T, N, 3) [N]: as given, else those of the jet on the observed poses, else none."""
    if observation.forces is not None:
        return observation.forces
    if observation.jet is not None:
        return blown(observation, cloud, observation.jet)
    return np.zeros_like(observation.points)


def blown(observation: Observation, cloud: RestCloud, jet: Jet) -> np.ndarray:
    """The forces (T, N, 3) [N] of a jet: where forces are given too, a dead load like them, else that on each pose.

    Poses are the observed ones; one with lost points counts as the reference pose.
    """
    if observation.forces is not None:
        return jet_forces(jet, cloud.x, cloud.area)
    seen = observation.observed.all(axis=1)[:, None, None]
    pose = np.where(seen, observation.points, cloud.x)
    return air(jet, cloud)(pose, deformed_area(cloud, pose))


def air(jet: Jet, cloud: RestCloud) -> Load:
    """A jet as a load on any pose; surface that other surface hides gets none."""
    return partial(jet_forces, jet, spacing=cloud.spacing)


def target_of(observation: Observation) -> Target:
    """The observed positions that judge a simulation: surface points neither fixed nor led, where tracking saw them.

    The reference frame is left out: a simulation starts from it and says nothing about it.
    """
    seen = observation.observed & (observation.surface & ~observation.fixed & ~observation.handles)
    seen[0] = False
    sigma = observation.sigma
    if sigma is not None and np.ndim(sigma):
        sigma = float(np.sqrt(np.mean(np.square(sigma)[seen])))
    return Target(y=observation.points, seen=seen, sigma=sigma)


def energy_of(observation: Observation, cloud: RestCloud) -> Energy:
    """The object under the measured loads, with a first guess of its material.

    Gravity is no load here: the reference pose already carries it.
    """
    elastic = Elastic.neo_hookean(cloud, Lame.from_young(1e4, 0.4))
    terms: list[Term] = [AppliedForce(force=forces_of(observation, cloud))]
    led = np.flatnonzero(observation.handles)
    if not len(led):
        return Energy.of(elastic, terms, observation.fixed)
    targets, seen = observation.points[:, led], observation.observed[:, led]

    def handles(mu: float) -> Handles:
        return Handles.relative(led, targets, mu=mu, spacing=cloud.spacing, seen=seen)

    first = Energy.of(elastic, [*terms, handles(1e4)], observation.fixed)
    mu = guess_modulus(first, target_of(observation)) if np.any(terms[0].force) else 1e4
    return Energy.of(elastic, [*terms, handles(mu)], observation.fixed)
