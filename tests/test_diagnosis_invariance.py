"""A diagnosis does not depend on how a measurement is written down: on axes, order of points, or size and stiffness."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_diagnosis_report import CAUSES, HIDDEN, NOISE, OPTIONS, observation

from veo_ti.diagnosis.run import Diagnosis, diagnose
from veo_ti.identification import identify
from veo_ti.observation import Observation

TURN = Rotation.from_rotvec([0.4, -0.9, 0.7]).as_matrix()
LARGER, STIFFER = 7.0, 300.0
ORDER = np.random.default_rng(1).permutation(150)


def without_ties() -> Observation:
    """Pulled unseen; a tenth of the noise off, since points on an edge have neighbours just as near on both sides."""
    seen = observation(HIDDEN)
    return replace(seen, points=seen.points + 0.1 * NOISE * np.random.default_rng(2).standard_normal((150, 3)))


def turned(seen: Observation) -> Observation:
    """In other axes, with the origin elsewhere."""
    return replace(seen, points=seen.points @ TURN.T + [1.0, -2.0, 0.5], forces=seen.forces @ TURN.T)


def scaled(seen: Observation) -> Observation:
    """Of another size and stiffness: every strain as before."""
    return replace(
        seen, points=LARGER * seen.points, volume=LARGER**3 * seen.volume, forces=LARGER**2 * STIFFER * seen.forces
    )  # fmt: skip


def shuffled(seen: Observation) -> Observation:
    """With its points in another order."""
    points, forces = seen.points[:, ORDER], seen.forces[:, ORDER]
    by_point = {name: getattr(seen, name)[ORDER] for name in ("fixed", "surface", "volume")}
    return replace(seen, points=points, forces=forces, **by_point)


def diagnosed(seen: Observation) -> Diagnosis:
    return diagnose(identify(seen, options=OPTIONS), CAUSES, second=False)


@pytest.fixture(scope="module")
def usual():
    return diagnosed(without_ties())


@pytest.mark.parametrize(
    ("written", "expected"),
    [(turned, lambda force: TURN @ force), (scaled, lambda force: LARGER**2 * STIFFER * force), (shuffled, np.copy)],
    ids=lambda f: f.__name__,
)
def test_the_same_is_found_however_the_measurement_is_written(written, expected, usual):
    found = diagnosed(written(without_ties()))
    (before,), (after,) = usual.verdict.causes, found.verdict.causes
    assert (found.verdict.kind, after.name) == (usual.verdict.kind, before.name) == ("named", "hidden_force")
    force, force_before = after.refit.theta, expected(before.refit.theta)
    assert np.linalg.norm(force - force_before) < 0.1 * np.linalg.norm(after.refit.sd)  # of what the noise leaves open
    assert np.linalg.norm(force - force_before) < 1e-3 * np.linalg.norm(force_before)
    np.testing.assert_allclose(found.rounds[0].misfit.z, usual.rounds[0].misfit.z, rtol=1e-3)
