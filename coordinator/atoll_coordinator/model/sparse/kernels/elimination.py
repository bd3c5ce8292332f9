"""Terms of a sum left out one after another, also where errors of the variables are in the terms, too.

Least squares then takes products of errors with each other for products of terms, and is biased towards small
coefficients and towards terms whose errors are small. Without the mean of these products the estimate is consistent
(Fuller 1987, section 3.1).

Letters: K columns, W windows of L rows, N rows, V variables.
"""

import math

import numpy as np

from atoll_coordinator.model.cholesky import factorize, substitute
from atoll_coordinator.model.sparse.kernels.least_squares import invert_triangle, triangularize
from atoll_core.compilation.jit import allocating_kernel, kernel
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

_MOST_CORRECTED = 0.9
"""Numerics: the share of the square of any sum of columns, at most, that is taken for errors. What is left grows with
the inverse of the rest, so that beyond, an estimate is chance."""


@kernel
def sum_error_products(
    gradients: FloatArray, variances: FloatArray, target: int, squares: FloatArray, halves: FloatArray,
    products: FloatArray, cross: FloatArray,
) -> None:  # fmt: skip
    """Write the sums over windows of the covariances of the errors of columns with each other and with the side's.

    `gradients` (K, V, N) are derivatives of the columns' functions by the variables, whose errors have these
    `variances` (V,); `squares` and `halves` (N,) are how much the square of a row's error counts where both factors are
    weighted by the test function, and where one is by its slope. `products` (K, K) and `cross` (K,) take the result.
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
    columns: FloatArray, side: FloatArray, products: FloatArray, cross: FloatArray, order: Ints, squares: FloatArray,
    found: FloatArray, errors: FloatArray,
) -> None:  # fmt: skip
    """Fit `side` (N,) by all `columns` (K, N), then leave out the one whose loss costs least, and so on.

    Products of columns have the mean `products` (K, K) of errors, with the side `cross` (K,); without any, these have
    no elements. Of columns that are mostly errors, as in a library that is too large, as much is allowed for as leaves
    something.

    `order` (K,) takes the columns in the order in which they go; `squares` (K + 1,) the sums of squares left with the
    last K, K - 1, ... 0 of that order, `errors` (K + 1,) what errors of columns add to these; `found` (K, K) the
    coefficients of all columns at each step, 0 for those gone.
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
    for step in range(count):
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
            for j in range(size):  # the errors in the basis of the triangle: T'^-1 P T^-1 and T'^-1 c
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
    total = 0.0
    for i in range(rows):
        total += side[i] * side[i]
    squares[count] = total


@allocating_kernel
def _factorize_rest(share: FloatArray, limit: float, factor: FloatArray, sizes: FloatArray) -> bool:
    """Write Cholesky's factor of what a symmetric matrix leaves of `limit` times the identity; tell whether it has one.

    It has where all eigenvalues of `share` are below the limit.
    """
    size = len(sizes)
    for j in range(size):
        for k in range(size):
            factor[j, k] = (limit if j == k else 0.0) - share[j, k]
        if not factor[j, j] > 0.0:
            return False
    return factorize(factor, size, sizes, 0.0)
