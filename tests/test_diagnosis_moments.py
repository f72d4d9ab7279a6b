"""Inner products of fingerprints with each other, the residual and the smooth modes, against columns that are made."""

import numpy as np
import pytest

from veo_ti.diagnosis.moments import _summed, time_modes


@pytest.mark.parametrize("modes", [0, 1, 4])
def test_inner_products_with_smooth_modes_are_those_of_their_columns(modes):
    """A mode's column is its product of space, time and axis at every point seen; some frames see fewer points."""
    rng, cosines = np.random.default_rng(modes), time_modes(5)
    frames, columns, residuals = [], [], []
    for t, n in enumerate([9, 7, 9, 2, 8]):
        X, z, space = rng.normal(size=(3, 3 * n)), rng.normal(size=3 * n), rng.normal(size=(n, modes))
        frames.append((X, z, space, cosines[t]))
        waves = [
            np.outer(space[:, s] * cosines[t, k], axis).ravel()
            for axis in np.eye(3) for s in range(modes) for k in range(cosines.shape[1])
        ]  # fmt: skip
        columns.append(np.vstack([X, *waves]))
        residuals.append(z)
    found = _summed(frames)
    X, z = np.hstack(columns), np.concatenate(residuals)
    assert np.abs(found.A - X @ X.T).max() < 1e-12
    assert np.abs(found.b - X @ z).max() < 1e-12
    assert found.c == pytest.approx(z @ z)
    assert found.count == len(z)
