"""Equilibria under a cause that follows the motion: the motion is the one that its own history leads to."""

from dataclasses import replace

import numpy as np
import pytest
from test_diagnosis_experiment import NOISE, model, scene  # noqa: F401

from sim.laws.history import at_once, viscous_strain
from sim.newton import LinearSolver, NewtonOptions, equilibrate
from veo_ti.diagnosis.causes.history import PermanentSet, Softening, Viscoelasticity
from veo_ti.diagnosis.model import change_of
from veo_ti.diagnosis.solved import solved

STRONG = {Viscoelasticity(): 2.0, PermanentSet(): 0.4, Softening(): 0.7}


@pytest.mark.parametrize(("cause", "size"), STRONG.items(), ids=lambda c: getattr(c, "name", None))
def test_motion_is_the_one_that_its_own_history_leads_to(cause, size, scene, model):  # noqa: F811
    """One more round, solved tightly, leaves it where it is, to a tenth of the noise."""
    scene = replace(scene, target=replace(scene.target, sigma=NOISE))
    theta, place = np.array([size]), next(iter(cause.places(scene)))
    base, solver = scene.energy, LinearSolver.of(scene.energy)
    found = solved(scene, base, model, solver, cause, place, np.zeros(len(model.prior)), theta)
    assert found.equilibrium.converged
    energy = found.without.energy
    change = change_of(found.scene.of_material(energy.elastic.m), cause, theta, place)
    again = equilibrate(
        replace(energy, terms=(*base.terms, *change.terms)), found.scene.y, options=NewtonOptions(tolerance=1e-9)
    ).require_converged()
    assert np.sqrt(((again.y - found.scene.y) ** 2).mean()) < 0.1 * NOISE
    assert np.abs(found.scene.y - scene.y).max() > NOISE  # it does something


def test_what_a_viscous_strain_takes_at_once_is_its_slope_in_the_strain_now():
    rng, time, tau, h = np.random.default_rng(0), np.array([0.0, 0.1, 0.4, 0.5, 2.0]), 0.3, 1e-3
    E = rng.normal(size=(5, 3, 3))
    for t in range(5):
        more = E.copy()
        more[t] += h
        slope = (viscous_strain(more, time, tau) - viscous_strain(E, time, tau))[t] / h
        assert slope == pytest.approx(np.full((3, 3), at_once(time, tau)[t]))
