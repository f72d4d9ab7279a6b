"""The diagnosis: fingerprints against re-solved equilibria, misfit, noise, gain and limits."""

from dataclasses import replace

import numpy as np
import pytest
import sim_cases
from scipy.signal import lfilter

from sim.basis import Basis, FitOptions
from sim.lame import Lame
from sim.newton import NewtonOptions, equilibrate
from sim.target import Target
from sim.terms.jet import Jet, jet_forces
from sim.terms.loads import AppliedForce
from veo_ti.diagnosis.causes import CATALOGUE, Cause, Change, Parameter
from veo_ti.diagnosis.causes.dynamics import Damping, Flow, Inertia, Ring
from veo_ti.diagnosis.causes.material import Stiffening, StrainStiffening
from veo_ti.diagnosis.columns import directions_of
from veo_ti.diagnosis.limits import limits
from veo_ti.diagnosis.misfit import Misfit
from veo_ti.diagnosis.moments import Along, moments
from veo_ti.diagnosis.noise import evenness, measure_noise
from veo_ti.diagnosis.scene import Scene
from veo_ti.diagnosis.score import Statistics
from veo_ti.observation import Observation
from veo_ti.scene import cloud_of, energy_of, target_of

FRAMES, NOISE = 9, 2e-4
TIGHT = NewtonOptions(tolerance=1e-10)


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A jittered box under a jet that wanders and swells; what was seen is its own simulation with noise."""
    x = sim_cases.points()
    along = np.linspace(0.5, 0.95, FRAMES)
    position = np.stack([along, np.full(FRAMES, 0.2), np.full(FRAMES, 1.0)], axis=1)
    direction = np.tile([0.1, 0.3, -1.0], (FRAMES, 1)) / np.sqrt(1.1)
    strength = 0.02 * np.array([0.0, 1, 2, 3, 2, 1, 2, 3, 1])
    jet = Jet(position=position, direction=direction, force=strength, footprint=0.15)
    observation = Observation(
        points=np.repeat(x[None], FRAMES, axis=0), time=0.1 * np.arange(FRAMES), fixed=x[:, 0] < 1e-9, jet=jet,
        mass=2e-4, gravity=np.array([0, 0, -9.81]),
    )  # fmt: skip
    cloud = cloud_of(observation)
    observation = replace(observation, forces=jet_forces(jet, cloud.x, cloud.area))
    energy = energy_of(observation, cloud)
    energy = energy.with_elastic(type(energy.elastic).neo_hookean(cloud, Lame(mu=1.0, lam=2.0)))
    y = equilibrate(energy, observation.points, options=TIGHT).require_converged().y
    noise = NOISE * np.random.default_rng(0).normal(size=y.shape)
    observation = replace(observation, points=np.concatenate([y[:1], y[1:] + noise[1:]]))
    train = np.ones(FRAMES, bool)
    return Scene(observation=observation, energy=energy, y=y, target=target_of(observation), train=train)


@pytest.fixture(scope="module")
def basis(scene) -> Basis:
    return Basis.of(scene.cloud, FitOptions(modes=6, ratio_modes=2), 1.0)


def resolved(scene: Scene, cause, theta: np.ndarray, place) -> np.ndarray:
    """What would be seen with the cause at theta, its history frozen at the scene's motion."""
    change = cause.change(scene, theta, place)
    extended = replace(scene.energy, terms=(*scene.energy.terms, *change.terms))
    y = equilibrate(extended, scene.y, options=TIGHT).y
    return y if change.observe is None else change.observe(y, np.arange(len(y)))


class SteadyWind(Cause):
    """The cause of docs/diagnosis.md."""

    name = "steady_wind"
    sentence = "A steady wind blows along x on everything."
    parameters = (Parameter(name="pressure", unit="Pa", sd=0.05),)

    def change(self, scene, theta, place):
        facing = np.abs(scene.cloud.area[:, :1]) / 2 * np.array([1.0, 0, 0])
        return Change(terms=(AppliedForce(force=scene.moving * theta[0] * facing),))


@pytest.mark.parametrize("cause", [*CATALOGUE, SteadyWind()], ids=lambda c: c.name)
def test_null_changes_nothing_and_fingerprint_is_the_slope_of_what_is_seen(cause, scene, basis):
    first, *others = cause.places(scene)
    for place in (first, *others[-1:]):
        fingerprint_is_the_slope(cause, place, scene, basis)


