"""The normal equations of segments that begin where the one before ends: Bock's multiple shooting, condensed.

Letters as in `normal_equations`: P fitted constants, D states, G segments, which are those of B pieces; Q = P + D + 1.
"""

import numpy as np

from atoll_core.compilation.jit import allocating_kernel
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints


@allocating_kernel
def condense(
    coupling: FloatArray, own: FloatArray, own_gradient: FloatArray, ends: FloatArray, gaps: FloatArray, pieces: Ints,
    normal: FloatArray, gradient: FloatArray, sums: FloatArray, moves: FloatArray,
) -> None:  # fmt: skip
    """Write how segments move with the constants and their piece's initial state, and add up the cost of that.

    The move of a segment's initial state is linear in those: S A, S B + T and S c + h follow from A, B and c of the
    segment before, with the sensitivities S and T of its end to its initial state and to the constants, and with the
    gap h there (Bock 1983, section 3; Albersmeyer & Diehl 2010, SIAM Journal on Optimization 20:1655).

    Args:
        coupling: block (G, P, D) of the constants and each segment's initial state, see `normal_equations`.
        own: block (G, D, D) of the latter.
        own_gradient: right side (G, D) of the latter.
        ends: T and S (G, D, P + D).
        gaps: h, by how much the end is beyond the initial state of the next segment (G, D).
        pieces: of which each segment is a part (G,), ascending.
        normal: block (P, P) of the constants, to which the rest is added.
        gradient: its right side (P,), to which the rest is added.
        sums: takes the products (B, Q, Q) of which the blocks of each piece are parts, zero before.
        moves: takes B, A and c (G, D, Q), zero before.
    """
    groups, fitted, states = coupling.shape
    count = fitted + states
    costs = np.zeros((states, count + 1))
    for g in range(groups):
        move, total = moves[g], sums[pieces[g]]
        for d in range(states):
            if g == 0 or pieces[g] != pieces[g - 1]:
                move[d, fitted + d] = 1.0
                continue
            for q in range(fitted):
                move[d, q] = ends[g - 1, d, q]
            move[d, count] = gaps[g - 1, d]
            for e in range(states):
                for q in range(count + 1):
                    move[d, q] += ends[g - 1, d, fitted + e] * moves[g - 1, e, q]
        for d in range(states):
            for q in range(count + 1):
                costs[d, q] = 0.0
            for e in range(states):
                for q in range(count + 1):
                    costs[d, q] += own[g, d, e] * move[e, q]
            costs[d, count] -= own_gradient[g, d]
        for d in range(states):
            for p in range(count):
                for q in range(count + 1):
                    total[p, q] += move[d, p] * costs[d, q]
            for p in range(fitted):
                for q in range(count + 1):
                    total[p, q] += coupling[g, p, d] * move[d, q]
                for q in range(fitted):
                    normal[p, q] += coupling[g, q, d] * move[d, p]
    for b in range(sums.shape[0]):
        for p in range(fitted):
            gradient[p] -= sums[b, p, count]
            for q in range(fitted):
                normal[p, q] += sums[b, p, q]
