"""The verdict in noise that neighbours share, and what is said where too little is left to be called wrong."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from test_diagnosis_verdict import WRONG, found

from veo_ti.diagnosis.sentence import sentence
from veo_ti.diagnosis.verdict import judge, nothing


@pytest.mark.parametrize(
    ("gained", "like_noise", "wide", "kind"),
    [
        (3415, True, True, "named"),  # seed 7107: a drag against a creeping material, in noise that neighbours share
        (3415, True, False, "ambiguous"),  # what was not fitted yet may be the cause
        (3415, False, True, "ambiguous"),  # clear misfit is left: evidence says little
        (3600, True, True, "ambiguous"),  # as little as what the best one leaves is worth
    ],
)
def test_what_neighbours_share_is_no_misfit_once_all_were_fitted(gained, like_noise, wide, kind):
    a = replace(found("a", 3636, 0.983, z=116), like_noise=like_noise)
    b = replace(found("b", gained, 0.957, z=154), like_noise=True)
    assert judge(WRONG, [a, b], wide=wide).kind == kind


@pytest.mark.parametrize(
    ("gained", "kind"),
    [(515, "ambiguous"), (450, "named")],  # seed 6036: a tilt, 28 nats behind a force that took up more of the noise
)
def test_of_noise_that_neighbours_share_one_may_take_up_more_by_chance(gained, kind):
    near = [found("a", 543, 0.677, z=73, like_noise=True), found("b", gained, 0.67, z=75, like_noise=True)]
    assert judge(WRONG, near, wide=True).kind == kind


@pytest.mark.parametrize(
    ("given", "begins"),
    [
        (dict(), "Nothing is wrong that this measurement could show"),
        (dict(faint=True), "Hardly more is left than noise and the simulation's own error, and no known cause"),
        (dict(even=True), "Nothing is wrong that this measurement could show"),
    ],
)
def test_no_misfit_is_said_with_what_is_left(given, begins):
    """Seed 9478: a crack that the material imitates left 353 standard deviations, twice the noise in other frames."""
    diagnosis = SimpleNamespace(
        verdict=nothing(**given), noise=SimpleNamespace(sigma=4.4e-4, outlier_share=0.0), finished=True,
        gain=SimpleNamespace(before_mm=0.925, noise_mm=0.44),
        identification=SimpleNamespace(object=SimpleNamespace(force_scale_known=True)),
    )  # fmt: skip
    said = sentence(diagnosis)
    assert said.startswith(begins) and said.endswith("off by 0.93 mm (noise: 0.44 mm).")
    assert ("whatever the load" in said) == ("even" in given)
    diagnosis.gain = None
    assert sentence(diagnosis).endswith("The noise is 0.44 mm per coordinate.")
