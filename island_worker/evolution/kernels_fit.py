"""Fit the constants of one tape to rows: linear scaling in closed form, the rest by Levenberg and Marquardt.

The output of a program is a f + b (Keijzer 2003); a and b minimise the squared error for the f at hand and take part in
every step, which makes a step one of variable projection. Damping is Marquardt's (1963): a multiple of the diagonal of
the normal equations. Sums run over rows in order; nothing is allocated.
"""

import numpy as np

from common.expression.kernels import LANES, forward_block, lane_sum, reverse_block
from common.expression.operators import CONSTANT
from common.jit import inlined, kernel
from island_worker.evolution.structures import MOST_FITTED

INFINITY = np.inf
_FIRST_DAMPING = 1e-3
_STALLED = 1e-3
_EXACT = 1e-30


@kernel
def choose_fitted(tape, count, most, work):  # type: ignore[no-untyped-def]
    """List the first `most` constants of the tape in `work.fitted`, mark what depends on them; return their number."""
    fitted = 0
    for i in range(count):
        tape.depends[i] = False
        op = tape.code[i]
        if op == CONSTANT:
            if fitted < most and fitted < MOST_FITTED:
                work.fitted[fitted] = i
                fitted += 1
                tape.depends[i] = True
        elif op > CONSTANT:
            tape.depends[i] = tape.depends[tape.left[i]] or tape.depends[tape.right[i]]
    return fitted


@kernel
def sweep(tape, count, fitted, rows, work, side):  # type: ignore[no-untyped-def]
    """Write output and derivatives by the fitted constants at all rows to `side` (0 or 1) of the work arrays.

    Lanes beyond the last row repeat it in value but count nothing: their derivatives are set to zero by the sums.
    """
    output = work.output[side]
    for start in range(0, rows.count, LANES):
        forward_block(count, tape.code, tape.left, tape.right, tape.constants, rows.inputs, start, work.values)
        top = work.values[count - 1]
        for k in range(LANES):
            output[start + k] = top[k]
        if fitted == 0:
            continue
        reverse_block(count, tape.code, tape.left, tape.right, tape.depends, work.values, work.adjoints)
        for j in range(fitted):
            column = work.jacobian[side, j]
            adjoint = work.adjoints[work.fitted[j]]
            for k in range(LANES):
                column[start + k] = adjoint[k]


@kernel
def least_squares_scale(output, rows, scaling, scale, lanes):  # type: ignore[no-untyped-def]
    """Set `scale` to the a, b that minimise the squared error of a f + b, by centred sums; a = 0 for a constant f."""
    n = rows.count
    scale[0] = 1.0
    scale[1] = 0.0
    if scaling == 0:
        return
    mean_f = sum_of(output, n, lanes) / n
    mean_y = sum_of(rows.target, n, lanes) / n
    sum_ff = 0.0
    sum_fy = 0.0
    for start in range(0, n, LANES):
        for k in range(LANES):
            d = output[start + k] - mean_f if start + k < n else 0.0
            lanes[k] = d * d
        sum_ff += lane_sum(lanes)
        for k in range(LANES):
            d = (output[start + k] - mean_f) * (rows.target[start + k] - mean_y) if start + k < n else 0.0
            lanes[k] = d
        sum_fy += lane_sum(lanes)
    scale[0] = sum_fy / sum_ff if sum_ff > 1e-28 * mean_f * mean_f * n else 0.0
    scale[1] = mean_y - scale[0] * mean_f


@kernel
def sum_of(x, n, lanes):  # type: ignore[no-untyped-def]
    """Return the sum of x over rows [0, n), by lanes and then blocks."""
    total = 0.0
    for start in range(0, n, LANES):
        for k in range(LANES):
            lanes[k] = x[start + k] if start + k < n else 0.0
        total += lane_sum(lanes)
    return total


@kernel
def _mean_square(x, n, lanes):  # type: ignore[no-untyped-def]
    total = 0.0
    for start in range(0, n, LANES):
        for k in range(LANES):
            lanes[k] = x[start + k] * x[start + k] if start + k < n else 0.0
        total += lane_sum(lanes)
    return total / n


@kernel
def errors(output, rows, scale, lanes, result):  # type: ignore[no-untyped-def]
    """Set result[0] to the mean absolute and result[1] to the mean squared error of a f + b; inf when not finite."""
    n = rows.count
    a = scale[0]
    b = scale[1]
    total = 0.0
    square = 0.0
    target = rows.target
    for start in range(0, n, LANES):
        for k in range(LANES):
            lanes[k] = abs(a * output[start + k] + b - target[start + k])
        if start + LANES > n:
            for k in range(n - start, LANES):
                lanes[k] = 0.0
        total += lane_sum(lanes)
        for k in range(LANES):
            e = a * output[start + k] + b - target[start + k]
            lanes[k] = e * e
        if start + LANES > n:
            for k in range(n - start, LANES):
                lanes[k] = 0.0
        square += lane_sum(lanes)
    finite = np.isfinite(square) and np.isfinite(total)
    result[0] = total / n if finite else INFINITY
    result[1] = square / n if finite else INFINITY


