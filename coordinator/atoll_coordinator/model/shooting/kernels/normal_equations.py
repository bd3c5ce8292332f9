"""The normal equations of a trajectory fit, summed up from sensitivities and residuals, and their solution by blocks.

Letters as in `kernels.integrate`: P fitted constants, D states, G segments, N rows, O measured states. Each segment has
L = D + K parameters of its own: its initial state and K offsets. The matrix of the normal equations has the shape of an
arrow: a block of the constants, one block for the own parameters of each segment, and the products between constants
and own parameters. Blocks of different segments do not interact.
"""

import math

import numpy as np

from atoll_coordinator.model.cholesky import factorize, substitute
from atoll_coordinator.model.shooting.kernels.innovations import decayed
from atoll_core.compilation.jit import allocating_kernel, inlined, kernel
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

LINES = 8
"""Number of rows of sensitivities whose products are added at once."""


@kernel
def normal_equations(segments: Ints, observed: Ints, steps: FloatArray, residuals: FloatArray, weights: FloatArray,
                     shares: FloatArray, decays: FloatArray, gradients: FloatArray, fitted: int, normal: FloatArray,
                     coupling: FloatArray, own: FloatArray, gradient: FloatArray, own_gradient: FloatArray,
                     lines: FloatArray, expected: FloatArray, sums: FloatArray) -> None:  # fmt: skip
    """Sum up J'WJ and J'Wr by blocks, from sensitivities J, `gradients` (N, D, P + L), and residuals r.

    `residuals` and `weights` are (O, N) for the `observed` (O,) states; residuals of weight 0 are left out. W is the
    inverse of the covariance of the errors in `innovations`, with `shares` and `decays` (O,) for each state; `steps`
    (N,) are as there.

    Results: J'WJ has the blocks `normal` (P, P) of constants, `coupling` (G, P, L) of constants and own parameters, and
    `own` (G, L, L) of own parameters. J'Wr has the blocks `gradient` (P,) and `own_gradient` (G, L). The sums are added
    to the present values of `normal` and `gradient`; the other blocks are overwritten. Scratch, with C = P + L + 1:
    `lines` (`LINES`, C), whitened sensitivities and the residual; `expected` (C,), their predictions by the filter;
    `sums` (C, C), the sums of their products.
    """
    local = gradients.shape[2] - fitted
    count = fitted + local
    for g in range(segments.shape[0]):
        filled = 0
        for p in range(count + 1):
            for q in range(p + 1):
                sums[p, q] = 0.0
        for o in range(observed.shape[0]):
            s, share, white = observed[o], shares[o], 1.0 - shares[o]
            variance = share
            for p in range(count + 1):
                expected[p] = 0.0
            for row in range(segments[g, 0], segments[g, 1]):
                if share > 0.0 and row > segments[g, 0]:
                    kept = decayed(decays[o], steps[row])
                    variance = kept * kept * variance + share * (1.0 - kept * kept)
                    for p in range(count + 1):
                        expected[p] *= kept
                if weights[o, row] == 0.0:
                    continue
                root = math.sqrt(weights[o, row])
                total = variance + white
                gain, scale = variance / total, math.sqrt(1.0 / total)
                line = lines[filled]
                for p in range(count):
                    line[p] = root * gradients[row, s, p] - expected[p]
                line[count] = root * residuals[o, row] - expected[count]
                for p in range(count + 1):
                    expected[p] += gain * line[p]
                    line[p] *= scale
                variance -= gain * variance
                filled += 1
                if filled == LINES:
                    add_products(lines, sums)
                    filled = 0
        for empty in range(filled, LINES if filled else 0):
            for p in range(count + 1):
                lines[empty, p] = 0.0
        if filled:
            add_products(lines, sums)
        for p in range(fitted):
            gradient[p] += sums[count, p]
            for q in range(p + 1):
                normal[p, q] += sums[p, q]
        for d in range(local):
            own_gradient[g, d] = sums[count, fitted + d]
            for p in range(fitted):
                coupling[g, p, d] = sums[fitted + d, p]
            for e in range(d + 1):
                own[g, d, e] = own[g, e, d] = sums[fitted + d, fitted + e]
    for p in range(fitted):
        for q in range(p):
            normal[q, p] = normal[p, q]


@inlined
def add_products(lines: FloatArray, sums: FloatArray) -> None:
    """Add the products of columns of `lines` (`LINES`, C) to the lower triangle of `sums` (C, C).

    Several lines are added at once, because with many columns loading and storing the sums takes longer than the
    multiplications.
    """
    for p in range(sums.shape[0]):
        a, b, c, d = lines[0, p], lines[1, p], lines[2, p], lines[3, p]
        e, f, g, h = lines[4, p], lines[5, p], lines[6, p], lines[7, p]
        for q in range(p + 1):
            first = a * lines[0, q] + b * lines[1, q] + c * lines[2, q] + d * lines[3, q]
            second = e * lines[4, q] + f * lines[5, q] + g * lines[6, q] + h * lines[7, q]
            sums[p, q] += first + second


@allocating_kernel
def solve_step(normal: FloatArray, coupling: FloatArray, own: FloatArray, gradient: FloatArray,
               own_gradient: FloatArray, damping: float, change: FloatArray, moves: FloatArray) -> bool:  # fmt: skip
    """Write the step of the constants into `change` (P,) and the step of the own parameters into `moves` (G, L).

    Blocks as in `normal_equations`; `damping` is Marquardt's factor. The own parameters of the segments are eliminated
    first (Schur complement). Returns False if the matrix is singular.
    """
    fitted, groups, local = gradient.shape[0], own.shape[0], own.shape[1]
    reduced, factors = normal.copy(), own.copy()
    scales = own[:, 0, :].copy()
    scale, column = gradient.copy(), own_gradient[0].copy()
    carried, turned = coupling.copy(), np.empty((local, fitted))
    for p in range(fitted):
        reduced[p, p] *= 1.0 + damping
        change[p] = gradient[p]
    for g in range(groups):
        if not factorize(factors[g], local, scales[g], damping):
            return False
        for p in range(fitted):
            for d in range(local):
                column[d] = coupling[g, p, d]
            substitute(factors[g], local, scales[g], column)
            for d in range(local):
                carried[g, p, d] = column[d]
        for q in range(fitted):
            for d in range(local):
                turned[d, q] = coupling[g, q, d]
        for p in range(fitted):
            for d in range(local):
                factor = carried[g, p, d]
                change[p] -= factor * own_gradient[g, d]
                for q in range(p + 1):
                    reduced[p, q] -= factor * turned[d, q]
    if not factorize(reduced, fitted, scale, 0.0):
        return False
    substitute(reduced, fitted, scale, change)
    for g in range(groups):
        for d in range(local):
            column[d] = own_gradient[g, d]
            for p in range(fitted):
                column[d] -= coupling[g, p, d] * change[p]
        substitute(factors[g], local, scales[g], column)
        for d in range(local):
            moves[g, d] = column[d]
    return True