def test_stiffening_is_refitted_by_a_law_that_does_not_level_off(scene, basis):
    cause = StrainStiffening()
    assert [place.law for place in cause.laws(scene)] == ["yeoh", "gent"]
    assert [place.law for place in cause.places(scene)] == ["yeoh"]  # levelled off, the two are one
    far = Stiffening(law="yeoh", levels=1e9)  # where the strain to level off at is out of reach
    for found, beta, alike in zip(cause.laws(scene), (1.0, 1e-3), (1e-6, 1e-3), strict=True):  # Gent's where it is weak
        place, stiffer = cause.begin(found)
        fingerprint_is_the_slope(cause, place, scene, basis)
        plain, levelled = (cause.change(scene, np.full(1, beta), p).terms[0].value(scene.y) for p in (place, far))
        assert stiffer == 0
        assert levelled == pytest.approx(plain, rel=alike)


def fingerprint_is_the_slope(cause, place, scene, basis):
    widths = cause.widths(scene)
    zero = np.zeros(len(widths))
    assert np.abs(resolved(scene, cause, zero, place) - scene.y).max() < 1e-9
    directions = directions_of(cause, scene, place)
    first = np.eye(len(widths))[0]
    known = cause.known(place)
    if known is not None:  # a finite effect
        slope = (resolved(scene, cause, known * first, place) - scene.y) / known[0]
    else:
        step, back = 2e-3 * widths[0], not cause.parameters[0].positive
        ahead, behind = (resolved(scene, cause, sign * step * first, place) for sign in (1, -float(back)))
        slope = (ahead - behind) / (step * (1 + back))
    found = moments(scene, basis, np.zeros(10), (), directions, residual=slope)
    # The fingerprint S and the slope agree when |S - slope|^2 = S.S - 2 S.slope + slope.slope vanishes.
    A, b, c = found.normal.A, found.normal.b, found.normal.c
    column = found.nuisances
    gap = A[column, column] - 2 * b[column] + c
    assert c > 0
    assert gap < 1e-3 * c, f"fingerprint off by {np.sqrt(abs(gap) / c):.2%}"


LATE = [(Inertia(), Ring(ratio=0.2, power=power), most) for power, most in ((0, 0.03), (-1, 0.06), (1, 0.25))]
LATE += [(Damping(), Flow(), 0.006)]


@pytest.mark.parametrize(
    ("cause", "place", "most", "way"),
    [*((*late, way) for late in LATE for way in (2, 4, 8)), (Inertia(), Ring(ratio=0.02, power=0), 0.03, 2)],
)
def test_fingerprint_of_the_material_holds_what_it_does_to_a_motion_that_lags(cause, place, most, way, scene, basis):
    """Against another solve with a slightly other stiffness field, shown as the lagging object would be, on the frames
    that train; those between them, which do not, lag as well."""
    scene = replace(scene, train=np.arange(FRAMES) % 3 != 1)
    frames, step = np.arange(FRAMES), 2e-3 * np.eye(basis.log_mu.shape[1])[way]

    def solved(a: np.ndarray) -> Scene:
        lame = basis.lame(a)
        energy = scene.energy.with_elastic(scene.energy.elastic.with_parameters(np.stack([lame.mu, lame.lam], axis=1)))
        return scene.moved(energy, equilibrate(energy, scene.y, options=TIGHT).y)

    here = solved(0 * step)
    theta = cause.widths(here)
    ahead, behind = (cause.change(s, theta, place).observe(s.y, frames) for s in (solved(step), solved(-step)))
    slope = (ahead - behind) / np.linalg.norm(2 * step)
    carried = cause.carried(here, theta, place)
    found = moments(here, basis, 0 * step, (), (), along=Along(carried=carried), keep=True)
    plain = moments(here, basis, 0 * step, (), (), keep=True)
    column, without = (np.stack([X[way] for X in m.kept.columns]) for m in (found, plain))
    expected = np.stack([slope[t, scene.target.seen[t]].ravel() for t in found.kept.frames])
    # Those next to the vibrations that are followed are taken for far faster ones, of which nothing is late. By a law
    # that damps fast ones more they are as late as these, and one of them has a neighbour 0.05 % above the last.
    assert np.abs(column - expected).max() < most * np.abs(expected).max()
    assert np.abs(without - expected).max() > 0.1 * np.abs(expected).max()


def test_every_cause_has_its_own_name_sentence_and_units():
    assert len({cause.name for cause in CATALOGUE}) == len(CATALOGUE)
    for cause in CATALOGUE:
        assert cause.sentence.endswith(".") and cause.parameters
        assert all(p.unit and p.sd > 0 for p in cause.parameters)


def test_misfit_of_noise_is_small_and_of_a_smooth_error_large(scene, basis):
    modes = basis.field.modes[:, :6]

    def misfit(scene: Scene) -> Misfit:
        found = moments(scene, basis, np.zeros(10), (), (), modes=modes)
        return Statistics(moments=found, s2=NOISE**2, prior=basis.prior(0.2, 0.5)).misfit()

    wave = 2 * NOISE * np.sin(3 * scene.cloud.x[:, :1]) * np.array([0, 1.0, 0])
    wrong = replace(scene, target=replace(scene.target, y=scene.target.y + scene.moving * wave))
    assert abs(misfit(scene).z) < 3.5
    assert misfit(wrong).z > 8


