"""Taichi fields that carry the material state of a batch, and the autodiff kernels over them."""

import functools
from typing import Any

import numpy as np
import taichi as ti

from sim import runtime


@ti.kernel
def _sum_psi(law: ti.template(), F: ti.template(), m: ti.template(), total: ti.template(), count: ti.i32):
    for i in range(count):
        total[None] += law.psi(F[i], m, i)


@ti.kernel
def _sum_power(
    law: ti.template(), F: ti.template(), W: ti.template(), m: ti.template(), total: ti.template(), count: ti.i32
):
    for i in range(count):
        total[None] += (law.piola(F[i], m, i) * W[i]).sum()


class MaterialFields:
    """Deformation gradients F, directions W and parameters m of a set of material points, with gradients.

    The kernels are pointwise and loop-free, the one form in which Taichi's reverse mode is right. They give dpsi/dF,
    the derivative of `P : W` in F (the Hessian is symmetric, so reverse mode yields dP[W]), and in the parameters,
    which is what the adjoint needs. A larger load makes the fields anew, twice as large; the old ones stay, since
    Taichi 1.7 trips over fields placed after others were destroyed.
    """

    def __init__(self, law: Any, capacity: int = 1024) -> None:
        runtime.ensure()
        self.law = law
        self._place(capacity)

    @classmethod
    @functools.cache
    def of(cls, law: Any) -> "MaterialFields":
        """The fields that all clouds of a law share: Taichi compiles its kernels again for every new set."""
        return cls(law)

    def load(self, F: np.ndarray, m: np.ndarray) -> None:
        """Set F (M, 3, 3) and parameters m (M, P)."""
        if len(F) > self.capacity:
            self._place(len(F))
        self._count = len(F)
        self.F.from_numpy(self._padded(F))
        self.m.from_numpy(self._padded(m))

    def stress(self) -> np.ndarray:
        """dpsi/dF, (M, 3, 3) [Pa], by reverse mode."""
        self._start()
        _sum_psi.grad(self.law, self.F, self.m, self.total, self._count)
        return self.F.grad.to_numpy()[: self._count]

    def stress_change(self, W: np.ndarray) -> np.ndarray:
        """dP[W], (M, 3, 3) [Pa], by reverse mode through P : W."""
        self._power_gradient(W)
        return self.F.grad.to_numpy()[: self._count]

    def parameter_gradient(self, W: np.ndarray) -> np.ndarray:
        """d(P : W)/dm, (M, P): how each point's power against W changes with its parameters."""
        self._power_gradient(W)
        return self.m.grad.to_numpy()[: self._count]

    def _place(self, capacity: int) -> None:
        self.capacity = 1 << max(capacity - 1, 1).bit_length()
        self.F = ti.Matrix.field(3, 3, ti.f64, needs_grad=True)
        self.W = ti.Matrix.field(3, 3, ti.f64)
        self.m = ti.field(ti.f64, needs_grad=True)
        self.total = ti.field(ti.f64, needs_grad=True)
        builder = ti.FieldsBuilder()
        builder.dense(ti.i, self.capacity).place(self.F, self.F.grad, self.W)
        builder.dense(ti.ij, (self.capacity, len(self.law.parameters))).place(self.m, self.m.grad)
        builder.place(self.total, self.total.grad)
        self._tree, self._count = builder.finalize(), 0

    def _power_gradient(self, W: np.ndarray) -> None:
        self.W.from_numpy(self._padded(W))
        self._start()
        _sum_power.grad(self.law, self.F, self.W, self.m, self.total, self._count)

    def _start(self) -> None:
        self.F.grad.fill(0.0)
        self.m.grad.fill(0.0)
        self.total.grad[None] = 1.0

    def _padded(self, array: np.ndarray) -> np.ndarray:
        padded = np.zeros((self.capacity, *array.shape[1:]))
        padded[: len(array)] = array
        return padded
