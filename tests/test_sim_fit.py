"""Recovery of stiffness from noisy finite-element data, what the fit says about itself, and resuming."""

from dataclasses import replace

import fem_scenes
import numpy as np
import pytest
import sim_cases

from sim.basis import Basis, FitOptions
from sim.cloud import RestCloud
from sim.elastic import Elastic
from sim.energy import Energy
from sim.evidence import Normal, in_parts, independent, posterior
from sim.fit import Fit, check_gradient, fit, guess_modulus, normal_equations
from sim.lame import Lame
from sim.newton import NewtonOptions, equilibrate
from sim.resolution import other_discretisations
from sim.target import Target
from sim.terms.handles import Handles
from sim.terms.loads import AppliedForce

NOISE = 0.05  # spacings
FEW = np.array([0, 3, 8, 13, 18, 23])  # frames


def problem(sequence: fem_scenes.Sequence, frames: np.ndarray, mu: float = 1e4) -> tuple[Energy, Target]:
    """The clamped body of a sequence under its forces, and where its free points were seen."""
    cloud = RestCloud.build(sequence.points[0])
    elastic = Elastic.neo_hookean(cloud, Lame(mu=mu, lam=3 * mu))
    energy = Energy.of(elastic, [AppliedForce(force=sequence.forces[frames])], sequence.fixed)
    seen = np.repeat(~sequence.fixed[None], len(frames), axis=0)
    return energy, Target(y=sequence.points[frames], seen=seen)


def solve(energy: Energy, target: Target, **changes) -> Fit:
    start = sim_cases.at_rest(energy.elastic.cloud, len(target.y))
    return fit(energy, target, start, mu=guess_modulus(energy, target), **changes)


@pytest.fixture(scope="module")
def sequence() -> fem_scenes.Sequence:
    return fem_scenes.two_region_sequence(NOISE)


@pytest.fixture(scope="module")
def recovered(sequence) -> Fit:
    return solve(*problem(sequence, np.arange(len(sequence.points))))


@pytest.fixture(scope="module")
def few(sequence) -> tuple[Energy, Target]:
    return problem(sequence, FEW)


def test_two_regions_are_recovered_from_noisy_data(sequence, recovered):
    error = np.log10(recovered.lame.mu / sequence.mu_true)
    assert np.median(np.abs(error)) <= 0.05, f"median {np.median(np.abs(error)):.3f} decades"
    assert abs(error.mean()) < 0.02


def test_both_regions_have_their_own_stiffness(sequence, recovered):
    stiff = sequence.mu_true == sequence.mu_true.max()
    for region in (stiff, ~stiff):
        assert abs(np.median(np.log10(recovered.lame.mu / sequence.mu_true)[region])) < 0.05


def test_noise_is_estimated(sequence, recovered):
    assert recovered.state.sigma == pytest.approx(sequence.sigma, rel=0.05)


def test_material_is_positive_and_what_was_determined_a_share(recovered):
    assert (recovered.lame.mu > 0).all()
    assert (recovered.lame.lam > 0).all()
    assert ((recovered.determined >= 0) & (recovered.determined <= 1)).all()
    assert (recovered.log_mu_sd > 0).all()
    assert "all 25 frames converged" in recovered.sentence


def test_adjoint_is_right_at_the_fitted_material(sequence, recovered):
    energy, target = problem(sequence, np.arange(len(sequence.points)))
    assert check_gradient(energy, target, recovered) < 1e-6


