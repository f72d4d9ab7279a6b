"""Motions: closed forms of oscillators and beams, finite-element frequencies, energy, order in time, same bits."""

import clouds
import fem
import numpy as np
import pytest
import sim_cases
from scipy.sparse import eye, kron
from scipy.sparse.linalg import eigsh
from skfem import BilinearForm

from sim.cloud import RestCloud
from sim.dynamics import Damping, simulate
from sim.elastic import Elastic
from sim.energy import Energy
from sim.lame import Lame
from sim.newton import NewtonOptions, Status, equilibrate
from sim.terms.contact import Contact, contact_alpha
from sim.terms.handles import Handles
from sim.terms.loads import AppliedForce
from sim.terms.shapes import Plane
from sim.terms.viscosity import Viscosity, turned_stiffness
from veo_ti.body import sample_box

LENGTH, WIDTH, DENSITY = 1.0, 0.2, 1000.0  # [m], [m], [kg/m3]
YOUNG, POISSON = 1e5, 0.3  # [Pa]
LAME = Lame(mu=YOUNG / (2 * (1 + POISSON)), lam=YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)))
BEAM_MASS = DENSITY * LENGTH * WIDTH**2  # [kg]
GAMMA = 2 - 2**0.5


# Closed forms of the integrator: a block that moves as a whole on handles is one linear oscillator.

OMEGA = 3.0  # [rad/s]


def block(poisson: float = 0.3) -> Elastic:
    """A cube of 1 m and 1 kPa."""
    cloud = RestCloud.build(clouds.block((4, 4, 4), (1.0, 1.0, 1.0)))
    return Elastic.neo_hookean(cloud, Lame(mu=1e3, lam=2e3 * poisson / (1 - 2 * poisson)))


def on_springs(elastic: Elastic, targets: np.ndarray | None = None) -> Energy:
    """The block with a spring at every point such that it swings at OMEGA as a whole; targets: shifts (T, 3) [m]."""
    cloud = elastic.cloud
    shift = np.zeros((1, 3)) if targets is None else targets
    alpha = OMEGA**2 / 2 * masses(elastic)
    return Energy.of(elastic, [Handles(points=np.arange(cloud.count), targets=cloud.x + shift[:, None], alpha=alpha)])


def free(elastic: Elastic, *terms) -> Energy:
    """A body that nothing holds, which `Energy.of` refuses."""
    return Energy(elastic=elastic, terms=terms, fixed=np.zeros(elastic.cloud.count, bool))


def masses(elastic: Elastic) -> np.ndarray:
    """Lumped masses (N,) [kg]."""
    return DENSITY * elastic.cloud.volume


def shifts(motion, elastic: Elastic) -> np.ndarray:
    """The mean displacement (T, 3) [m]."""
    return (motion.y - elastic.cloud.x).mean(axis=1)


def growth(z: complex) -> complex:
    """What a step of TR-BDF2 makes of exp(z)."""
    d, w = GAMMA / 2, 2**0.5 / 4
    return (1 + w * z * (1 + (1 + d * z) / (1 - d * z))) / (1 - d * z)


@pytest.mark.parametrize("drag", [0.0, 0.6])
def test_springs_give_the_integrators_closed_form(drag):
    elastic, x0 = block(), np.array([0.1, -0.2, 0.05])
    time, ratio = np.linspace(0, 2 * np.pi / OMEGA, 25), drag / (2 * OMEGA)
    motion = simulate(
        on_springs(elastic), time=time, mass=masses(elastic), start=elastic.cloud.x + x0, damping=Damping(mass=drag)
    )
    root = complex(-ratio, np.sqrt(1 - ratio**2))
    wave = growth(OMEGA * time[1] * root) ** np.arange(25)
    expected = (wave.real - root.real / root.imag * wave.imag)[:, None] * x0
    assert shifts(motion, elastic) == pytest.approx(expected, abs=1e-12)
    exact = np.exp(OMEGA * time * root)
    assert abs(wave - exact).max() < 0.042 * (OMEGA * time[1]) ** 2 * OMEGA * time[-1]  # what the module promises
    assert (np.diff(motion.total) < 0).all()


