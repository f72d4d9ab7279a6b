"""The verdict in noise that neighbours share."""

from dataclasses import replace

import pytest
from test_diagnosis_verdict import WRONG, found

from veo_ti.diagnosis.verdict import judge


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
