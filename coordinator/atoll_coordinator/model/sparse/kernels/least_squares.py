"""Sums over windows and least squares by orthogonalisation, in a fixed order of sums.

Letters: K columns, N rows, W windows of L rows.
"""

import math

from atoll_core.compilation.jit import kernel
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

DEPENDENT = 1e-9
"""A column of unit length of which the others leave less than this is a sum of them."""


@kernel
def windowed_sums(first: Ints, factors: FloatArray, values: FloatArray, sums: FloatArray) -> None:
    """Write for each column of `values` (K, N) and each window its sum times `factors` (W, L), from row `first` on.

    `first` is (W,), `sums` (K, W).
    """
    for k in range(values.shape[0]):
        for w in range(first.shape[0]):
            total = 0.0
            for j in range(factors.shape[1]):
                total += factors[w, j] * values[k, first[w] + j]
            sums[k, w] = total


@kernel
def triangularize(columns: FloatArray, side: FloatArray, upper: FloatArray, rotated: FloatArray) -> float:
    """Overwrite `columns` (K, N) by an orthonormal basis and `side` (N,) by what they leave; return its sum of squares.

    Modified Gram-Schmidt, the right side as a last column (Björck 1967). `upper` (K, K) takes the triangle,
    `rotated` (K,) the side in the basis; a column that depends on those before gets a row of zeros.
    """
    count, rows = columns.shape
    for k in range(count):
        norm = 0.0
        for i in range(rows):
            norm += columns[k, i] * columns[k, i]
        norm = math.sqrt(norm)
        upper[k, k] = norm if norm > DEPENDENT else 0.0
        rotated[k] = 0.0
        if not norm > DEPENDENT:
            for j in range(k + 1, count):
                upper[k, j] = 0.0
            continue
        for i in range(rows):
            columns[k, i] /= norm
        for j in range(k + 1, count):
            dot = 0.0
            for i in range(rows):
                dot += columns[k, i] * columns[j, i]
            upper[k, j] = dot
            for i in range(rows):
                columns[j, i] -= dot * columns[k, i]
        dot = 0.0
        for i in range(rows):
            dot += columns[k, i] * side[i]
        rotated[k] = dot
        for i in range(rows):
            side[i] -= dot * columns[k, i]
    left = 0.0
    for i in range(rows):
        left += side[i] * side[i]
    return left


@kernel
def invert_triangle(triangle: FloatArray, inverse: FloatArray) -> None:
    """Write the inverse of an upper triangle (M, M) into zeros; rows whose diagonal is 0 stay 0."""
    size = triangle.shape[0]
    for k in range(size - 1, -1, -1):
        if triangle[k, k] == 0.0:
            continue
        inverse[k, k] = 1.0 / triangle[k, k]
        for j in range(k + 1, size):
            total = 0.0
            for i in range(k + 1, j + 1):
                total += triangle[k, i] * inverse[i, j]
            inverse[k, j] = -total / triangle[k, k]
