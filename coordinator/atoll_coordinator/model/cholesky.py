"""Cholesky factors of small symmetric matrices in kernels, with Levenberg-Marquardt damping."""

import math

import numpy as np

from atoll_core.compilation.jit import allocating_kernel, kernel
from atoll_core.data.dataset import FloatArray

SMALLEST = 1e-200
"""Least curvature that counts: below it a direction is flat."""
RIDGE = 1e-13


@kernel
def factorize(matrix: FloatArray, size: int, scale: FloatArray, damping: float) -> bool:
    """Scale a symmetric `matrix` to the diagonal 1 + damping, and overwrite its lower triangle with the Cholesky
    factor.

    `scale` (size,) takes the square roots of the diagonal. Returns False if the scaled matrix is not positive definite.
    """
    for i in range(size):
        scale[i] = math.sqrt(max(matrix[i, i], SMALLEST))
    for i in range(size):
        for j in range(i):
            matrix[i, j] /= scale[i] * scale[j]
        matrix[i, i] = 1.0 + damping + RIDGE
    for i in range(size):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                matrix[i, i] = math.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    return True


@kernel
def substitute(factor: FloatArray, size: int, scale: FloatArray, vector: FloatArray) -> None:
    """Overwrite `vector` (size,), a right-hand side, with the solution of the linear system that `factorize`
    prepared."""
    for i in range(size):
        total = vector[i] / scale[i]
        for k in range(i):
            total -= factor[i, k] * vector[k]
        vector[i] = total / factor[i, i]
    for i in range(size - 1, -1, -1):
        total = vector[i]
        for k in range(i + 1, size):
            total -= factor[k, i] * vector[k]
        vector[i] = total / factor[i, i]
    for i in range(size):
        vector[i] /= scale[i]


@allocating_kernel
def solve_damped(matrix: FloatArray, damping: float, vector: FloatArray) -> bool:
    """Overwrite `vector` (K,), a right-hand side, with the solution of the linear system of `matrix` (K, K), whose
    diagonal is first raised by the share `damping`.

    If the raised matrix is not positive definite, returns False and does not change the vector.
    """
    factor, scale = matrix.copy(), np.empty(len(vector))
    if not factorize(factor, len(vector), scale, damping):
        return False
    substitute(factor, len(vector), scale, vector)
    return True
