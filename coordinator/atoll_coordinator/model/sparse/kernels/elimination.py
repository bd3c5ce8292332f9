"""Compiled loops of sparse regression: sums over windows, least squares, elimination. All sums have a fixed order.

Measurement errors of the variables are also errors of the columns. Least squares then adds products of errors to the
products of columns, so that coefficients become too small and terms with small errors are preferred. If the mean of
these products of errors is subtracted, the estimate is consistent (Fuller 1987, section 3.1).

Letters: K columns, N rows (of tables or of sums), W windows of L rows, V variables.
"""

import math

import numpy as np

from atoll_coordinator.model.cholesky import factorize, substitute
from atoll_coordinator.model.description_length import log
from atoll_core.compilation.jit import allocating_kernel, inlined, kernel
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

DEPENDENT = 1e-9
"""A column of unit norm is a linear combination of earlier columns if the norm of its residual is not above this."""
_MOST_CORRECTED = 0.9
"""Numerical limit: at most this share of the squared norm of any linear combination of columns is subtracted as errors.
The variance of an estimate grows with the inverse of the remaining share."""
_BLOCK = 16
"""Number of columns whose sums are computed side by side; the sums of a block stay in the first cache."""

_log = inlined(log)


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
def triangularize(columns: FloatArray, upper: FloatArray) -> float:
    """Overwrite `columns` (K + 1, N), the last of which is the right side, by an orthonormal basis of the first K
    columns and by the residuals of the right side; return the sum of squared residuals.

    The method is modified Gram-Schmidt (Björck 1967). `upper` (K, K + 1) becomes the upper triangle, and in its last
    column the components of the right side in the basis. A column that depends on earlier columns gets a row of zeros.
    Four scalar products are computed side by side, each of them in the order of the rows.
    """
    last, rows = columns.shape[0] - 1, columns.shape[1]
    for k in range(last):
        norm = 0.0
        for i in range(rows):
            norm += columns[k, i] * columns[k, i]
        norm = math.sqrt(norm)
        for j in range(k, last + 1):
            upper[k, j] = 0.0
        if not norm > DEPENDENT:
            continue
        upper[k, k] = norm
        for i in range(rows):
            columns[k, i] /= norm
        for j in range(k + 1, last + 1, 4):
            second, third, fourth = min(j + 1, last), min(j + 2, last), min(j + 3, last)
            a, b, c, d = 0.0, 0.0, 0.0, 0.0
            for i in range(rows):
                a += columns[k, i] * columns[j, i]
                b += columns[k, i] * columns[second, i]
                c += columns[k, i] * columns[third, i]
                d += columns[k, i] * columns[fourth, i]
            upper[k, j], upper[k, second], upper[k, third], upper[k, fourth] = a, b, c, d
        for j in range(k + 1, last + 1):
            for i in range(rows):
                columns[j, i] -= upper[k, j] * columns[k, i]
    left = 0.0
    for i in range(rows):
        left += columns[last, i] * columns[last, i]
    return left


@allocating_kernel
def explained_shares(
    factors: FloatArray, functions: FloatArray, first: Ints, weights: FloatArray, squares: FloatArray,
    vectors: FloatArray, counts: Ints, least_part: float, shares: FloatArray,
) -> None:  # fmt: skip
    """Write the share of squared residuals that each product of a factor and a function explains, as one more term of
    each of several sums.

    Columns are sums over windows, see `windowed_sums`, of the values of `factors` (P, R) times `functions` (C, R). The
    share is 0 if a value is not finite, or if the squared part of a column that is orthogonal to the terms is at most
    `least_part` of its square.

    Args:
        first: first row (W,) of each window.
        weights: weights (W, L) of the rows of a window.
        squares: for each sum, weights (S, W) of squared columns.
        vectors: for each sum, one after another, the residuals divided by their length and an orthonormal basis of the
            terms (W,); all are multiplied by the square roots of `squares`.
        counts: number (S,) of vectors of each sum.
        shares: result, (S, P, C).
    """
    values, column, dots = np.empty(factors.shape[1]), np.empty(len(first)), np.empty(len(vectors))
    for p in range(len(factors)):
        for c in range(len(functions)):
            shares[:, p, c] = 0.0
            is_finite = True
            for row in range(len(values)):
                values[row] = factors[p, row] * functions[c, row]
                is_finite &= abs(values[row]) < math.inf
            if not is_finite:
                continue
            for w in range(len(first)):
                total = 0.0
                for j in range(weights.shape[1]):
                    total += weights[w, j] * values[first[w] + j]
                column[w] = total
            scalar_products(column, vectors, dots)
            begin = 0
            for s in range(len(counts)):
                square = 0.0
                for w in range(len(first)):
                    square += column[w] * column[w] * squares[s, w]
                orthogonal = square
                for k in range(begin + 1, begin + counts[s]):
                    orthogonal -= dots[k] * dots[k]
                if orthogonal > least_part * square:
                    shares[s, p, c] = dots[begin] * dots[begin] / orthogonal
                begin += counts[s]


