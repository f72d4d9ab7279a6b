"""How far a simulated object lies from a measurement: the paper's Table 1, and what to compare it with."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from recon.metrics import DistanceTable, distance_table
from sim.checks import require
from sim.energy import Energy
from sim.follower import equilibrate_follower
from sim.newton import Equilibrium, NewtonOptions, Status, equilibrate
from sim.target import Target
from sim.terms.loads import AppliedForce
from veo_ti.object import VirtualElasticObject
from veo_ti.observation import Observation
from veo_ti.scene import air, energy_of, target_of
from veo_ti.stream import as_wide, unmeasured

NEWTON = NewtonOptions(tolerance=1e-5)  # as in the fit: soft patches take long to get further
_SETTLED = 5e-3  # of a frame's largest force: how far a jet's forces may still change with the surface they blow on
_ROUNDS = 12  # of solving and blowing, in which they have to


@dataclass(frozen=True, kw_only=True, eq=False)
class Evaluation:
    """A simulation of every frame of a measurement and its distances from it."""

    y: np.ndarray  # (T, N, 3) [m]
    converged: np.ndarray  # (T,) bool
    sentence: str
    target: Target

    def table(self, frames: np.ndarray | None = None) -> DistanceTable:
        """Mean, 95 % and largest distance over the observed surface points, in the chosen frames (default all)."""
        index = np.arange(len(self.y)) if frames is None else frames
        return distance_table(self.y[index], self.target.y[index], observed=self.target.seen[index])

    def rms_mm(self, frames: np.ndarray | None = None) -> float:
        """Root mean square error per coordinate [mm]."""
        index = np.arange(len(self.y)) if frames is None else frames
        return 1e3 * self.target.frames(index).rms(self.y[index])

    def mean_mm(self, frames: np.ndarray) -> float:
        """Mean distance over the observed surface points of some frames, each as often as it is named [mm]."""
        count = self.target.seen.sum(axis=1)[frames]
        return float((self.per_frame_mm[frames] * count).sum() / count.sum())

    @cached_property
    def per_frame_mm(self) -> np.ndarray:
        """Mean distance of each frame, (T,) [mm]; zero where nothing was observed."""
        distance = np.linalg.norm(self.target.residual(self.y), axis=2)
        return 1e3 * distance.sum(axis=1) / np.maximum(self.target.seen.sum(axis=1), 1)

    @property
    def per_point_mm(self) -> np.ndarray:
        """Mean distance of each point over the frames that saw it, (N,) [mm]."""
        distance = np.linalg.norm(self.target.residual(self.y), axis=2)
        return 1e3 * distance.sum(axis=0) / np.maximum(self.target.seen.sum(axis=0), 1)


def evaluate(obj: VirtualElasticObject, observation: Observation) -> Evaluation:
    """Simulate the object from rest under the measured loads and compare; ValueError when the points differ.

    An air stream that nobody measured is as wide as the one that the object was identified with.
    """
    require(len(obj.x) == len(observation.fixed), "observation", "have the object's points", observation.points.shape)
    if obj.footprint is not None and unmeasured(observation):
        observation = as_wide(observation, obj.footprint)
    energy = energy_of(observation, obj.cloud).with_elastic(obj.elastic)
    return judged(observation, energy, np.repeat(obj.x[None], len(observation.time), axis=0))


def judged(observation: Observation, energy: Energy, start: np.ndarray) -> Evaluation:
    """The simulation of a measurement under its loads, from `start` (T, N, 3) [m], and the comparison.

    Forces that are given are dead loads. Those of a jet that is all that is known of them act on the simulated surface:
    a prediction must not be told where the observed one was.
    """
    solved, target = solve_sequence(energy, start), target_of(observation)
    settled, sentence = np.ones(len(start), bool), solved.sentence
    if observation.forces is None and observation.jet is not None:
        rest = replace(energy, terms=tuple(term for term in energy.terms if not isinstance(term, AppliedForce)))
        load = air(observation.jet, energy.elastic.cloud)
        found = equilibrate_follower(rest, load, solved.y, tolerance=_SETTLED, iterations=_ROUNDS, options=NEWTON)
        solved, settled, sentence = found.equilibrium, found.settled, found.sentence
    converged = np.array([status is Status.CONVERGED for status in solved.status]) & settled
    return Evaluation(y=solved.y, converged=converged, sentence=sentence, target=target)


def unmoved(x: np.ndarray, target: Target) -> Evaluation:
    """The baseline that predicts no motion at all."""
    y = np.repeat(x[None], len(target.y), axis=0)
    return Evaluation(y=y, converged=np.ones(len(y), bool), sentence="no motion", target=target)


def solve_sequence(energy: Energy, start: np.ndarray) -> Equilibrium:
    """Equilibria of all frames; one that fails is tried again from the nearest frame in time that did not."""
    first = equilibrate(energy, start, options=NEWTON)
    failed = np.array([t for t, status in enumerate(first.status) if status is not Status.CONVERGED], int)
    good = np.setdiff1d(np.arange(len(start)), failed)
    if not len(failed) or not len(good):
        return first
    near = good[np.abs(good[None] - failed[:, None]).argmin(axis=1)]
    again = equilibrate(energy.frames(failed), first.y[near], options=NEWTON)
    return first.with_frames(failed, again)
