"""The elastic Hessian product as one writes it with whole arrays, for numpy, torch and JAX alike."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.elastic import ElasticTangent


@dataclass(frozen=True, kw_only=True)
class Library:
    """What the formula needs of an array library; arrays are (N, ..., T), frames last."""

    array: Callable[[np.ndarray], Any]
    einsum: Callable[..., Any]
    stack: Callable[..., Any]
    scatter: Callable[[Any, Any, int], Any]  # index (M,), rows (M, 3, T), N -> sums (N, 3, T)


def array_product(tangent: ElasticTangent, library: Library) -> Callable[[Any, Any], Any]:
    """A function (p (N, 3, T), F (N, 3, 3, T)) -> H p, matrix-free, the stabilisation included.

    The force on edge ij is `(V dP - S) g + s w p_ij - D h` with h = s w x_ij, D = sum p_ij g^T,
    S = sum p_ij h^T - D sum x h^T.
    """
    elastic, cloud = tangent.elastic, tangent.elastic.cloud
    N, k = cloud.neighbours.shape
    s = cloud.options.stabilisation * elastic.m[:, 0] * cloud.volume / cloud.reach**2
    weight = s[:, None] * cloud.weights
    reach = weight[..., None] * cloud.arms
    index = library.array(cloud.neighbours.astype(np.int64).ravel())
    g, h, w = (library.array(a) for a in (cloud.gradients, reach, weight))
    moment = library.array(np.einsum("nka,nkb->nab", reach, cloud.arms))
    v, mu, lam = (library.array(a[:, None, None, None]) for a in (cloud.volume, *elastic.m.T))
    einsum = library.einsum

    def product(p: Any, F: Any) -> Any:
        edge = p[index].reshape(N, k, 3, -1) - p[:, None]
        D = einsum("nkat,nkb->nabt", edge, g)
        C = 0.5 * _cross(F, F, library)
        J = (F[:, :1] * C[:, :1]).sum(2)[:, :, None]
        along = (C * D).sum(2).sum(1)[:, None, None]
        dP = mu * D + (lam + mu / J**2) * along * C + (lam * (J - 1) - mu / J) * _cross(F, D, library)
        S = einsum("nkat,nkb->nabt", edge, h) - einsum("nabt,nbc->nact", D, moment)
        force = einsum("nabt,nkb->nkat", v * dP - S, g) + w[..., None, None] * edge
        force = force - einsum("nabt,nkb->nkat", D, h)
        return library.scatter(index, force.reshape(N * k, 3, -1), N) - force.sum(1)

    return product


def _cross(A: Any, B: Any, library: Library) -> Any:
    """d cofactor(A)[B], (N, 3, 3, T)."""

    def row(i: int, j: int) -> Any:
        a, b, c, d = A[:, i], B[:, j], B[:, i], A[:, j]
        parts = [a[:, m] * b[:, n] - a[:, n] * b[:, m] + c[:, m] * d[:, n] - c[:, n] * d[:, m] for m, n in _PAIRS]
        return library.stack(parts, 1)

    return library.stack([row(i, j) for i, j in _PAIRS], 1)


_PAIRS = ((1, 2), (2, 0), (0, 1))
