"""Compiled loops of sparse regression: sums over windows, least squares, elimination. All sums have a fixed order.

Measurement errors of the variables are also errors of the columns. Least squares then adds products of errors to the
products of columns, so that coefficients become too small and terms with small errors are preferred. If the mean of
these products of errors is subtracted, the estimate is consistent (Fuller 1987, section 3.1).

Letters: K columns, N rows (of tables or of sums), W windows of L rows, V variables.
"""

import math

import numpy as np

from atoll_coordinator.model.cholesky import factorize, substitute
from atoll_core.compilation.jit import allocating_kernel, kernel
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

DEPENDENT = 1e-9
"""A column of unit norm is a linear combination of earlier columns if the norm of its residual is not above this."""
_MOST_CORRECTED = 0.9
"""Numerical limit: at most this share of the squared norm of any linear combination of columns is subtracted as errors.
The variance of an estimate grows with the inverse of the remaining share."""


@kernel
def windowed_sums(first: Ints, factors: FloatArray, values: FloatArray, sums: FloatArray) -> None:
    """Write the weighted sum of each column of `values` (K, N) over each window into `sums` (K, W).

    Window w starts at row first[w] of `first` (W,), and factors[w] of `factors` (W, L) are the weights of its rows.
    """
    for k in range(values.shape[0]):
        for w in range(first.shape[0]):
            total = 0.0
            for j in range(factors.shape[1]):
                total += factors[w, j] * values[k, first[w] + j]
            sums[k, w] = total