@kernel
def _normal_equations(fitted, rows, scaling, scale, side, work):  # type: ignore[no-untyped-def]
    """Fill matrix and gradient for the columns (a df/dc, f, 1) and the residual a f + b - y; return their number.

    The block's columns stand in `work.values`, which no longer holds values then.
    """
    n = rows.count
    output = work.output[side]
    size = fitted + 2 * scaling
    for i in range(size):
        work.gradient[i] = 0.0
        for j in range(i + 1):
            work.matrix[i, j] = 0.0
    columns = work.values
    lanes = work.lanes
    for start in range(0, n, LANES):
        valid = min(LANES, n - start)
        for i in range(size):
            _column(i, fitted, work.jacobian[side], output, start, scale[0], valid, columns[i])
        residual = columns[size]
        for k in range(LANES):
            residual[k] = scale[0] * output[start + k] + scale[1] - rows.target[start + k]
        for i in range(size):
            one = columns[i]
            for k in range(LANES):
                lanes[k] = one[k] * residual[k]
            work.gradient[i] += lane_sum(lanes)
            for j in range(i + 1):
                other = columns[j]
                for k in range(LANES):
                    lanes[k] = one[k] * other[k]
                work.matrix[i, j] += lane_sum(lanes)
    return size


@inlined
def _column(i, fitted, jacobian, output, start, a, valid, out):  # type: ignore[no-untyped-def]
    """Write column i of the extended Jacobian for one block; zero beyond the valid lanes."""
    if i < fitted:
        for k in range(LANES):
            out[k] = a * jacobian[i, start + k]
    elif i == fitted:
        for k in range(LANES):
            out[k] = output[start + k]
    else:
        for k in range(LANES):
            out[k] = 1.0
    for k in range(valid, LANES):
        out[k] = 0.0


@kernel
def _solve(size, damping, work):  # type: ignore[no-untyped-def]
    """Solve (A + damping diag A) step = -gradient by Cholesky; return False when that is not possible."""
    for i in range(size):
        for j in range(i + 1):
            work.damped[i, j] = work.matrix[i, j]
        work.damped[i, i] = work.matrix[i, i] * (1.0 + damping) + 1e-300
    for i in range(size):
        for j in range(i + 1):
            s = work.damped[i, j]
            for k in range(j):
                s -= work.damped[i, k] * work.damped[j, k]
            if i == j:
                if not s > 1e-15 * work.matrix[i, i] or not np.isfinite(s):
                    return False
                work.damped[i, i] = np.sqrt(s)
            else:
                work.damped[i, j] = s / work.damped[j, j]
    for i in range(size):
        s = -work.gradient[i]
        for k in range(i):
            s -= work.damped[i, k] * work.step[k]
        work.step[i] = s / work.damped[i, i]
    for i in range(size - 1, -1, -1):
        s = work.step[i]
        for k in range(i + 1, size):
            s -= work.damped[k, i] * work.step[k]
        work.step[i] = s / work.damped[i, i]
        if not np.isfinite(work.step[i]):
            return False
    return True


@kernel
def _trial(tape, count, fitted, rows, scaling, work, side, scale, result):  # type: ignore[no-untyped-def]
    """Measure the tape as it stands, on `side`: sets scale and errors; one sweep."""
    sweep(tape, count, fitted, rows, work, side)
    least_squares_scale(work.output[side], rows, scaling, scale, work.lanes)
    errors(work.output[side], rows, scale, work.lanes, result)


@kernel
def fit(tape, count, most, rows, options, steps, work, scale, result):  # type: ignore[no-untyped-def]
    """Fit at most `most` constants of the tape in place, and the scale; set the errors; return point evaluations.

    Args:
        steps: Levenberg-Marquardt steps at most; ends earlier when exact or stalled.
        scale: (2,) out: a and b.  result: (2,) out: mean absolute and mean squared error on `rows`.
    """
    side = np.int64(0)  # a plain 0 would be a literal type, and everything below be compiled once more for it
    fitted = choose_fitted(tape, count, most, work) if steps > 0 else side
    _trial(tape, count, fitted, rows, options.scaling, work, side, scale, result)
    evaluations = (3 if fitted > 0 else 1) * rows.count
    if fitted == 0 or not np.isfinite(result[1]):
        return evaluations
    damping = _FIRST_DAMPING
    trial_scale = work.trial[0]
    trial_result = work.trial[1]
    _normal_equations(fitted, rows, options.scaling, scale, side, work)
    power = _mean_square(rows.target, rows.count, work.lanes)
    for _ in range(steps):
        if result[1] <= _EXACT * power:
            break
        if not _solve(fitted + 2 * options.scaling, damping, work):
            damping *= 10.0
            continue
        for j in range(fitted):
            work.kept[j] = tape.constants[work.fitted[j]]
            tape.constants[work.fitted[j]] += work.step[j]
        _trial(tape, count, fitted, rows, options.scaling, work, 1 - side, trial_scale, trial_result)
        evaluations += 3 * rows.count
        if trial_result[1] < result[1]:
            gain = 1.0 - trial_result[1] / result[1]
            side = 1 - side
            damping *= 0.1
            for j in range(2):
                scale[j] = trial_scale[j]
                result[j] = trial_result[j]
            if gain < _STALLED:
                break
            _normal_equations(fitted, rows, options.scaling, scale, side, work)
        else:
            damping *= 10.0
            for j in range(fitted):
                tape.constants[work.fitted[j]] = work.kept[j]
    return evaluations
