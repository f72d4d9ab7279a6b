"""The same physics by the full simulation: every point, large rotations, TR-BDF2."""

import numpy as np

from sim.dynamics import Damping, simulate
from sim.elastic import Elastic
from sim.energy import Energy
from sim.newton import NewtonOptions
from sim.terms.loads import AppliedForce
from veo_ti.beam import DENSITY, BeamModel
from veo_ti.beam_dynamics.ritz import Physics, Ritz, Start, edge_share
from veo_ti.body import MarkerTies

ROUGH = NewtonOptions(tolerance=1e-5)  # a stage's residual; 1e-8 moves the markers by less than 1e-5 mm
STEP = 0.25  # [rad] of the ringing that one step covers: its frequency comes out 0.25 % low


def full_markers(
    model: BeamModel, elastic: Elastic, ritz: Ritz, ties: MarkerTies, physics: Physics, start: Start, load: float,
    time: np.ndarray,
) -> np.ndarray:
    """Marker displacements from their settled places (T, M, 3) [m] at evenly spaced times (T,) [s].

    elastic: at the modulus of the settled poses. The beam starts straight, where nothing pulls it: a support that
    gives way is a load that grows. `physics.modulus` scales the load with the stiffness, so that the settled pose stays
    where it is. A branch of a viscoelastic material that has crept the share z of the way to the settled pose pulls
    like z times the load, `g dE/dy(z) = g z f`; a weight on a string is a mass whose horizontal inertia is taken back.
    Both come from the shapes. Raises RuntimeError where a step fails.
    """  # fmt: skip
    share = np.clip((time - start.latency) / max(start.rise, 1e-6), 0, 1)
    for (g, _), z in zip(physics.branches, ritz.memory(physics, start, time), strict=True):
        share = share + g * z
    stiffer = 1.0 + sum(g for g, _ in physics.branches)
    force = physics.modulus * share[:, None, None] * model.force(load)
    edge = edge_share(model)
    if physics.on_string:
        force[..., :2] += physics.hung * edge[:, None] * ritz.edge_acceleration(physics, start, time)[:, None, :2]
    energy = Energy.of(
        elastic.with_parameters(elastic.m * physics.modulus * stiffer), [AppliedForce(force=force)], model.fixed
    )
    motion = simulate(
        energy, time=time, mass=DENSITY * model.cloud.volume, added_mass=(physics.hung + physics.fittings) * edge,
        substeps=max(1, round(float(np.diff(time).mean()) * 2 * np.pi * ritz.ring(physics)[0] / STEP)),
        damping=Damping(mass=physics.mass_damping, stiffness=physics.stiffness_damping / stiffer), options=ROUGH,
    )  # fmt: skip
    if not motion.converged:
        raise RuntimeError(f"the full simulation of the beam failed: {motion.sentence}")
    return start.reach * ties.positions(motion.y - ritz.settled)
