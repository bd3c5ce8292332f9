"""Terms of a sum left out one after another where errors of the variables are in the terms, too.

Least squares takes products of errors with each other for products of terms, and is biased towards small coefficients
and towards terms whose errors are small. Without the mean of these products the estimate is consistent (Fuller 1987,
section 3.1).

Letters: K columns, W windows of L rows, N rows, V variables.
"""

import math

import numpy as np

from atoll_coordinator.model.sparse.kernels.elimination import invert_triangle, triangularize
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
def eliminate_corrected(
    columns: FloatArray, side: FloatArray, products: FloatArray, cross: FloatArray, order: Ints, squares: FloatArray,
    found: FloatArray, errors: FloatArray,
) -> None:  # fmt: skip
    """Do as `eliminate` where products of columns have the mean `products` (K, K) of errors, with the side `cross`.

    `errors` (K + 1,) takes what errors of columns add to the `squares`. Of columns that are mostly errors, as in a
    library that is too large, as much is allowed for as leaves something.
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
        worst, least = 0, math.inf
        for k in range(size):
            if triangle[k, k] == 0.0:
                worst, least = k, -1.0
        values = np.zeros(size)
        if least > 0.0:
            share, own, aside = np.empty((size, size)), np.empty(size), reached.copy()
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
            allowed = 1.0
            while not _is_below(share, _MOST_CORRECTED / allowed):
                allowed *= 0.5
            matrix = np.eye(size) - allowed * share
            for j in range(size):
                aside[j] += allowed * own[j]
            inverse = _inverted(matrix)
            for j in range(size):
                for k in range(size):
                    values[j] += inverse[j, k] * aside[k]
            for j in range(size):
                squares[step] += (reached[j] - values[j]) ** 2
                errors[step] += allowed * 2.0 * own[j] * values[j]
                for k in range(size):
                    errors[step] += allowed * values[j] * share[j, k] * values[k]
            half = np.zeros((size, size))  # T^-1
            invert_triangle(triangle, half)
            for k in range(size):
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
def _is_below(matrix: FloatArray, limit: float) -> bool:
    """Tell whether all eigenvalues of a symmetric matrix are below a limit: the rest has a Cholesky factor."""
    count = matrix.shape[0]
    factor = np.zeros((count, count))
    for i in range(count):
        for j in range(i + 1):
            total = (limit if i == j else 0.0) - matrix[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j and not total > 0.0:
                return False
            factor[i, j] = math.sqrt(total) if i == j else total / factor[j, j]
    return True


@allocating_kernel
def _inverted(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a positive matrix (M, M), which is overwritten, by Gauss and Jordan."""
    count = matrix.shape[0]
    inverse = np.eye(count)
    for p in range(count):
        pivot = matrix[p, p]
        for j in range(count):
            matrix[p, j] /= pivot
            inverse[p, j] /= pivot
        for i in range(count):
            if i != p:
                factor = matrix[i, p]
                for j in range(count):
                    matrix[i, j] -= factor * matrix[p, j]
                    inverse[i, j] -= factor * inverse[p, j]
    return inverse
