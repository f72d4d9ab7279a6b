"""The prior of the material beside a cause: it follows the data that the cause leaves, not what was fitted before."""

import numpy as np
import pytest
import sim_cases

from sim.basis import Basis, FitOptions
from sim.evidence import Normal, posterior
from veo_ti.diagnosis.model import Model

NOISE = 1e-3


def model(modes: int = 30) -> Model:
    basis = Basis.of(sim_cases.cloud("jittered"), FitOptions(modes=modes, ratio_modes=0), 1e4)
    stiff = basis.prior(3 * basis.size, 0.005)  # what a fit under wrong physics may end with
    return Model(basis=basis, prior=np.append(stiff, 1.0), s2=NOISE**2, extra=(), solver=None)


def measured(m: Model, length: float, amplitude: float, seed: int) -> Normal:
    """Data linear in coefficients that were drawn from a prior, one further unknown among them, with noise."""
    rng, K = np.random.default_rng(seed), len(m.prior)
    truth = np.sqrt(np.append(m.basis.prior(length, amplitude), 1.0)) * rng.normal(size=K)
    J = rng.normal(size=(K, 400))
    z = truth @ J + NOISE * rng.normal(size=400)
    return Normal(A=J @ J.T, b=J @ z, c=float(z @ z), count=400)


@pytest.mark.parametrize("amplitude", [0.1, 0.5])
def test_an_object_that_varies_gets_a_prior_that_lets_it(amplitude):
    m, found = model(), []
    for seed in range(8):
        normal = measured(m, m.basis.size / 4, amplitude, seed)
        tuned = m.tuned(normal, m.prior, NOISE**2)
        assert tuned[-1] == m.prior[-1]  # the further unknown keeps its own
        found.append(np.sqrt(np.median(tuned[1:-1] / m.basis.prior(m.basis.size / 4, amplitude)[1:])))
    assert 0.5 < np.median(found) < 2, found


def test_no_choice_of_the_grid_has_higher_evidence_and_a_better_prior_is_kept():
    m = model()
    normal = measured(m, m.basis.size / 4, 0.5, 0)
    truth = np.append(m.basis.prior(m.basis.size / 4, 0.5), 1.0)
    tuned = m.tuned(normal, truth, NOISE**2)

    def evidence(prior: np.ndarray) -> float:
        return posterior(normal, prior, NOISE).evidence

    assert evidence(tuned) >= evidence(truth) > evidence(m.prior)


def test_a_homogeneous_material_has_no_prior_to_tune():
    m = model(modes=0)
    normal = measured(m, m.basis.size / 4, 0.5, 0)
    assert m.tuned(normal, m.prior, NOISE**2) is m.prior