def test_homogeneous_modulus_is_recovered_from_its_own_equilibrium(few):
    energy, target = few
    truth = Lame(mu=7e3, lam=21e3).spread(energy.elastic.cloud.count)
    true_energy = energy.with_elastic(energy.elastic.with_parameters(np.stack([truth.mu, truth.lam], axis=1)))
    start = sim_cases.at_rest(energy.elastic.cloud, len(FEW))
    y = equilibrate(true_energy, start, options=NewtonOptions(tolerance=1e-9)).y
    noise = 0.02 * energy.elastic.cloud.spacing
    seen = replace(target, y=y + noise * np.random.default_rng(0).normal(size=y.shape))
    found = solve(energy, seen, options=FitOptions().homogeneous)
    assert np.ptp(found.lame.mu) < 1e-9 * found.lame.mu[0]
    error = np.log(found.lame.mu[0] / 7e3)
    assert abs(error) < 0.01
    assert abs(error) < 4 * found.mean_sd
    assert found.state.sigma == pytest.approx(noise, rel=0.05)


def test_first_guess_is_within_a_factor_of_the_truth(sequence, few):
    for start in (1e2, 1e6):
        guess = guess_modulus(*few, mu=start)
        assert 0.5 * sequence.mu_true.min() < guess < 2 * sequence.mu_true.max()


def test_first_guess_does_not_see_what_pushes_all_the_time(sequence):
    """A constant push against the loads, five times as strong as any: alone it would make the object rigid."""
    energy, target = problem(sequence, np.arange(24))
    force = energy.terms[0].force
    against = -5 * force[np.argmax((force**2).sum(axis=(1, 2)))]
    true = energy.with_elastic(energy.elastic.with_parameters(np.tile([2e5, 8e5], (energy.elastic.cloud.count, 1))))
    pushed = Energy.of(true.elastic, [AppliedForce(force=force + against)], energy.fixed)
    y = equilibrate(pushed, sim_cases.at_rest(energy.elastic.cloud, len(force))).require_converged().y
    assert guess_modulus(energy, replace(target, y=y)) == pytest.approx(2e5, rel=0.05)


def test_motion_without_loads_tells_no_modulus(few):
    energy, seen = few
    idle = replace(energy, terms=tuple(replace(t, force=0 * t.force) for t in energy.terms))
    with pytest.raises(ValueError, match="loads must act on a point that may move in at least one frame of the fit"):
        guess_modulus(idle, seen)


def test_fit_that_was_interrupted_goes_on_to_the_same_material(few):
    """But for what the solves' tolerance leaves: the factors that they share are not stored."""
    states = []
    options = FitOptions(modes=12, ratio_modes=2)
    whole = solve(*few, options=options, progress=states.append)
    assert len(states) > 1
    assert states[-1].done
    resumed = solve(*few, options=options, state=states[0])
    np.testing.assert_allclose(resumed.lame.mu, whole.lame.mu, rtol=1e-5)
    np.testing.assert_allclose(resumed.lame.lam, whole.lame.lam, rtol=1e-5)
    assert resumed.state.objective == pytest.approx(whole.state.objective, rel=1e-5)


def test_field_beats_the_homogeneous_baseline(few):
    energy, target = few
    field = solve(energy, target, options=FitOptions(modes=12, ratio_modes=2))
    baseline = solve(energy, target, options=FitOptions().homogeneous)
    assert target.rms(field.equilibrium.y) < 0.8 * target.rms(baseline.equilibrium.y)


