"""What is believed of a material field before data: smooth, with a Matern spectrum on the cloud's graph."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import eigsh

from sim.cloud import RestCloud


@dataclass(frozen=True, kw_only=True, eq=False)
class FieldModes:
    """The smoothest modes of a cloud: eigenvectors of its graph Laplacian, orthonormal in volume, first constant."""

    modes: np.ndarray  # (N, K), volume-mean of each mode's square is 1
    eigenvalues: np.ndarray  # (K,) [1/m2]

    @classmethod
    def of(cls, cloud: RestCloud, count: int) -> "FieldModes":
        """`L phi = lambda V phi` with edge weights V / d^2, so that L approximates minus the Laplacian."""
        count = min(count, cloud.count - 2)
        N, k = cloud.neighbours.shape
        weights = (2 * cloud.volume[:, None] / k * 1.5 / (cloud.arms**2).sum(axis=2)).ravel()
        W = sp.csr_matrix((weights, (np.repeat(np.arange(N), k), cloud.neighbours.ravel())), (N, N))
        W = (W + W.T) / 2
        L = sp.diags(np.asarray(W.sum(axis=1)).ravel()) - W
        total = cloud.volume.sum()
        size = float((cloud.x.max(axis=0) - cloud.x.min(axis=0)).max())
        start = np.random.default_rng(0).standard_normal(N)
        values, modes = eigsh(L.tocsc(), k=count, M=sp.diags(cloud.volume).tocsc(), sigma=-1e-3 / size**2, v0=start)
        modes *= np.sign(modes[np.abs(modes).argmax(axis=0), range(count)]) * total**0.5
        return cls(modes=modes, eigenvalues=np.maximum(values, 0.0))

    def spectrum(self, length: float) -> np.ndarray:
        """Prior variance of each mode (K,) at unit mean variance of the field: Matern, (1 + length^2 lambda)^-2."""
        raw = (1 + length**2 * self.eigenvalues) ** -2.0
        raw[0] = 0.0  # the mean has its own parameter
        return raw / max(raw.sum(), 1e-300)