def test_loads_are_interpolated_between_frames():
    elastic = block()
    M, end = masses(elastic), np.array([0.3, 0.0, -0.2])
    force = OMEGA**2 * M[:, None] * end
    ramp = AppliedForce(force=np.stack([np.zeros_like(force), force]))
    pushed = Energy.of(elastic, [*on_springs(elastic).terms, ramp])
    led = on_springs(elastic, np.stack([np.zeros(3), end]))
    span = 2.0
    exact = (1 - np.sin(OMEGA * span) / (OMEGA * span)) * end
    for energy in (pushed, led):
        motion = simulate(energy, time=np.array([0.0, span]), mass=M, substeps=100)
        assert shifts(motion, elastic)[1] == pytest.approx(exact, rel=1e-3)


def test_handle_that_appears_takes_no_target_from_before():
    handles = Handles(points=np.array([0]), targets=np.array([[[9.0, 9, 9]], [[1.0, 2, 3]]]), alpha=[[0.0], [4.0]])
    half = handles.between(0, 0.5)
    assert half.targets.tolist() == [[[1, 2, 3]]] and half.alpha.tolist() == [[2]]
    assert handles.between(0, 0.0).alpha.tolist() == [[0]]


def test_free_flight_keeps_both_momenta():
    for poisson, damping in ((0.3, Damping()), (0.499, Damping(stiffness=0.01))):
        elastic, fall = block(poisson), np.array([0.0, 0.0, -9.81])
        x, M = elastic.cloud.x, masses(elastic)[:, None]
        spin = np.array([1.0, 0.0, 0.0]) + np.cross([0.0, 0.0, 2.0], x - x.mean(axis=0))
        energy = free(elastic, AppliedForce(force=M[None] * fall))
        motion = simulate(energy, time=np.linspace(0, 1, 41), mass=M[:, 0], velocity=spin, damping=damping)
        t, centre = motion.time[:, None], (M * motion.y).sum(axis=1) / M.sum()
        drift = (M * spin).sum(axis=0) / M.sum()
        assert centre == pytest.approx(centre[0] + t * drift + t**2 / 2 * fall, abs=1e-12)
        about = (M * np.cross(motion.y - centre[:, None], motion.velocity)).sum(axis=1)
        # A turn of 2 rad: a constant stiffness matrix would damp it as if it were strain.
        assert about == pytest.approx(np.broadcast_to(about[0], about.shape), abs=2e-3 * np.linalg.norm(about[0]))


# A clamped beam: frequencies, damping, added mass, overshoot.


@pytest.fixture(scope="module")
def beam() -> Energy:
    body = sample_box((LENGTH, WIDTH, WIDTH), 400)
    cloud = RestCloud.build(body.x, volume=body.volume, surface=body.surface)
    return Energy.of(Elastic.neo_hookean(cloud, LAME), [], cloud.x[:, 0] < 1e-9)


def loaded(beam: Energy, force: float, where: str = "tip") -> Energy:
    """The beam under a force [N] along z on its end face or on its volume."""
    x, volume = beam.elastic.cloud.x, beam.elastic.cloud.volume
    share = volume * (x[:, 0] > LENGTH - 1e-9) if where == "tip" else volume
    load = AppliedForce(force=(share / share.sum())[None, :, None] * np.array([0.0, 0.0, force]))
    return Energy.of(beam.elastic, [load], beam.fixed)


def bent(beam: Energy, drop: float) -> np.ndarray:
    """The static shape (N, 3) [m] under the tip load that beam theory says lowers the tip by `drop` [m]."""
    stiffness = 3 * YOUNG * WIDTH**4 / 12 / LENGTH**3
    return equilibrate(loaded(beam, -stiffness * drop), beam.elastic.cloud.x[None]).require_converged().y[0]


FIRST = 0.3175  # [Hz], roughly


@pytest.fixture(scope="module")
def swing(beam):
    """Release from a small static deflection: amplitude (T,) of the first mode, nearly, for three kinds of motion."""
    start, time = bent(beam, 1e-3), np.arange(52) / 40 / FIRST
    M, x = masses(beam.elastic), beam.elastic.cloud.x
    shape = M[:, None] * (start - x)

    def amplitude(**options) -> tuple:
        motion = simulate(beam, time=time, mass=M, start=start, **options)
        return time, ((motion.y - x) * shape).sum(axis=(1, 2)) / ((start - x) * shape).sum(), motion

    return amplitude


def frequency(time: np.ndarray, wave: np.ndarray) -> float:
    """From the first two zeros, half a period apart [Hz]."""
    before = np.flatnonzero(wave[:-1] * wave[1:] < 0)[:2]
    zeros = time[before] - wave[before] * (time[1] - time[0]) / (wave[before + 1] - wave[before])
    return 0.5 / float(zeros[1] - zeros[0])


