"""Names for the arrays that kernels take, and the one door by which numpy arrays enter them."""

import numpy as np
import taichi as ti

real = ti.f64
vec3 = ti.types.vector(3, real)
mat3 = ti.types.matrix(3, 3, real)

Indices1 = ti.types.ndarray(dtype=ti.i32, ndim=1)
Indices2 = ti.types.ndarray(dtype=ti.i32, ndim=2)
Scalars1 = ti.types.ndarray(dtype=real, ndim=1)
Scalars2 = ti.types.ndarray(dtype=real, ndim=2)
Vectors1 = ti.types.ndarray(dtype=vec3, ndim=1)
Vectors2 = ti.types.ndarray(dtype=vec3, ndim=2)
Matrices1 = ti.types.ndarray(dtype=mat3, ndim=1)
Matrices2 = ti.types.ndarray(dtype=mat3, ndim=2)
Matrices3 = ti.types.ndarray(dtype=mat3, ndim=3)
Matrices4 = ti.types.ndarray(dtype=mat3, ndim=4)


def contiguous(array: np.ndarray, dtype: type = np.float64) -> np.ndarray:
    """The array as kernels need it: Taichi checks neither the dtype of vector elements nor their layout."""
    return np.ascontiguousarray(array, dtype=dtype)
