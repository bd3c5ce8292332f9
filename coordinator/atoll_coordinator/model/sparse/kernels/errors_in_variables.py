"""Least squares where the columns have errors, too, in a fixed order of sums.

What a sum of columns leaves of a side has a variance that is quadratic in the coefficients, since errors of the
variables are in both. The sum of squares over that variance is least near the truth, where least squares is biased
towards small coefficients (Fuller 1987).

Letters: K columns, W windows of L rows, N rows, V variables, M terms of a sum.
"""

import math

import numpy as np

from atoll_coordinator.model.sparse.kernels.robust import CAUCHY
from atoll_core.compilation.jit import allocating_kernel, kernel
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints


@kernel
def error_products(
    first: Ints, bump: FloatArray, slope: FloatArray, gradients: FloatArray, noise: FloatArray, target: int,
    products: FloatArray, cross: FloatArray,
) -> None:  # fmt: skip
    """Write the covariances of the errors of columns with each other and with those of the side.

    `first` (W,) are the first rows of windows, `bump` and `slope` (W, L) their test functions, `gradients` (K, V, N)
    derivatives of the columns' functions by the variables, whose errors have the deviations `noise` (V,). The side is
    minus the sum of `slope` times the variable `target`. `products` (W, K, K) and `cross` (W, K) take the result.
    """
    count, variables = gradients.shape[:2]
    for w in range(first.shape[0]):
        for k in range(count):
            own = 0.0
            for j in range(bump.shape[1]):
                own += bump[w, j] * slope[w, j] * gradients[k, target, first[w] + j]
            cross[w, k] = own * noise[target] * noise[target]
            for m in range(k + 1):
                total = 0.0
                for v in range(variables):
                    if noise[v] > 0.0:
                        part = 0.0
                        for j in range(bump.shape[1]):
                            row = first[w] + j
                            part += bump[w, j] * bump[w, j] * gradients[k, v, row] * gradients[m, v, row]
                        total += part * noise[v] * noise[v]
                products[w, k, m] = total
                products[w, m, k] = total


@allocating_kernel
def measure(
    kept: Ints, columns: FloatArray, side: FloatArray, products: FloatArray, cross: FloatArray, least: FloatArray,
    typical: float, coefficients: FloatArray, scaled: FloatArray, normal: FloatArray, gradient: FloatArray,
) -> float:  # fmt: skip
    """Write what the sum leaves, in standard errors, `scaled` (W,); return its mean loss.

    That is the loss of Cauchy's distribution, and 1/2 ln(1 + v/s^2) for errors of variance v where the sides have the
    typical square s^2: a sum whose errors are as large as the sides tells nothing, though it leaves no more than these.

    Args:
        kept: columns of the sum (M,).
        columns: (K, W).
        side: (W,).
        products: (W, K, K).
        cross: (W, K).
        least: variances (W,) of what is left without errors of columns.
        typical: s^2.
        coefficients: (M,).
        scaled: takes what is left.
        normal: takes the matrix of the normal equations (M, M).
        gradient: takes their right side (M,): minus the gradient of the sum of losses.
    """
    count, windows = len(kept), len(side)
    slopes, moved = np.empty(count), np.empty(count)
    loss = 0.0
    normal[:] = 0.0
    gradient[:] = 0.0
    for w in range(windows):
        left, variance = side[w], least[w]
        for a in range(count):
            total = 0.0
            for b in range(count):
                total += products[w, kept[a], kept[b]] * coefficients[b]
            moved[a] = total + cross[w, kept[a]]
            left -= coefficients[a] * columns[kept[a], w]
            variance += coefficients[a] * (moved[a] + cross[w, kept[a]])
        deviation = math.sqrt(variance) if variance > 0.0 else math.inf
        share = left / deviation
        scaled[w] = share
        far = share / CAUCHY
        loss += 0.5 * CAUCHY * CAUCHY * math.log1p(far * far) + 0.5 * math.log1p((variance - least[w]) / typical)
        weight, pull = 1.0 / (1.0 + far * far), 1.0 / max(typical + variance - least[w], 1e-300)
        for a in range(count):
            slopes[a] = (columns[kept[a], w] + share / deviation * moved[a]) / deviation
            gradient[a] += weight * slopes[a] * share - pull * moved[a]
            for b in range(a + 1):
                normal[a, b] += weight * slopes[a] * slopes[b] + pull * products[w, kept[a], kept[b]]
    for a in range(count):
        for b in range(a):
            normal[b, a] = normal[a, b]
    return loss / windows