def fem_frequency() -> float:
    """K u = w^2 M u on quadratic hexahedra [Hz]."""
    mesh = fem.box_mesh((0, 0, 0), (LENGTH, WIDTH, WIDTH), (8, 2, 2))
    constant = [lambda x, value=value: np.full(len(x), value) for value in (LAME.mu, LAME.lam)]
    body = fem.FemBody.build(mesh, *constant, lambda x: x[:, 0] < 1e-9)
    K = fem.stiffness(body, np.zeros_like(body.nodes))
    M = kron(BilinearForm(lambda u, v, w: DENSITY * u * v).assemble(body.basis), eye(3)).tocsr()
    inner = np.flatnonzero(~body.fixed.ravel())
    return float(np.sqrt(eigsh(K[inner][:, inner], 1, M[inner][:, inner], sigma=0)[0][0]) / (2 * np.pi))


def test_bending_frequency_is_that_of_the_finite_elements_and_of_beam_theory(swing):
    found = frequency(*swing()[:2])
    theory = 3.5160 / (2 * np.pi) * np.sqrt(YOUNG * WIDTH**2 / 12 / DENSITY) / LENGTH**2
    assert found == pytest.approx(fem_frequency(), rel=0.04)  # the cloud's stiffness
    assert found == pytest.approx(theory, rel=0.03)


def test_tip_mass_lowers_the_frequency_as_rayleigh_says(beam, swing):
    x = beam.elastic.cloud.x
    tip = x[:, 0] > LENGTH - 1e-9
    f0 = frequency(*swing()[:2])
    f = frequency(*swing(added_mass=0.5 * BEAM_MASS * tip / tip.sum())[:2])
    assert f == pytest.approx(f0 / np.sqrt(1 + 0.5 / 0.2357), rel=0.03)


def test_stiffness_damping_has_its_ratio(swing):
    time, wave, motion = swing(damping=Damping(stiffness=0.05))
    low = wave[:-1].argmin()
    a, b, c = np.polyfit(np.arange(-1, 2), wave[low - 1 : low + 2], 2)
    decrement, ratio = -np.log(b**2 / (4 * a) - c), 0.05 * np.pi * frequency(time, wave)
    assert decrement == pytest.approx(np.pi * ratio / np.sqrt(1 - ratio**2), rel=0.02)
    assert (np.diff(motion.total) < 0).all()


def test_sudden_load_overshoots_to_twice_the_static_deflection(beam):
    energy = loaded(beam, -0.01, "volume")
    x, tip = beam.elastic.cloud.x, beam.elastic.cloud.x[:, 0] > LENGTH - 1e-9
    still = equilibrate(energy, x[None]).y[0]
    motion = simulate(energy, time=np.arange(30) / 40 / FIRST, mass=masses(beam.elastic))
    drop = (motion.y - x)[:, tip, 2].mean(axis=1) / (still - x)[tip, 2].mean()
    assert drop.max() == pytest.approx(2, abs=0.04)


# Large motions of a body with a different material at every point, about 1 Pa and 160 points.


@pytest.fixture(scope="module")
def soft() -> Elastic:
    return sim_cases.elastic()


LOAD = np.array([[0.0, 0.004, -0.012]])  # [N]


def test_order_in_time_is_two(soft):
    energy = sim_cases.clamped(soft, np.linspace(0, 1, 2)[:, None] * LOAD)
    for damping in (Damping(), Damping(mass=0.2, stiffness=0.05)):
        runs = [
            simulate(energy, time=np.arange(2.0), mass=soft.cloud.volume, substeps=n, damping=damping).y[1]
            for n in (8, 16, 32)
        ]
        first, second = np.linalg.norm(runs[0] - runs[1]), np.linalg.norm(runs[1] - runs[2])
        assert np.log2(first / second) == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize(("share", "lost", "rise"), [(0.01, 0.01, 1e-8), (1.0, 0.02, 1e-4)])
def test_undamped_energy_is_kept_and_does_not_grow(soft, share, lost, rise):
    """36 steps a period, 3 periods; a large motion hands energy between modes, whose frames differ a little."""
    still = equilibrate(sim_cases.clamped(soft, share * LOAD), soft.cloud.x[None]).y[0]
    energy = Energy.of(soft, [], soft.cloud.x[:, 0] < 1e-9)
    motion = simulate(energy, time=np.arange(109) * 0.2, mass=soft.cloud.volume, start=still)
    kept = motion.total / motion.total[0]
    assert motion.kinetic.max() > 0.9 * motion.total[0]
    assert 1 - lost < kept[-1] < 1 and np.diff(kept).max() < rise


