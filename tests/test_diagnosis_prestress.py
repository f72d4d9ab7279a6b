"""A column that nearly buckles under its weight, simulated by finite elements: how stiff it is, and what it carries."""

import clouds
import fem
import fem_scenes
import numpy as np
import pytest

from sim.basis import Basis, FitOptions
from sim.elastic import Elastic
from sim.lame import Lame
from sim.newton import equilibrate
from sim.solvers import LinearSolver
from veo_ti.diagnosis.causes.prestress import Prestress
from veo_ti.diagnosis.model import Model
from veo_ti.diagnosis.refit import refit
from veo_ti.diagnosis.scene import Scene
from veo_ti.observation import Observation
from veo_ti.scene import cloud_of, energy_of, target_of

WEIGHT, GRAVITY = 0.018, 9.81  # N/m3, of the 0.026 under which it buckles by itself (7.84 EI / A L^3); m/s2
PUSHES = 1e-5 * np.array([0.0, 0.5, 1.0, 1.5, 1.0, 0.5])  # [N] to the side, on its top
SOFT, NOISE = 0.25, 1e-4  # of its stiffness; [m]


@pytest.fixture(scope="module")
def column() -> Scene:
    """As a simulation sees it that knows no weight and takes it for a quarter as stiff."""
    mu, lam = fem_scenes.lame_fields(fem_scenes.constant(1.0), 0.3)
    standing = fem_scenes.clamped_box(size=(1, 0.2, 0.2), cells=(12, 2, 2), mu=mu, lam=lam, body_force=(-WEIGHT, 0, 0))
    rest = clouds.block((13, 4, 4), (1, 0.2, 0.2), (0, -0.1, -0.1))
    side = fem.surface_load(standing.body.basis, lambda x, n: (n[:, :1] > 0.5) * np.array([0, 0, 1 / 0.04]))
    u, poses = standing.u, []
    for push in PUSHES:
        u = fem.solve(standing.body, nodal_force=push * side, body_force=(-WEIGHT, 0, 0), start=u)
        poses.append(rest + fem.displacement_at(standing.body, u, rest))
    top = rest[:, 0] > 0.99
    forces = PUSHES[:, None, None] * (top[:, None] / top.sum()) * np.array([0.0, 0.0, 1.0])
    observation = Observation(
        points=np.array(poses), forces=forces, time=np.arange(len(PUSHES), dtype=float), fixed=rest[:, 0] < 1e-9,
        mass=WEIGHT / GRAVITY * 0.04, gravity=np.array([-GRAVITY, 0.0, 0.0]),
    )  # fmt: skip
    cloud = cloud_of(observation)
    energy = energy_of(observation, cloud)
    energy = energy.with_elastic(Elastic.neo_hookean(cloud, Lame.from_young(SOFT, 0.3)))
    y = equilibrate(energy, np.repeat(cloud.x[None], len(PUSHES), axis=0)).require_converged().y
    train = np.ones(len(PUSHES), bool)
    return Scene(observation=observation, energy=energy, y=y, target=target_of(observation), train=train)


def test_a_fit_anew_begins_where_the_column_stands(column):
    """At about its stiffness, where the motion is half what was seen."""
    begun = Prestress().anew(column, None)
    assert begun.stiffer == pytest.approx(-np.log(SOFT), abs=0.5)
    assert (begun.theta == 1).all() and begun.steps > 0
    u = column.target.y - column.cloud.x
    assert np.linalg.norm(column.target.residual(begun.y)) < 0.6 * np.linalg.norm(u)


def test_what_it_carries_and_how_stiff_it_is_are_found_from_there_and_not_from_nothing(column):
    basis = Basis.of(column.cloud, FitOptions(modes=0, ratio_modes=0), float(column.mu[0]))
    prior = basis.prior(0.2, 0.3)
    model = Model(basis=basis, prior=prior, s2=NOISE**2, extra=(), solver=LinearSolver.of(column.energy))
    begun = Prestress().anew(column, None)
    start = basis.stiffer(np.zeros(len(prior)), begun.stiffer)
    found = refit(column.moved(column.energy, begun.y), model, start, cause=Prestress(), theta=begun.theta)
    creeping = refit(column, model, np.zeros(len(prior)), cause=Prestress(), theta=np.zeros(1))
    assert creeping.theta < 0.5 and creeping.cost > 1.5 * found.cost
    assert found.theta == pytest.approx(1, abs=0.15)
    assert np.exp(np.log(found.scene.mu).mean()) == pytest.approx(1 / 2.6, rel=0.15)


def test_all_of_the_weight_may_be_taken_at_once_and_more_only_little_by_little():
    assert Prestress().room(np.array([0.2]), None) == pytest.approx(0.8)
    assert Prestress().room(np.array([1.5]), None) == Prestress().room(np.array([0.95]), None) < 0.2


def test_what_is_the_materials_is_worked_out_once_for_all_its_motions(column):
    """And again for another one: with four times the stiffness it vibrates twice as fast."""
    column.vibrations  # noqa: B018
    elsewhere = column.moved(column.energy, 2 * column.y)
    assert elsewhere.vibrations is column.vibrations
    elastic = column.energy.elastic
    stiff = column.of_material(elastic.with_parameters(4 * elastic.m))
    assert stiff.vibrations.omega == pytest.approx(2 * column.vibrations.omega, rel=1e-6)
    assert stiff.y is column.y and column.of_material(elastic) is column
