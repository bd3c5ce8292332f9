"""Fit a program to rows: its top-level terms in closed form, the constants inside them by Levenberg and Marquardt.

An individual's output is b + a_1 t_1 + ... + a_m t_m, where the t_j are the terms that its list adds and subtracts at
the top. With one term this is linear scaling (Keijzer 2003). The a_j and b minimise the squared error for the terms at
hand and take part in every step, which makes a step one of variable projection (Golub & Pereyra 1973). Damping is
Marquardt's (1963): a multiple of the diagonal of the normal equations. Sums run over rows in order; nothing is
allocated.
"""

from typing import Final

import numpy as np

from common.expression.kernels import LANES, forward, lane_sum, reverse_block
from common.expression.operators import ADD, CONSTANT, DIVIDE, MULTIPLY, NEGATE, SUBTRACT, VARIABLE
from common.jit import inlined, kernel
from island_worker.evolution.kernels_tape import ARITY_OF
from island_worker.evolution.kernels_variation import reset_scale
from island_worker.evolution.structures import MOST_FITTED, Fit, Floats, Ints, Rows, Tape, Work

INFINITY: Final = np.inf
_FIRST_DAMPING: Final = 1e-3
_STALLED: Final = 1e-3
_EXACT: Final = 1e-30
_COLLINEAR: Final = 1e-10


@inlined
def _add_term(terms: Ints, number: int, node: int, code: Ints) -> int:
    """Append `node` unless it is there already or a constant, which b stands for; return the number of terms."""
    if code[node] == CONSTANT:
        return number
    for j in range(number):
        if terms[j] == node:
            return number
    terms[number] = node
    return number + 1


@kernel
def collect_terms(tape: Tape, count: int, most: int, terms: Ints) -> int:
    """List in `terms` the tape indices of at most `most` terms; return their number, 0 for a constant program.

    From the output down, a sum or difference gives way to its arguments, and a negation or a product with a constant
    to the other argument, as long as there is room. `most` 0: the output itself, unscaled.
    """
    terms[0] = count - 1
    if most == 0:
        return 1
    number = 0
    number = _add_term(terms, number, count - 1, tape.code)
    j = 0
    while j < number:
        node = terms[j]
        op = tape.code[node]
        left = tape.left[node]
        right = tape.right[node]
        product = (op == MULTIPLY and (tape.code[left] == CONSTANT or tape.code[right] == CONSTANT)) or (
            op == DIVIDE and tape.code[right] == CONSTANT
        )
        if op == NEGATE or product or (op in (ADD, SUBTRACT) and number < most):
            for k in range(j, number - 1):
                terms[k] = terms[k + 1]
            number -= 1
            number = _add_term(terms, number, left, tape.code)
            if ARITY_OF[op] > 1:
                number = _add_term(terms, number, right, tape.code)
            j = 0
        else:
            j += 1
    return number


@kernel
def choose_fitted(tape: Tape, count: int, number: int, most: int, work: Work) -> int:
    """List the first `most` constants inside the terms in `work.fitted`; mark what depends on them; return how many."""
    feeds = work.feeds
    for i in range(count):
        feeds[i] = False
    for j in range(number):
        feeds[work.terms[j]] = True
    for i in range(count - 1, -1, -1):
        if feeds[i]:
            arity = ARITY_OF[tape.code[i]]
            if arity > 0:
                feeds[tape.left[i]] = True
            if arity > 1:
                feeds[tape.right[i]] = True
    fitted = 0
    for i in range(count):
        op = tape.code[i]
        tape.depends[i] = False
        if op == CONSTANT:
            if feeds[i] and fitted < most and fitted < MOST_FITTED:
                work.fitted[fitted] = i
                fitted += 1
                tape.depends[i] = True
        elif op != VARIABLE and feeds[i]:
            tape.depends[i] = tape.depends[tape.left[i]] or tape.depends[tape.right[i]]
    return fitted


@kernel
def combine_into(output: Floats, values: Floats, terms: Ints, number: int, scale: Floats, rows: int) -> None:
    """Write b + a_1 t_1 + ... into `output`; `scale` is (b, a_1, ...)."""
    for start in range(0, rows, LANES):
        for k in range(LANES):
            output[start + k] = scale[0]
        for j in range(number):
            a = scale[1 + j]
            term = values[terms[j]]
            for k in range(LANES):
                output[start + k] += a * term[start + k]


