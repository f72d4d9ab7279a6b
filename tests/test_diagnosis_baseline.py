"""The baseline against a finite-element measurement in which nothing but noise and outliers is hidden."""

from types import SimpleNamespace

import numpy as np
import pytest
from blind import world

from veo_ti.diagnosis.baseline import Baseline
from veo_ti.diagnosis.checkpoints import Checkpoints
from veo_ti.diagnosis.effort import Effort
from veo_ti.diagnosis.looks import CLOSER
from veo_ti.diagnosis.noise import counted
from veo_ti.identification import identify
from veo_ti.observation import Observation

SEED = 602  # one of development, whose identification leaves far more than noise
STRAY = 4e-3  # m, less than any outlier is off, and many times the noise


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> SimpleNamespace:
    folder = tmp_path_factory.mktemp("measured")
    made = world.trial(SEED, (), size="small", setting="outliers")
    made.save(folder / "measurement.npz", folder / "truth.npz")
    identified = identify(Observation.load(folder / "measurement.npz"))
    baseline = Baseline.of(identified, lambda text: None, Effort(), Checkpoints())
    return SimpleNamespace(made=made, identified=identified, baseline=baseline)


def test_the_residual_counts_as_what_the_baseline_itself_leaves(found):
    b = found.baseline
    assert counted(b.refit.left, b.noise, b.modes) > CLOSER * b.model.s2
    assert counted(b.refit.left, b.noise, b.modes) < b.model.s2 / CLOSER


def test_it_is_nearer_to_the_truth_than_the_identification(found):
    scene = found.baseline.refit.scene
    seen = scene.target.seen & scene.train[:, None]

    def off(y: np.ndarray) -> float:
        return float(np.sqrt(np.mean((y - found.made.clean)[seen] ** 2)))

    assert off(found.baseline.refit.shown) < 0.5 * off(found.identified.model.y)
    assert off(found.baseline.refit.shown) < 0.1 * found.baseline.noise.sigma


def test_its_noise_and_its_outliers_are_the_true_ones(found):
    noise, truth = found.baseline.noise, 1e-3 * found.made.truth["sigma_mm"]
    assert noise.sigma == pytest.approx(truth, rel=0.05)
    planted = np.linalg.norm(found.made.keys["points"] - found.made.clean, axis=2) > STRAY
    planted &= found.identified.model.target.seen  # of the surface alone
    assert planted.any()
    assert (noise.stray & planted).sum() > 0.98 * planted.sum()
    assert (noise.stray & ~planted).sum() < 0.01 * planted.sum()