def test_damped_motion_loses_energy_and_ends_in_equilibrium(soft):
    energy = sim_cases.clamped(soft, LOAD)
    still = equilibrate(energy, soft.cloud.x[None]).y[0]
    damping = Damping(mass=1.0, stiffness=0.1)
    motion = simulate(energy, time=np.arange(51) * 0.5, mass=soft.cloud.volume, damping=damping)
    assert np.abs(still - soft.cloud.x).max() > 0.1
    assert motion.y[-1] == pytest.approx(still, abs=1e-5)
    assert (np.diff(motion.total) < 1e-12 * motion.total[0]).all()


def test_automatic_steps_keep_the_promised_error(soft):
    energy = sim_cases.clamped(soft, LOAD)
    common = {"time": np.array([0.0, 1.0, 2.0]), "mass": soft.cloud.volume}
    exact = simulate(energy, substeps=32, **common).y
    for accuracy in (1e-2, 1e-3):
        motion = simulate(energy, substeps="auto", accuracy=accuracy, **common)
        made = np.linalg.norm(motion.y - exact, axis=2).max(axis=1)
        assert (motion.error <= accuracy).all() and motion.error[1:].min() > 0.05 * accuracy
        assert made[1] < 2 * accuracy


def test_frames_and_substeps_are_the_same_steps(soft):
    time, load = np.linspace(0, 1, 5), np.linspace(0, 1, 5)[:, None] * LOAD
    frames = simulate(sim_cases.clamped(soft, load), time=time, mass=soft.cloud.volume)
    steps = simulate(sim_cases.clamped(soft, load[::4]), time=time[::4], mass=soft.cloud.volume, substeps=4)
    assert steps.y[1] == pytest.approx(frames.y[-1], abs=1e-9)
    assert steps.substeps.tolist() == [0, 4] and frames.substeps.tolist() == [0, 1, 1, 1, 1]


def test_two_runs_agree_to_the_bit(soft):
    energy = sim_cases.clamped(soft, np.linspace(0, 1, 4)[:, None] * LOAD)
    first, second = (
        simulate(energy, time=np.arange(4.0), mass=soft.cloud.volume, substeps="auto", damping=Damping(stiffness=0.1))
        for _ in range(2)
    )
    assert (first.y == second.y).all() and (first.velocity == second.velocity).all()
    assert (first.error == second.error).all() and (first.total == second.total).all()


@pytest.mark.parametrize("linear", ["direct", "two-level"])
def test_inner_solver_does_not_matter(soft, linear):
    energy = sim_cases.clamped(soft, LOAD)
    run = [
        simulate(energy, time=np.arange(3.0), mass=soft.cloud.volume, options=options, damping=Damping(stiffness=0.1)).y
        for options in (NewtonOptions(), NewtonOptions(linear=linear))
    ]
    assert run[1] == pytest.approx(run[0], abs=1e-7)


@pytest.mark.parametrize(("substeps", "lost"), [(1, 0.25), (4, 0.05)])
def test_stiff_floor_neither_rings_nor_adds_energy(substeps, lost):
    """A block falls on a floor that it enters by 1 mm: 10 ms a frame against the contact's 1 / 360 s."""
    cloud, gravity = block().cloud, np.array([0.0, 0.0, -1.0])
    elastic = Elastic.neo_hookean(cloud, Lame(mu=1e5, lam=1.5e5))
    M, alpha = masses(elastic), contact_alpha(1e5, cloud.spacing)
    at = np.array([[0.0, 0.0, -0.05]])
    floor = Contact(shape=Plane(normal=-gravity), volume=cloud.volume, alpha=alpha, position=at)
    energy = free(elastic, AppliedForce(force=M[None, :, None] * gravity), floor)
    motion = simulate(energy, time=np.arange(61) * 0.01, mass=M, substeps=substeps)
    gained = (motion.total - motion.total[0]) / (M.sum() * 0.05)
    assert motion.converged and (motion.substeps[1:] == substeps).all()
    assert -lost < gained.min() and gained.max() < 1e-3
    assert -0.052 < motion.y[..., 2].min() < -0.05