@kernel
def sum_of(x: Floats, n: int, lanes: Floats) -> float:
    """Return the sum of x over rows [0, n), by lanes and then blocks."""
    total = 0.0
    for start in range(0, n, LANES):
        for k in range(LANES):
            lanes[k] = x[start + k] if start + k < n else 0.0
        total += lane_sum(lanes)
    return total


@kernel
def _product_about(x: Floats, x0: float, y: Floats, y0: float, n: int, lanes: Floats) -> float:
    """Return the sum of (x - x0) (y - y0) over rows [0, n)."""
    total = 0.0
    for start in range(0, n, LANES):
        for k in range(LANES):
            lanes[k] = (x[start + k] - x0) * (y[start + k] - y0) if start + k < n else 0.0
        total += lane_sum(lanes)
    return total


@kernel
def fit_terms(number: int, rows: Rows, work: Work, scale: Floats) -> None:
    """Set `scale` to the b, a_1, ... that minimise the squared error, by centred normal equations and Cholesky.

    A term that is constant, or a combination of earlier ones, gets 0.
    """
    n = rows.length
    lanes = work.lanes
    matrix = work.matrix
    mean_y = sum_of(rows.target, n, lanes) / n
    for i in range(number):
        term = work.values[work.terms[i]]
        mean = sum_of(term, n, lanes) / n
        work.means[i] = mean
        work.gradient[i] = _product_about(term, mean, rows.target, mean_y, n, lanes)
        for j in range(i + 1):
            matrix[i, j] = _product_about(term, mean, work.values[work.terms[j]], work.means[j], n, lanes)
    for i in range(number):
        power = matrix[i, i]
        for j in range(i + 1):
            s = matrix[i, j]
            for k in range(j):
                s -= matrix[i, k] * matrix[j, k]
            if j < i:
                matrix[i, j] = s / matrix[j, j] if matrix[j, j] > 0.0 else 0.0
            else:
                usable = s > _COLLINEAR * power and power > 1e-28 * work.means[i] * work.means[i] * n
                matrix[i, i] = np.sqrt(s) if usable else 0.0
    for i in range(number):
        s = work.gradient[i]
        for k in range(i):
            s -= matrix[i, k] * scale[1 + k]
        scale[1 + i] = s / matrix[i, i] if matrix[i, i] > 0.0 else 0.0
    for i in range(number - 1, -1, -1):
        s = scale[1 + i]
        for k in range(i + 1, number):
            s -= matrix[k, i] * scale[1 + k]
        scale[1 + i] = s / matrix[i, i] if matrix[i, i] > 0.0 else 0.0
    scale[0] = mean_y
    for i in range(number):
        scale[0] -= scale[1 + i] * work.means[i]


@kernel
def errors(output: Floats, rows: Rows, lanes: Floats, result: Floats) -> None:
    """Set result[0] to the mean absolute and result[1] to the mean squared error of `output`; inf when not finite."""
    n = rows.length
    target = rows.target
    total = 0.0
    square = 0.0
    for start in range(0, n, LANES):
        for k in range(LANES):
            lanes[k] = abs(output[start + k] - target[start + k])
        for k in range(n - start, LANES):
            lanes[k] = 0.0
        total += lane_sum(lanes)
        for k in range(LANES):
            e = output[start + k] - target[start + k]
            lanes[k] = e * e
        for k in range(n - start, LANES):
            lanes[k] = 0.0
        square += lane_sum(lanes)
    finite = np.isfinite(square) and np.isfinite(total)
    result[0] = total / n if finite else INFINITY
    result[1] = square / n if finite else INFINITY


@kernel
def measure_tape(tape: Tape, count: int, rows: Rows, linear: int, work: Work, scale: Floats, result: Floats) -> None:
    """Evaluate the tape on `rows` with `work.terms` as they are and set the errors; one value at each row.

    `linear` is the number of terms when b, a_1, ... are to be fitted first, else 0; returns nothing.
    """
    forward(count, tape.code, tape.left, tape.right, tape.constants, rows.inputs, rows.length, work.values)
    if linear > 0:
        fit_terms(linear, rows, work, scale)
    combine_into(work.output, work.values, work.terms, work.number[0], scale, rows.length)
    errors(work.output, rows, work.lanes, result)