@kernel
def scalar_products(column: FloatArray, vectors: FloatArray, dots: FloatArray) -> None:
    """Write the scalar products of `column` (N,) with each of `vectors` (M, N) into `dots` (M,), four side by side."""
    last = len(vectors) - 1
    for k in range(0, last + 1, 4):
        second, third, fourth = min(k + 1, last), min(k + 2, last), min(k + 3, last)
        a, b, c, d = 0.0, 0.0, 0.0, 0.0
        for i in range(len(column)):
            a += column[i] * vectors[k, i]
            b += column[i] * vectors[second, i]
            c += column[i] * vectors[third, i]
            d += column[i] * vectors[fourth, i]
        dots[k], dots[second], dots[third], dots[fourth] = a, b, c, d


@kernel
def sum_products(rows: FloatArray, weights: FloatArray, sums: FloatArray) -> None:
    """Write the weighted sums over `rows` (N, V) of the products of columns i and j into `sums` (V, V) for i <= j, 0
    for i > j.

    The sums with all columns j are computed side by side, each of them in the order of the rows.
    """
    for i in range(rows.shape[1]):
        sums[i, :i] = 0.0
        totals = sums[i, i:]
        totals[:] = 0.0
        for n in range(rows.shape[0]):
            others = rows[n, i:]
            factor = weights[n] * others[0]
            for j in range(len(totals)):
                totals[j] += factor * others[j]


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
def spread_window_weights(
    first: Ints, bump: FloatArray, slope: FloatArray, weights: FloatArray, squares: FloatArray, halves: FloatArray
) -> None:
    """Add the weights of windows to their rows: `weights` (W,) times the squared test function to `squares` (R,), and
    times test function and slope to `halves` (R,).

    Window w starts at row first[w] of `first` (W,); `bump` and `slope` (W, L) are the test functions and their slopes.
    """
    for j in range(bump.shape[1]):
        for w in range(first.shape[0]):
            part = weights[w] * bump[w, j]
            squares[first[w] + j] += part * bump[w, j]
            halves[first[w] + j] += part * slope[w, j]


