"""A law's own functions called point by point, which tests hold against each other and against autodiff."""

import taichi as ti

from sim.dtypes import Matrices1, Scalars1, Scalars2


@ti.kernel
def evaluate(law: ti.template(), F: Matrices1, W: Matrices1, m: Scalars2, psi: Scalars1, P: Matrices1, dP: Matrices1):
    """psi, P and dP[W] of every F with the parameters m."""
    for i in range(F.shape[0]):
        psi[i] = law.psi(F[i], m, i)
        P[i] = law.piola(F[i], m, i)
        dP[i] = law.dpiola(F[i], W[i], m, i)