@kernel
def _normal_equations(tape: Tape, count: int, fitted: int, linear: int, rows: Rows, scale: Floats, work: Work) -> int:
    """Fill matrix and gradient for the columns (d/dc, t_j, 1) at the values standing in `work`; return their number."""
    size = fitted + (linear + 1 if linear > 0 else 0)
    for i in range(size):
        work.gradient[i] = 0.0
        for j in range(i + 1):
            work.matrix[i, j] = 0.0
    columns = work.columns
    lanes = work.lanes
    for start in range(0, rows.length, LANES):
        _columns_into(tape, count, fitted, linear, rows, scale, start, work)
        residual = columns[size]
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


@kernel
def _columns_into(
    tape: Tape, count: int, fitted: int, linear: int, rows: Rows, scale: Floats, start: int, work: Work
) -> None:
    """Write the columns of the Jacobian and the residual for one block of rows; zero beyond the last row."""
    adjoints = work.adjoints
    for i in range(count):
        if tape.depends[i]:
            for k in range(LANES):
                adjoints[i, k] = 0.0
    for j in range(work.number[0]):
        for k in range(LANES):
            adjoints[work.terms[j], k] = scale[1 + j]
    reverse_block(count, tape.code, tape.left, tape.right, tape.depends, work.values, start, adjoints)
    columns = work.columns
    size = fitted
    for i in range(fitted):
        for k in range(LANES):
            columns[i, k] = adjoints[work.fitted[i], k]
    if linear > 0:
        for j in range(linear):
            for k in range(LANES):
                columns[size, k] = work.values[work.terms[j], start + k]
            size += 1
        for k in range(LANES):
            columns[size, k] = 1.0
        size += 1
    for k in range(LANES):
        columns[size, k] = work.output[start + k] - rows.target[start + k]
    for i in range(size + 1):
        for k in range(rows.length - start, LANES):
            columns[i, k] = 0.0


@kernel
def _solve(size: int, damping: float, work: Work) -> bool:
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
def fit(
    tape: Tape, count: int, rows: Rows, options: Fit, most: int, steps: int, work: Work, scale: Floats, result: Floats
) -> int:
    """Fit terms and inner constants of the tape to `rows`, in place; set the errors; return point evaluations.

    A value at a row counts 1; the reverse sweep that makes it a gradient counts 2 more.

    Args:
        most: constants fitted at most, the terms' included.
        steps: Levenberg-Marquardt steps at most; ends earlier when exact or stalled.
        scale: out: b, a_1, ...  result: (2,) out: mean absolute and mean squared error on `rows`.
    """
    number = collect_terms(tape, count, options.terms, work.terms)
    work.number[0] = number
    linear = number if options.terms > 0 else 0
    reset_scale(scale)
    fitted = (
        choose_fitted(tape, count, number, max(most - linear - 1, options.least), work) if steps > 0 else linear * 0
    )
    measure_tape(tape, count, rows, linear, work, scale, result)
    evaluations = rows.length
    if fitted == 0 or not np.isfinite(result[1]):
        return evaluations
    power = _product_about(rows.target, 0.0, rows.target, 0.0, rows.length, work.lanes) / rows.length
    damping = _FIRST_DAMPING
    fresh = True
    size = fitted
    for _ in range(steps):
        if result[1] <= _EXACT * power:
            break
        if fresh:
            size = _normal_equations(tape, count, fitted, linear, rows, scale, work)
            evaluations += 2 * rows.length
            fresh = False
        if not _solve(size, damping, work):
            damping *= 10.0
            continue
        for j in range(fitted):
            work.kept[j] = tape.constants[work.fitted[j]]
            tape.constants[work.fitted[j]] += work.step[j]
        _keep_into(work.kept_scale, scale)
        measure_tape(tape, count, rows, linear, work, scale, work.trial)
        evaluations += rows.length
        if work.trial[1] < result[1]:
            gain = 1.0 - work.trial[1] / result[1]
            damping *= 0.1
            result[0] = work.trial[0]
            result[1] = work.trial[1]
            fresh = True
            if gain < _STALLED:
                break
        else:
            damping *= 10.0
            _keep_into(scale, work.kept_scale)
            for j in range(fitted):
                tape.constants[work.fitted[j]] = work.kept[j]
    return evaluations


@inlined
def _keep_into(target: Floats, source: Floats) -> None:
    for j in range(source.shape[0]):
        target[j] = source[j]