@allocating_kernel
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

    Most columns depend on few variables. So for each variable only the columns that depend on it are summed. The sums
    of many pairs are computed side by side, each of them in the order of the rows.
    """
    count, rows = gradients.shape[0], gradients.shape[2]
    products[:] = 0.0
    cross[:] = 0.0
    used = np.empty(count, np.int64)
    for v in range(gradients.shape[1]):
        size = 0
        for k in range(count):
            for row in range(rows):
                if gradients[k, v, row] != 0.0:
                    used[size] = k
                    size += 1
                    break
        if size == 0 or not (variances[v] > 0.0 or v == target):
            continue
        block, sums, along = np.empty((rows, size)), np.zeros((size, size)), np.zeros(size)
        for j in range(size):
            for row in range(rows):
                block[row, j] = gradients[used[j], v, row]
        if v == target:
            for row in range(rows):
                for j in range(size):
                    along[j] += halves[row] * block[row, j]
            for j in range(size):
                cross[used[j]] = along[j] * variances[target]
        if not variances[v] > 0.0:
            continue
        for begin in range(0, size, _BLOCK):
            for row in range(rows):
                for j in range(begin, min(begin + _BLOCK, size)):
                    weighted = squares[row] * block[row, j]
                    for m in range(j + 1):
                        sums[j, m] += weighted * block[row, m]
        for j in range(size):
            for m in range(j + 1):
                products[used[j], used[m]] += sums[j, m] * variances[v]
                products[used[m], used[j]] = products[used[j], used[m]]


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
    unit, scale = np.empty((len(columns) + 1, len(side))), np.ones(len(columns))
    unit[: len(columns)] = columns
    unit[len(columns)] = side
    _normalize(unit, scale)
    _eliminate_normalized(unit, scale, products, cross, steps, order, squares, found, errors)
    total = 0.0
    for i in range(len(side)):
        total += side[i] * side[i]
    squares[len(columns)] = total


@kernel
def _normalize(columns: FloatArray, scale: FloatArray) -> None:
    """Divide each of the columns but the last, `columns` (K + 1, N), by its norm; write the norms into `scale` (K,), 1
    for a column of zeros."""
    for k in range(len(scale)):
        norm = 0.0
        for i in range(columns.shape[1]):
            norm += columns[k, i] * columns[k, i]
        scale[k] = math.sqrt(norm) if norm > 0.0 else 1.0
        for i in range(columns.shape[1]):
            columns[k, i] /= scale[k]


@allocating_kernel
def _eliminate_normalized(
    unit: FloatArray, scale: FloatArray, products: FloatArray, cross: FloatArray, steps: int, order: Ints,
    squares: FloatArray, found: FloatArray, errors: FloatArray,
) -> None:  # fmt: skip
    """Do the work of `eliminate`, except for the last number of `squares`, with the columns `unit` (K + 1, N), the last
    of which is the side. The others are divided by their norms `scale` (K,). `unit` is overwritten."""
    count = len(scale)
    upper = np.zeros((count, count + 1))
    base = triangularize(unit, upper)
    kept = np.arange(count)
    for step in range(steps):
        size = count - step
        part, triangle = np.zeros((size + 1, count)), np.zeros((size, size + 1))
        part[size] = upper[:, count]
        for j in range(size):
            for i in range(kept[j] + 1):
                part[j, i] = upper[i, kept[j]]
        squares[step] = base + triangularize(part, triangle)
        half, inverse, values = np.zeros((size, size)), np.eye(size), triangle[:, size].copy()
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
                squares[step] += (triangle[j, size] - values[j]) ** 2
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


@allocating_kernel
def find_shortest_with_each(
    columns: FloatArray, side: FloatArray, products: FloatArray, cross: FloatArray, kept: Ints, candidates: Ints,
    prices: FloatArray, numbers: float, least: float, nats: FloatArray,
) -> None:  # fmt: skip
    """Find, for each candidate, the length of the shortest sum in the elimination of the columns `kept` (M,) and the
    candidate.

    The length of a sum is ``numbers``/2 ln(sum of squared residuals, at least `least`) plus the `prices` (K,) of its
    columns. Write the smallest length of each candidate into `nats` (C,). `eliminate` describes `columns` (K, N),
    `side` (N,), `products` (K, K) and `cross` (K,); `kept` and `candidates` (C,) are numbers of columns, ascending.
    """
    size = len(kept) + 1
    whole, scale = np.empty((len(columns) + 1, len(side))), np.ones(len(columns))
    whole[: len(columns)] = columns
    whole[len(columns)] = side
    _normalize(whole, scale)
    unit, own, places = np.empty((size + 1, len(side))), np.empty(size), np.empty(size, np.int64)
    known = size if len(cross) else 0
    part, along = np.empty((known, known)), np.empty(known)
    order, squares, errors = np.empty(size, np.int64), np.empty(size + 1), np.empty(size + 1)
    found = np.empty((size, size))
    for number in range(len(candidates)):
        position = 0
        while position < len(kept) and kept[position] < candidates[number]:
            position += 1
        for k in range(size):
            places[k] = kept[k] if k < position else candidates[number] if k == position else kept[k - 1]
        for j in range(size):
            unit[j], own[j] = whole[places[j]], scale[places[j]]
            if len(cross):
                along[j] = cross[places[j]]
                for k in range(size):
                    part[j, k] = products[places[j], places[k]]
        unit[size] = side
        squares[:], errors[:], found[:] = 0.0, 0.0, 0.0
        _eliminate_normalized(unit, own, part, along, size, order, squares, found, errors)
        nats[number], price = math.inf, 0.0
        for step in range(size - 1, -1, -1):
            price += prices[places[order[step]]]
            square = max(squares[step] - errors[step] + errors[0], squares[0], least)
            length = 0.5 * numbers * _log(square) + price
            nats[number] = min(nats[number], length)


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
