"""Finite-element measurements with something hidden, or nothing, must come out right: a small part of `make blind`.

The seeds are development seeds: the thresholds were set knowing them. The judgement is in docs/diagnosis.md.
"""

import pytest
from blind import judging, world


def said(seed: int, folder, **given) -> tuple[dict, dict]:
    """The truth, and what the toolkit answered; given: as `world.trial` takes it."""
    made = world.trial(seed, size="small", **given)
    made.save(folder / "measurement.npz", folder / "truth.npz")
    return made.truth, judging.verdict_on(folder / "measurement.npz", made)


@pytest.mark.parametrize("seed", [22, 30])
def test_nothing_hidden_nothing_found(seed, tmp_path):
    truth, answer = said(seed, tmp_path)
    assert truth["effects"] == []
    assert answer["verdict"] == "no_misfit", answer["sentence"]


@pytest.mark.parametrize("setting", ["correlated", "outliers"])
def test_noise_that_is_not_white_is_nothing_hidden(setting, tmp_path):
    """Sixty per cent of its variance reach over neighbours and last some frames; or one point in a hundred is stray."""
    answer = said(602, tmp_path, effect=(), setting=setting)[1]
    assert answer["verdict"] == "no_misfit", answer["sentence"]


@pytest.mark.parametrize(("seed", "effect"), [(24, "force_magnitude"), (28, "correspondence_slip")])
def test_hidden_effect_is_found_and_extends_the_model(seed, effect, tmp_path):
    truth, answer = said(seed, tmp_path)
    assert truth["effects"] == [effect]
    assert (answer["verdict"], answer["named"]) == ("named", [effect]), answer["sentence"]
    assert answer["excess_after_in_noise"] < 0.5 * answer["excess_in_noise"]
    assert answer["error_mm"]["after"] < answer["error_mm"]["refit_only"]


def test_a_stiffening_is_told_from_a_force_out_of_proportion(tmp_path):
    """Few points are strained ten times as much as the others, and to first order would hide them."""
    truth, answer = said(100, tmp_path, effect="strain_stiffening")
    assert (answer["verdict"], answer["named"]) == ("named", ["strain_stiffening"]), answer["sentence"]
    (row,) = answer["causes"][0]["parameters"]
    assert row["low"] < truth["planted"][0]["tells"]["beta"] < row["high"]