def test_one_standard_deviation_off_the_fit_costs_half_a_nat(few):
    """By new equilibria, to both sides of where it ended: neither is a way down, and its certainty is the curvature."""
    energy, target = few
    options, mu = FitOptions(modes=12, ratio_modes=2), guess_modulus(*few)
    state = solve(energy, target, options=options).state
    basis = Basis.of(energy.elastic.cloud, options, mu)
    prior = basis.prior(state.length, state.amplitude)
    parts = in_parts(normal_equations(energy, target, basis, state), 5)
    factor = independent(parts, prior, state.sigma, 1.0)
    width, ways = np.linalg.eigh(posterior(Normal.sum(parts).thinned(factor), prior, state.sigma).covariance)

    def cost(a: np.ndarray) -> float:
        moved = energy.with_elastic(basis.elastic(energy.elastic, a))
        y = equilibrate(moved, state.y, options=options.newton).require_converged().y
        return target.loss(y)[0] / (2 * state.sigma**2 * factor) + (a**2 / prior).sum() / 2

    for n in (0, len(width) // 2, -1):
        off = np.sqrt(width[n]) * ways[:, n]
        lost = [cost(state.a + sign * off) - cost(state.a) for sign in (1, -1)]
        assert lost == pytest.approx([0.5, 0.5], abs=0.15), n


def test_what_other_discretisations_change_is_what_fits_to_their_motion_find(few):
    """To first order, against whole fits: a homogeneous object moved by each of them, seen well, is not found to be
    homogeneous by ours."""
    energy, target = few
    noise = 1e-3 * energy.elastic.cloud.spacing * np.random.default_rng(0).normal(size=target.y.shape)
    found = []
    for elastic in (energy.elastic, *other_discretisations(energy.elastic)):
        y = equilibrate(energy.with_elastic(elastic), target.y).require_converged().y
        found.append(solve(energy, replace(target, y=y + noise), options=FitOptions(modes=8)))
    ours, *others = found
    free = ~energy.fixed
    off = np.sqrt(sum(np.log(other.lame.mu / ours.lame.mu)[free] ** 2 for other in others))
    assert len(others) == 3 and np.median(off) > 20 * np.sqrt(ours.log_mu_sd**2 - ours.resolution_sd**2)[free].mean()
    assert np.median(ours.resolution_sd[free] / off) == pytest.approx(1.0, abs=0.4)
    assert np.corrcoef(np.log(ours.resolution_sd[free]), np.log(off))[0, 1] > 0.8


def test_points_that_no_load_strains_keep_the_prior(sequence):
    """Only the clamped quarter moves: what is seen beyond it is held still."""
    energy = problem(sequence, FEW)[0]
    x = energy.elastic.cloud.x
    near = x[:, 0] < np.quantile(x[:, 0], 0.4)
    still = Energy.of(energy.elastic, energy.terms, energy.fixed | ~near)
    y = equilibrate(still, sim_cases.at_rest(energy.elastic.cloud, len(FEW))).y
    y += 0.02 * energy.elastic.cloud.spacing * np.random.default_rng(0).normal(size=y.shape)
    seen = np.repeat(~still.fixed[None], len(FEW), axis=0)
    found = solve(still, Target(y=y, seen=seen), options=FitOptions(modes=40))
    far = x[:, 0] > np.quantile(x[:, 0], 0.8)
    assert found.determined[far].mean() < found.determined[near].mean() - 0.1
    assert found.log_mu_sd[far].mean() > 2 * found.log_mu_sd[near].mean()


def test_unseen_points_do_not_enter_the_loss(few):
    target = few[1]
    hidden = target.seen.copy()
    hidden[:, ::2] = False
    y = np.where(hidden[..., None], target.y, np.nan)
    part = Target(y=y, seen=hidden)
    value, slope = part.loss(target.y + 1.0)
    assert value == pytest.approx(part.count)
    assert part.rms(target.y + 1.0) == pytest.approx(1.0)
    assert (slope[~hidden] == 0).all()


@pytest.mark.parametrize("options", [{"poisson": 0.5}, {"modes": -1}, {"iterations": 0}])
def test_impossible_options_end_in_a_sentence(options):
    with pytest.raises(ValueError, match=f"{next(iter(options))} must"):
        FitOptions(**options)


def test_first_guess_with_strings_that_are_not_always_seen(few):
    energy, target = few
    led = np.flatnonzero(~energy.fixed)[-3:]
    seen = np.array([[True, False, True]] * len(FEW))
    strings = Handles.relative(led, target.y[:, led], mu=1e4, spacing=energy.elastic.cloud.spacing, seen=seen)
    led_energy = Energy.of(energy.elastic, [*energy.terms, strings], energy.fixed)
    assert 1e2 < guess_modulus(led_energy, target) < 1e6
