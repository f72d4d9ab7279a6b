"""The integration correction: the smallest change of the gradient vectors that passes the patch test."""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import cg


def corrected_gradients(
    gradients: np.ndarray,
    arms: np.ndarray,
    neighbours: np.ndarray,
    volume: np.ndarray,
    area: np.ndarray,
    constrained: np.ndarray,
) -> np.ndarray:
    """Gradient vectors (N, k, 3) with `sum_i V_i G_ia = area_a` at the constrained points, linear fields still exact.

    gradients, arms (N, k, 3): g_ij and x_j - x_i. area (N, 3) [m2]: outward area vector of each point, zero inside.
    Without this discrete divergence theorem a uniform stress exerts forces inside the body, points relax, and the body
    is about twice too soft. The minimal-norm change solves one sparse system of N unknowns, three right-hand sides
    (variationally consistent integration, Chen, Hillman and Rueter 2013, in the least-norm form).
    """
    N, k = neighbours.shape
    scale = np.linalg.norm(arms, axis=2).mean(axis=1)  # a change counts relative to 1 / spacing
    unit = arms / scale[:, None, None]
    free = np.eye(k) - np.einsum("nad,nde,nbe->nab", unit, np.linalg.pinv(np.einsum("nad,nae->nde", unit, unit)), unit)
    blocks = _block_diagonal(free / scale[:, None, None] ** 2)
    incidence = _incidence(neighbours, volume)[constrained]
    missing = (area - _incidence(neighbours, volume) @ gradients.reshape(-1, 3))[constrained]
    system = (incidence @ blocks @ incidence.T).tocsr()
    multipliers = _solve(system, missing)
    return gradients + (blocks @ (incidence.T @ multipliers)).reshape(N, k, 3)


def _incidence(neighbours: np.ndarray, volume: np.ndarray) -> sp.csr_matrix:
    """C (N, N k) with (C g)_a = sum_i V_i G_ia: what a uniform unit stress pushes point a with."""
    N, k = neighbours.shape
    source, edge = np.repeat(np.arange(N), k), np.arange(N * k)
    rows, cols = np.concatenate([neighbours.ravel(), source]), np.concatenate([edge, edge])
    return sp.csr_matrix((np.concatenate([volume[source], -volume[source]]), (rows, cols)), (N, N * k))


def _block_diagonal(blocks: np.ndarray) -> sp.bsr_matrix:
    N, k, _ = blocks.shape
    return sp.bsr_matrix((blocks, np.arange(N), np.arange(N + 1)), shape=(N * k, N * k))


def _solve(system: sp.csr_matrix, right: np.ndarray) -> np.ndarray:
    """Jacobi-preconditioned conjugate gradients to 1e-10; a slightly singular system still has its minimal solution."""
    diagonal = system.diagonal()
    inverse = sp.diags(1.0 / np.where(diagonal > 0, diagonal, 1.0))
    system = system + 1e-10 * sp.diags(diagonal)
    return np.stack([cg(system, right[:, c], rtol=1e-10, maxiter=2000, M=inverse)[0] for c in range(3)], axis=1)
