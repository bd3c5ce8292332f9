"""Sum up what a fit needs of sensitivities and residuals, and solve for its step, block by block.

Letters as in `kernels_integrate`: P fitted constants, D states, G segments, N rows, O measured states; L = D + K
numbers belong to one segment alone, its initial state and K offsets. The matrix of the normal equations has an arrow's
shape: the constants' block, and for each segment a block of its own numbers.
"""

import math

from atoll.compilation.jit import allocating_kernel, kernel
from atoll.data.dataset import FloatArray
from atoll.expression.kernels.tape import Ints
from atoll_coordinator.model.cholesky import factorize, substitute
from atoll_coordinator.model.shooting.kernels.innovations import decayed


@kernel
def normal_equations(segments: Ints, observed: Ints, steps: FloatArray, residuals: FloatArray, weights: FloatArray,
                     shares: FloatArray, decays: FloatArray, gradients: FloatArray, fitted: int, normal: FloatArray,
                     coupling: FloatArray, own: FloatArray, gradient: FloatArray, own_gradient: FloatArray,
                     innovations: FloatArray, expected: FloatArray) -> None:  # fmt: skip
    """Sum up J'WJ and J'Wr by blocks: constants (P, P), (G, P, L), and what each segment has its own (G, L, L).

    `residuals` and `weights` are (O, N) for the `observed` (O,) states; a weight of zero leaves a number out. W is the
    inverse of the covariance that `innovate` describes, with `shares` and `decays` (O,) of each state. `innovations`
    and `expected` (P + L,) are scratch.
    """
    local = gradients.shape[2] - fitted
    count = fitted + local
    for g in range(segments.shape[0]):
        for o in range(observed.shape[0]):
            s, share, white = observed[o], shares[o], 1.0 - shares[o]
            variance, guessed = share, 0.0
            for p in range(count):
                expected[p] = 0.0
            for row in range(segments[g, 0], segments[g, 1]):
                if share > 0.0 and row > segments[g, 0]:
                    kept = decayed(decays[o], steps[row])
                    variance = kept * kept * variance + share * (1.0 - kept * kept)
                    guessed *= kept
                    for p in range(count):
                        expected[p] *= kept
                if weights[o, row] == 0.0:
                    continue
                root = math.sqrt(weights[o, row])
                total = variance + white
                gain = variance / total
                error = root * residuals[o, row] - guessed
                guessed += gain * error
                for p in range(count):
                    change = root * gradients[row, s, p] - expected[p]
                    innovations[p] = change
                    expected[p] += gain * change
                variance -= gain * variance
                w = 1.0 / total
                for p in range(fitted):
                    wj = w * innovations[p]
                    gradient[p] += wj * error
                    for q in range(p + 1):
                        normal[p, q] += wj * innovations[q]
                    for d in range(local):
                        coupling[g, p, d] += wj * innovations[fitted + d]
                for d in range(local):
                    wj = w * innovations[fitted + d]
                    own_gradient[g, d] += wj * error
                    for e in range(local):
                        own[g, d, e] += wj * innovations[fitted + e]
    for p in range(fitted):
        for q in range(p):
            normal[q, p] = normal[p, q]


@allocating_kernel
def solve_step(normal: FloatArray, coupling: FloatArray, own: FloatArray, gradient: FloatArray,
               own_gradient: FloatArray, damping: float, change: FloatArray, moves: FloatArray) -> bool:  # fmt: skip
    """Write the step of the constants into `change` (P,) and of the segments' own numbers into `moves` (G, L).

    The segments' own numbers are eliminated first (Schur's complement). Returns False when the matrix is singular.
    """
    fitted, groups, local = gradient.shape[0], own.shape[0], own.shape[1]
    reduced, factors = normal.copy(), own.copy()
    scales = own[:, 0, :].copy()
    scale, column = gradient.copy(), own_gradient[0].copy()
    carried = coupling.copy()
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
        for p in range(fitted):
            for d in range(local):
                change[p] -= carried[g, p, d] * own_gradient[g, d]
                for q in range(p + 1):
                    reduced[p, q] -= carried[g, p, d] * coupling[g, q, d]
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