@kernel
def triangularize(columns: FloatArray, side: FloatArray, upper: FloatArray, rotated: FloatArray) -> float:
    """Overwrite `columns` (K, N) by an orthonormal basis and `side` (N,) by the residuals; return their sum of squares.

    The method is modified Gram-Schmidt with the right side `side` as the last column (Björck 1967). `upper` (K, K)
    becomes the upper triangle, and `rotated` (K,) the components of `side` in the basis. A column that depends on
    earlier columns gets a row of zeros in the triangle.
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
    """Write the inverse of an upper `triangle` (M, M) into `inverse` (M, M); rows with a diagonal of 0 stay 0.

    `inverse` must be zero before.
    """
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


@kernel
def sum_error_products(
    gradients: FloatArray, variances: FloatArray, target: int, squares: FloatArray, halves: FloatArray,
    products: FloatArray, cross: FloatArray,
) -> None:  # fmt: skip
    """Write the error covariances of pairs of columns, and of each column with the right side, summed over windows.

    `gradients` (K, V, N) are the derivatives of the columns' functions with respect to the variables. The errors of the
    variables have `variances` (V,). `squares` and `halves` (N,) are weights of the squared error of each row: `squares`
    if both factors are weighted by the test function, `halves` if one of them is weighted by its slope. The covariances
    of pairs of columns are written into `products` (K, K), the covariances with the right side (variable `target`) into
    `cross` (K,).
    """
    for k in range(gradients.shape[0]):
        total = 0.0
        for row in range(gradients.shape[2]):
            total += halves[row] * gradients[k, target, row]
        cross[k] = total * variances[target]
        for m in range(k + 1):
            whole = 0.0
            for v in range(gradients.shape[1]):
                if variances[v] > 0.0:
                    total = 0.0
                    for row in range(gradients.shape[2]):
                        total += squares[row] * gradients[k, v, row] * gradients[m, v, row]
                    whole += total * variances[v]
            products[k, m] = whole
            products[m, k] = whole


@allocating_kernel
def eliminate(
    columns: FloatArray, side: FloatArray, products: FloatArray, cross: FloatArray, steps: int, order: Ints,
    squares: FloatArray, found: FloatArray, errors: FloatArray,
) -> None:  # fmt: skip
    """Fit `side` (N,) by all `columns` (K, N), remove the column whose removal costs least, and repeat `steps` times.

    `products` (K, K) are the mean products of the errors of two columns, `cross` (K,) the mean products of the errors
    of a column and of the side; both are empty if the columns have no errors. If columns are mostly errors, as in a
    library that is too large, only a part of these means is subtracted, so that the equations stay solvable.

    Args:
        steps: number of steps, at most K; results of later steps are not written, except the last number of `squares`.
        order: result, (K,): the columns in the order of their removal, then the remaining columns.
        squares: result, (K + 1,): the sums of squared residuals with the last K, K - 1, ... 0 columns of `order`.
        found: result, (K, K), zero before: the coefficients of all columns at each step, 0 for removed columns.
        errors: result, (K + 1,), zero before: the contribution of errors of the columns to the same sums.
    """
    count, rows = columns.shape
    unit, rest = columns.copy(), side.copy()
    scale = np.ones(count)
    for k in range(count):
        norm = 0.0
        for i in range(rows):
            norm += unit[k, i] * unit[k, i]
        scale[k] = math.sqrt(norm) if norm > 0.0 else 1.0
        for i in range(rows):
            unit[k, i] /= scale[k]
    upper, rotated = np.zeros((count, count)), np.zeros(count)
    base = triangularize(unit, rest, upper, rotated)
    kept = np.arange(count)
    for step in range(steps):
        size = count - step
        part, reached, triangle = np.zeros((size, count)), np.zeros(size), np.zeros((size, size))
        left_over = rotated.copy()
        for j in range(size):
            for i in range(kept[j] + 1):
                part[j, i] = upper[i, kept[j]]
        squares[step] = base + triangularize(part, left_over, triangle, reached)
        half, inverse, values = np.zeros((size, size)), np.eye(size), reached.copy()
        invert_triangle(triangle, half)
        worst, least = 0, math.inf
        for k in range(size):
            if triangle[k, k] == 0.0:
                worst, least = k, -1.0
        if least > 0.0 and len(cross):
            share, own = np.empty((size, size)), np.empty(size)
            for j in range(size):  # the error products in the basis of the triangle T: T'^-1 P T^-1 and T'^-1 c
                own[j] = cross[kept[j]] / scale[kept[j]]
                for k in range(size):
                    share[j, k] = products[kept[j], kept[k]] / scale[kept[j]] / scale[kept[k]]
            for j in range(size):
                for i in range(j):
                    own[j] -= triangle[i, j] * own[i]
                    for k in range(size):
                        share[j, k] -= triangle[i, j] * share[i, k]
                own[j] /= triangle[j, j]
                for k in range(size):
                    share[j, k] /= triangle[j, j]
            for j in range(size):
                for i in range(j):
                    for k in range(size):
                        share[k, j] -= triangle[i, j] * share[k, i]
                for k in range(size):
                    share[k, j] /= triangle[j, j]
            allowed, sizes = 1.0, np.zeros(size)
            while not _factorize_rest(share, _MOST_CORRECTED / allowed, inverse, sizes):
                allowed *= 0.5
            factor = np.empty((size, size))
            _factorize_rest(allowed * share, 1.0, factor, sizes)
            for j in range(size):
                inverse[j] = 0.0
                inverse[j, j] = 1.0
                substitute(factor, size, sizes, inverse[j])
                values[j] += allowed * own[j]
            substitute(factor, size, sizes, values)
            for j in range(size):
                squares[step] += (reached[j] - values[j]) ** 2
                errors[step] += allowed * 2.0 * own[j] * values[j]
                for k in range(size):
                    errors[step] += allowed * values[j] * share[j, k] * values[k]
        for k in range(size):
            if triangle[k, k] == 0.0:
                continue
            value, variance = 0.0, 0.0
            for j in range(k, size):
                value += half[k, j] * values[j]
                for i in range(k, size):
                    variance += half[k, j] * inverse[j, i] * half[k, i]
            found[step, kept[k]] = value / scale[kept[k]]
            if value * value < least * variance:
                worst, least = k, value * value / variance
        order[step] = kept[worst]
        for j in range(worst, size - 1):
            kept[j] = kept[j + 1]
    for j in range(count - steps):
        order[steps + j] = kept[j]
    total = 0.0
    for i in range(rows):
        total += side[i] * side[i]
    squares[count] = total


@allocating_kernel
def _factorize_rest(share: FloatArray, limit: float, factor: FloatArray, sizes: FloatArray) -> bool:
    """Write the Cholesky factor of `limit` times the identity minus `share` (M, M) into `factor` (M, M).

    Returns False if this matrix is not positive definite.
    """
    size = len(sizes)
    for j in range(size):
        for k in range(size):
            factor[j, k] = (limit if j == k else 0.0) - share[j, k]
        if not factor[j, j] > 0.0:
            return False
    return factorize(factor, size, sizes, 0.0)
