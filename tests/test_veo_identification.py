"""From a measurement to an object: better than its baselines, resumable, honest about what it holds."""

import re

import numpy as np
import pytest

from sim.basis import FitOptions
from veo_ti.identification import IdentifyOptions, identify
from veo_ti.observation import Observation
from veo_ti.results import gained, sentence, write_identification
from veo_ti.store import read_sequence

OPTIONS = IdentifyOptions(fit=FitOptions(modes=8, ratio_modes=0, iterations=2))


@pytest.fixture(scope="module")
def observation() -> Observation:
    """Every fourth frame of the embedded finite-element example: seven loads and the rest pose."""
    return Observation.load("example").frames(np.arange(0, 28, 4))


@pytest.fixture(scope="module")
def identified(observation):
    return identify(observation, options=OPTIONS)


def test_material_field_predicts_unseen_frames_better_than_the_baselines(identified):
    metrics = identified.metrics
    model, plain, rest = (
        metrics[f"error_mm{name}"]["held_out"]["mean"] for name in ("", "_homogeneous", "_no_change")
    )
    assert model < plain < rest
    over = metrics["gained_mm"]
    assert over["over_homogeneous"]["mean"] == pytest.approx(plain - model)
    assert over["over_no_change"]["mean"] == pytest.approx(rest - model)
    assert all(gain["low"] <= gain["mean"] <= gain["high"] for gain in over.values())


def test_held_out_frames_are_not_trained_on(identified):
    assert not set(identified.train) & set(identified.held_out)
    assert len(identified.held_out) > 0


def test_gradient_agrees_with_finite_differences(identified):
    assert identified.gradient_error < 1e-4  # solves end at 1e-10 of the load, differences are taken at 1e-4


def test_interrupted_run_goes_on_where_it_stopped(observation, identified, tmp_path):
    def stop_in_the_field(stage, state):
        if stage == "field":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        identify(observation, options=OPTIONS, checkpoints=tmp_path, progress=stop_in_the_field)
    seen = []
    resumed = identify(
        observation, options=OPTIONS, checkpoints=tmp_path, progress=lambda stage, state: seen.append(stage)
    )
    assert "homogeneous" not in seen  # that stage was finished before the interruption
    np.testing.assert_allclose(resumed.object.lame.mu, identified.object.lame.mu, rtol=1e-9)


def test_folder_holds_everything_and_the_checkpoint_is_gone(observation, identified, tmp_path):
    (tmp_path / "checkpoint_field.npz").write_bytes(b"")
    write_identification(identified, observation, tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert {"object.vtkhdf", "metrics.json", "report.html", "mu.png", "mu.mp4", "error_over_time.png"} <= names
    assert not any(name.startswith("checkpoint") for name in names)
    stored = read_sequence(tmp_path / "object.vtkhdf")
    np.testing.assert_array_equal(stored.static["mu"], identified.object.lame.mu)
    assert len(stored.time) == len(observation.time)


def test_sentence_tells_what_nine_points_in_ten_have_and_how_well_it_is_known(identified):
    low, high = re.search(r"modulus of (\S+) to (\S+) kPa", sentence(identified.metrics)).groups()
    mu = identified.object.lame.mu / 1e3
    assert np.mean((mu > 0.995 * float(low)) & (mu < 1.005 * float(high))) == pytest.approx(0.9, abs=0.02)
    factor = float(re.search(r"within a factor of (\S+) \(95 %\)", sentence(identified.metrics))[1])
    off = 1.96 * identified.fit.log_mu_sd
    assert np.mean(off < np.log(0.95 * factor)) < 0.5 < np.mean(off < np.log(1.05 * factor))  # it is rounded


def test_it_is_said_where_most_of_what_is_not_known_is_the_discretisations(identified):
    whole, own = (identified.metrics[name]["median"] for name in ("log_mu_sd", "log_mu_sd_of_discretisation"))
    assert 0 < own < whole
    for share, said in ((0.6, False), (0.8, True)):
        part = {"log_mu_sd": {"median": 0.5}, "log_mu_sd_of_discretisation": {"median": 0.5 * share}}
        assert ("the simulation's own error" in sentence({**identified.metrics, **part})) == said


def test_a_gain_that_may_be_chance_is_called_so(identified):
    found = {"mean": 0.1, "low": 0.05, "high": 0.2}
    sure = {**identified.metrics, "gained_mm": {"over_homogeneous": found}}
    assert "gained 0.10 mm over one homogeneous material (95 %: 0.05 to 0.20 mm)." in gained(sure)
    assert "may be chance" in gained({**sure, "gained_mm": {"over_homogeneous": {**found, "low": -0.1}}})
    assert gained({**sure, "gained_mm": {"over_homogeneous": None}}) == ""  # nothing was held out


def test_unknown_force_scale_is_said(identified):
    metrics = {**identified.metrics, "force_scale_known": False}
    assert "relative" in sentence(metrics)