def test_free_fall_needs_no_newton_step(monkeypatch):
    """Loads and inertia cancel to rounding: the residual is relative to each of them."""
    elastic = block()
    M, steps = masses(elastic), []

    def counted(*arguments, **named):
        steps.append(equilibrate(*arguments, **named))
        return steps[-1]

    monkeypatch.setattr("sim.dynamics.equilibrate", counted)
    energy = free(elastic, AppliedForce(force=M[None, :, None] * np.array([0.0, 0.0, -1e-3])))
    assert simulate(energy, time=np.linspace(0, 1, 4), mass=M, substeps=300).converged
    assert max(solve.iterations[0] for solve in steps) == 0


def test_frame_that_is_not_reached_is_said(soft):
    energy = sim_cases.clamped(soft, np.array([[0, 0, 0], [0, 0, 0], [0, 0, -0.2], [0, 0, -0.2]]))
    motion = simulate(energy, time=np.arange(4.0), mass=soft.cloud.volume, options=NewtonOptions(iterations=1))
    assert not motion.converged
    assert [s is Status.CONVERGED for s in motion.status] == [True, True, False, False]
    assert motion.sentence == (
        "frame 2 of 4 (t = 2 s) was not reached: the solve of one of 64 steps stopped at the iteration limit before "
        "reaching the tolerance"
    )
    assert (motion.y[2:] == motion.y[1]).all() and (motion.kinetic[2:] == 0).all() and np.isfinite(motion.total).all()


def test_viscosity_is_the_integral_of_its_gradient_and_sees_no_spin(soft):
    x, random = soft.cloud.x, np.random.default_rng(0)
    y = sim_cases.bent(soft.cloud, 1)
    term = Viscosity(K=turned_stiffness(soft, y, 0.3), origin=y)
    z, way = y + 0.1 * random.normal(size=y.shape), random.normal(size=y.shape)
    slope = (term.gradient(z) * way).sum()
    assert sim_cases.taylor_rate(lambda v: term.value(v)[0], slope, z, way) == pytest.approx(2, abs=1e-6)
    step = term.tangent(z).product(way)
    assert term.gradient(z + way) - term.gradient(z) == pytest.approx(step, rel=1e-9)
    turned = (x @ clouds.rotation(2.0).T)[None]
    spin = np.cross([0.3, -1.0, 0.5], turned)
    K = turned_stiffness(soft, turned)
    assert np.abs(K.product(spin)).max() < 1e-12 * np.abs(K.product(way)).max()
    np.testing.assert_allclose(turned_stiffness(soft, x[None]).product(way), soft.tangent(x[None]).product(way))


# What it refuses.


WRONG = {
    "time must increase from frame to frame; got [0.0, 1.0, 1.0]": {"time": [0.0, 1.0, 1.0]},
    "time must increase from frame to frame; got []": {"time": []},
    "time must have one entry for each frame of the energy's terms; got 2": {"time": [0.0, 1.0]},
    "mass must be positive at every point; got 0.0": {"mass": np.eye(160)[0]},
    "mass must be positive at every point; got -1.0": {"mass": -np.ones(160)},
    "mass must have shape (160); got (3,)": {"mass": np.ones(3)},
    "added_mass must not be negative; got -1.0": {"added_mass": -np.ones(160)},
    "substeps must be a positive whole number or 'auto'; got 0": {"substeps": 0},
    "substeps must be a positive whole number or 'auto'; got 'many'": {"substeps": "many"},
    "accuracy must be positive; got 0.0": {"substeps": "auto", "accuracy": 0.0},
    "velocity must have shape (160, 3); got (1, 3)": {"velocity": np.ones((1, 3))},
    "start must be nowhere inside out (J > 0); got J = -1": {"start": -sim_cases.points()},
}


@pytest.mark.parametrize("sentence", WRONG)
def test_wrong_input_is_one_sentence(soft, sentence):
    energy = Energy.of(soft, [AppliedForce(force=np.zeros((3, 160, 3)))], np.arange(160) == 0)
    with pytest.raises(ValueError) as error:
        simulate(energy, **({"time": np.arange(3.0), "mass": np.ones(160)} | WRONG[sentence]))
    assert str(error.value) == sentence


@pytest.mark.parametrize("name", ["mass", "stiffness"])
def test_negative_damping_is_refused(name):
    with pytest.raises(ValueError, match=f"damping by {name} must be finite and not negative; got -0.1"):
        Damping(**{name: -0.1})
