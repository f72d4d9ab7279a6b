"""Where a cause begins that vibrates out of step with what is seen: against nonlinear dynamics."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import sim_cases
from scipy.interpolate import CubicSpline

from sim.dynamics import simulate
from sim.elastic import Elastic
from sim.energy import Energy
from sim.lame import Lame
from sim.newton import equilibrate
from sim.terms.handles import Handles
from sim.terms.loads import AppliedForce
from sim.vibration import Vibrations
from veo_ti.diagnosis.causes.dynamics import Damping, Flow, Inertia, Ring

STIFFER, MASS, TIME, STEPS = 0.6, 1e-3, np.linspace(0, 6.0, 41), 40


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


def pushed(push: float, frames: int) -> SimpleNamespace:
    """A box pushed at its end, quasi-static."""
    cloud, time = sim_cases.cloud(), TIME[:frames]
    elastic = Elastic.neo_hookean(cloud, Lame(mu=1.0, lam=2.0))
    force = np.zeros((frames, cloud.count, 3))
    force[:, cloud.x[:, 0] > 0.95, 2] = push * np.clip(np.sin(2 * time), 0, None)[:, None]
    energy = Energy.of(elastic, [AppliedForce(force=force)], cloud.x[:, 0] < 1e-9)
    y = equilibrate(energy, np.repeat(cloud.x[None], frames, axis=0)).require_converged().y
    return SimpleNamespace(cloud=cloud, energy=energy, y=y, time=time)


def swinging(push: float, *, smooth: bool = False) -> SimpleNamespace:
    """It, and the full simulation of it with its mass, in many steps; smooth: under a load without kinks."""
    scene = pushed(push, 21)
    mass = MASS * scene.cloud.volume / scene.cloud.volume.sum()
    energy, time, finer = scene.energy, scene.time, 12 if smooth else 1
    if smooth:
        time = np.linspace(time[0], time[-1], finer * (len(time) - 1) + 1)
        force = CubicSpline(scene.time, energy.terms[0].force, axis=0)(time)
        energy = replace(energy, terms=(AppliedForce(force=force),))
    full = simulate(energy, time=time, mass=mass, substeps=24 // finer)
    assert full.converged
    scene.full, scene.vibrations = full.y[::finer], Vibrations.of(scene.energy, mass)
    return scene


def off(scene: SimpleNamespace, theta: np.ndarray, place, cause) -> float:
    """How far what a cause is said to show is from the full simulation, as a share of what it adds."""
    shown = cause.change(scene, theta, place).observe(scene.y, np.arange(len(scene.y)))
    return float(np.linalg.norm(shown - scene.full) / np.linalg.norm(scene.full - scene.y))


@pytest.mark.parametrize("smooth", [False, True])
def test_large_swings_are_those_of_the_full_simulation(smooth):
    scene, linear, one = swinging(1e-3, smooth=smooth), Ring(ratio=1e-6, power=-1, smooth=smooth), np.ones(1)
    closer, theta = Inertia().closer(scene, one, linear)
    assert off(scene, one, linear, Inertia()) > 0.5
    assert off(scene, one, closer, Inertia()) < 0.1
    assert theta * closer.slower == pytest.approx(one)  # as slow as what was fitted without
    nothing = Inertia().change(scene, np.zeros(1), closer)
    assert nothing.observe(scene.y, np.arange(len(scene.y))) == pytest.approx(scene.y, abs=1e-15)


def test_small_swings_are_linear():
    scene = swinging(1e-5)
    closer, _ = Inertia().closer(scene, np.ones(1), Ring(ratio=1e-6, power=-1, smooth=False))
    assert closer.slower == pytest.approx(1.0, abs=0.021)
    assert np.linalg.norm(closer.swings.beyond) < 0.1 * np.linalg.norm(scene.full - scene.y)


@pytest.mark.parametrize("share", [0.0, 1e-9])
def test_a_mass_too_small_to_be_seen_is_not_followed(share):
    scene = swinging(1e-3)
    assert Inertia().closer(scene, np.array([share]), Ring(ratio=0.1, power=0, smooth=False)) is None


def creeping(push: float) -> SimpleNamespace:
    """It in honey: backward Euler in many steps, drag as springs to where the points were."""
    scene, drag = pushed(push, 11), 2.0
    force, y, reached = scene.energy.terms[0].force, scene.cloud.x[None], [scene.cloud.x]
    alpha = 0.5 * drag * scene.cloud.volume * STEPS / np.diff(scene.time)[0]
    for frame in range(1, len(scene.time)):
        for share in np.arange(1, STEPS + 1) / STEPS:
            load = AppliedForce(force=(1 - share) * force[frame - 1 : frame] + share * force[frame : frame + 1])
            held = Handles(points=np.arange(scene.cloud.count), targets=y, alpha=alpha)
            y = equilibrate(replace(scene.energy, terms=(load, held)), y).require_converged().y
        reached.append(y[0])
    scene.full, scene.drag = np.stack(reached), np.array([drag])
    scene.relaxations = Vibrations.of(scene.energy, scene.cloud.volume)
    return scene


def test_a_large_motion_creeps_as_a_drag_on_every_point_lets_it():
    scene = creeping(1e-3)
    linear = Flow(smooth=False)
    closer, theta = Damping().closer(scene, scene.drag, linear)
    assert theta == pytest.approx(scene.drag)
    assert off(scene, theta, linear, Damping()) > 0.2
    assert off(scene, theta, closer, Damping()) < 0.05
    nothing = Damping().change(scene, np.zeros(1), closer)
    assert nothing.observe(scene.y, np.arange(len(scene.y))) == pytest.approx(scene.y, abs=1e-15)
    assert Damping().closer(scene, np.zeros(1), linear) is None


def test_what_the_full_simulation_added_belongs_to_the_measurement_it_was_made_for():
    ring = Ring(ratio=0.1, power=0)
    assert Inertia().elsewhere(None, replace(ring, swings="of this one")) == ring
    assert Damping().elsewhere(None, Flow(creep="of this one")) == Flow()
