"""Where a cause begins that vibrates out of step with what is seen: against nonlinear dynamics."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import sim_cases

from sim.dynamics import simulate
from sim.elastic import Elastic
from sim.energy import Energy
from sim.lame import Lame
from sim.newton import equilibrate
from sim.terms.loads import AppliedForce
from sim.vibration import Vibrations
from veo_ti.diagnosis.causes.dynamics import Inertia

STIFFER, MASS, TIME = 0.6, 1e-3, np.linspace(0, 6.0, 41)


@pytest.fixture(scope="module")
def ringing() -> SimpleNamespace:
    """A box that was struck and rings, seen in two thirds of its points, beside the motion of one that is too soft."""
    cloud = sim_cases.cloud()
    soft = Elastic.neo_hookean(cloud, Lame(mu=1.0, lam=2.0))
    force = np.zeros((len(TIME), cloud.count, 3))
    force[:, cloud.x[:, 0] > 0.95, 2] = 2e-5 * np.clip(np.sin(2 * TIME), 0, None)[:, None]
    energy = Energy.of(soft, [AppliedForce(force=force)], cloud.x[:, 0] < 1e-9)
    true = replace(energy, elastic=soft.with_parameters(np.exp(STIFFER) * soft.m))
    rest = np.repeat(cloud.x[None], len(TIME), axis=0)
    mass = MASS * cloud.volume / cloud.volume.sum()
    y, seen = equilibrate(energy, rest).y, np.random.default_rng(0).random(rest.shape[:2]) < 0.67
    residual = np.where(seen[..., None], simulate(true, time=TIME, mass=mass, substeps="auto").y - y, 0.0)
    return SimpleNamespace(
        cloud=cloud, y=y, time=TIME, residual=residual, train=TIME < 5.0, target=SimpleNamespace(seen=seen),
        vibrations=Vibrations.of(energy, mass), observation=SimpleNamespace(force_scale_known=True),
    )  # fmt: skip


def left(scene: SimpleNamespace, place) -> float:
    """What a place leaves of the residual where it was seen, as a share."""
    cause, frames = Inertia(), np.arange(len(scene.y))
    moved = cause.change(scene, cause.known(place), place).observe(scene.y, frames) - scene.y
    seen = scene.target.seen & scene.train[:, None]
    return float(np.linalg.norm((scene.residual - moved)[seen]) / np.linalg.norm(scene.residual[seen]))


def test_inertia_begins_in_step_where_as_it_stands_it_explains_little(ringing):
    best = min(Inertia().places(ringing), key=lambda place: left(ringing, place))
    as_it_stands = min(left(ringing, place) for place in Inertia().places(ringing) if place.stiffer == 0)
    assert left(ringing, best) < 0.25 and as_it_stands > 0.6
    assert best.stiffer == pytest.approx(STIFFER, abs=0.08) and best.share == 1
    assert Inertia().begin(best) == (replace(best, stiffer=0.0), best.stiffer)


def test_with_forces_to_scale_the_mass_is_found_too(ringing):
    """Forces, and so stiffness and mass in their units, four times as large: the motion is the same."""
    modes = ringing.vibrations  # of the scaled object with the mass as weighed
    stiff = replace(modes, omega=2 * modes.omega)
    scaled = SimpleNamespace(**vars(ringing) | {"vibrations": stiff})
    scaled.observation = SimpleNamespace(force_scale_known=False)
    best = min(Inertia().places(scaled), key=lambda place: left(scaled, place))
    assert best.stiffer == pytest.approx(STIFFER, abs=0.08)
    assert best.share == pytest.approx(4.0, rel=0.15)  # tried in such steps
    assert Inertia().plausible(scaled, np.array([best.share]), np.zeros(1))
    assert not Inertia().plausible(ringing, np.array([best.share]), np.zeros(1))