def test_noise_is_measured_beside_misfit_and_stray_points(scene, basis):
    modes = basis.field.modes[:, :6]
    plain = measure_noise(scene, modes)
    assert plain.sigma == pytest.approx(NOISE, rel=0.1)
    assert plain.correlation < 1.5 and plain.outlier_share == 0
    bent = replace(scene, target=replace(scene.target, y=scene.target.y + scene.moving * 1e-3 * scene.cloud.x[:, :1]))
    assert measure_noise(bent, modes).sigma == pytest.approx(NOISE, rel=0.15)
    y = scene.target.y.copy()
    stray = np.flatnonzero(scene.target.seen[4])[[3, 40]]
    y[4, stray] += 30 * NOISE
    found = measure_noise(replace(scene, target=replace(scene.target, y=y)), modes)
    assert np.array_equal(np.argwhere(found.stray), [[4, i] for i in stray])  # and none of their neighbours
    assert found.sigma == pytest.approx(NOISE, rel=0.1)


def test_correlated_noise_is_counted_as_fewer_data(scene, basis):
    modes, random = basis.field.modes[:, :6], np.random.default_rng(1)
    smooth = np.einsum("ns,tsc->tnc", modes, random.normal(size=(FRAMES, 6, 3))) * NOISE / np.sqrt(6)
    target = replace(scene.target, y=scene.target.y + scene.moving * smooth)
    assert measure_noise(replace(scene, target=target), modes).correlation > 4


def test_a_body_that_lags_does_not_pass_for_correlated_noise(scene, basis):
    frames = np.arange(120)
    load = np.sin(np.pi * frames / 24) ** 2 * np.take([1.0, 3, 1, 3, 3], frames // 24)  # nothing in every 24th frame
    behind = 20 * (lfilter([0.15], [1, -0.85], load) - load)[:, None, None] * np.array([0, 1.0, 0])
    noise = np.random.default_rng(3).normal(size=(120, scene.cloud.count, 3))
    target = Target(y=scene.cloud.x + NOISE * (behind + noise), seen=np.ones(noise.shape[:2], bool))
    long = replace(scene, y=np.repeat(scene.cloud.x[None], 120, axis=0), target=target, train=frames >= 0)
    blown = long.under(load[:, None, None] * scene.forces.max(axis=0), None)
    assert measure_noise(blown, basis.field.modes[:, :6]).correlation < 100  # 179 by unloaded frames alone


def test_noise_that_lasts_goes_on_evenly_and_missing_physics_does_not(scene, basis):
    modes, random = basis.field.modes[:, :6], np.random.default_rng(2)
    steps = np.einsum("ns,tsc->tnc", modes, random.normal(size=(FRAMES, 6, 3)))
    lasting = np.stack([sum(0.8 ** (t - s) * steps[s] for s in range(t + 1)) for t in range(FRAMES)])  # AR(1)
    load = scene.total_force[:, None, None] / scene.total_force.max()
    wave = np.sin(3 * scene.cloud.x[:, :1]) * np.array([0, 1.0, 0])

    def even(left: np.ndarray) -> float:
        y = scene.y + scene.moving * (5 * NOISE * left + NOISE * random.normal(size=scene.y.shape))
        return evenness(replace(scene, target=replace(scene.target, y=y, sigma=NOISE)), modes)

    assert even(lasting) > 0.5
    assert even(load * wave) < 0.2 and even(0.1 * load * wave) < 0.2  # beside white noise that is twice as large
    assert not even(np.broadcast_to(wave, scene.y.shape))  # it stays, as a constant force would make it


def test_limits_of_a_measurement_are_said(scene):
    """Rest, levels and places there; then each taken away."""

    def told(frames, forces=None):
        forces = scene.forces[frames] if forces is None else forces
        time, other = 0.1 * np.arange(len(frames)), dict(jet=None, observed=None)
        observation = replace(scene.observation, points=scene.y[frames], forces=forces, time=time, **other)
        part = Scene(
            observation=observation, energy=scene.energy, y=scene.y[frames], target=target_of(observation),
            train=np.arange(len(frames)) % 4 > 0,
        )  # fmt: skip
        return " ".join(limits(part))

    rest_again = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 0, 1, 2])
    assert told(rest_again) == ""
    assert "No unloaded frame" in told(rest_again[:9])
    even = scene.forces / np.maximum(scene.total_force, 1e-300)[:, None, None]
    assert "about the same load" in told(rest_again, even[rest_again])
    assert "alike" in told(np.array([0, 3, 3, 3, 3, 3, 3, 3, 0, 3, 3, 3]))
    assert "Only" in told(rest_again[[0, 1, 2, 3, 0, 5]])
    assert "names a force" in told(rest_again, 0 * scene.forces[rest_again])
