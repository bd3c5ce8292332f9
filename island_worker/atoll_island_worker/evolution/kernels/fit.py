"""Fit a program to rows: linear coefficients in closed form, the constants inside terms by Levenberg-Marquardt steps.

An individual's output is b + a_1 t_1 + ... + a_m t_m, where the t_j are the terms that its list adds and subtracts at
the top. With one term this is linear scaling (Keijzer 2003). The a_j and b always minimise the squared error for the
present terms, so that only the inner constants need steps. This is variable projection (Golub & Pereyra 1973) with
Kaufman's (1975) Jacobian: its columns are the derivatives with fixed a_j, minus their projections on 1 and the terms.
The damping is Marquardt's (1963): a multiple of the diagonal of the normal equations. Sums run over rows in order. No
arrays are allocated.
"""

from typing import Final

import numpy as np

from atoll_core.compilation.jit import inlined
from atoll_core.expression.kernels.lanes import LANES, add_scaled, copy, fill, lowest_bit, place, total_magnitude
from atoll_core.expression.kernels.tape import Int, apply_operator, forward, reverse_block
from atoll_core.expression.operators import ADD, CONSTANT, COS, DIVIDE, MULTIPLY, NEGATE, SIN, SUBTRACT, VARIABLE
from atoll_island_worker.evolution.kernels.measured_rows import centre_into, product
from atoll_island_worker.evolution.kernels.tape import ARITY_OF
from atoll_island_worker.evolution.kernels.variation import reset_scale
from atoll_island_worker.evolution.structures import MOST_FITTED, Fit, Floats, Hashes, Ints, Lists, Rows, Tape, Work

INFINITY: Final = np.inf
_FIRST_DAMPING: Final = 1e-3
_STALLED: Final = 1e-3
"""A fit has stalled if a step reduces the squared error by less than this share."""
_EXACT: Final = 1e-30
"""A fit is exact if its mean squared error is at most this share of the target's mean square."""
_COLLINEAR: Final = 1e-10
"""A term is a combination of earlier terms if at most this share of its squared length is orthogonal to them."""
_NEGLIGIBLE: Final = 1e-28
"""A term is constant if its variance is at most this share of its squared mean."""
_SUPERFLUOUS: Final = 1e-20
"""Smallest share of the squared length of a Jacobian column that remains after projection, see `_project`."""
_ZERO: Final = np.int64(0)
_ONE: Final = np.int64(1)
_NONE: Final = np.uint64(0)
_UNIT: Final = np.uint64(1)


@inlined
def _add_term(terms: Ints, number: Int, node: Int, code: Ints) -> Int:
    """Append `node` to the first `number` of `terms`, unless it is in the list or a constant; return the new number.

    Constants are part of b.
    """
    if code[node] == CONSTANT:
        return number
    for j in range(number):
        if terms[j] == node:
            return number
    terms[number] = node
    return number + 1


@inlined
def collect_terms(tape: Tape, count: Int, most: Int, terms: Ints) -> Int:
    """List in `terms` the tape indices of at most `most` terms; return their number, 0 for a constant program.

    The search for terms begins at the output. A negation is replaced by its argument. A product with a constant, or a
    quotient with a constant divisor, is replaced by the other argument. A sum or difference is replaced by its two
    arguments while there are fewer than `most` terms. With `most` 0 the only term is the output, unscaled.
    """
    terms[0] = count - 1
    if most == 0:
        return _ONE
    code = tape.code
    number: Int = _ZERO if code[count - 1] == CONSTANT else _ONE
    j = _ZERO
    while j < number:
        node = terms[j]
        op = code[node]
        left = tape.left[node]
        right = tape.right[node]
        splits = (op == ADD or op == SUBTRACT) and number < most
        scaled = (op == MULTIPLY and (code[left] == CONSTANT or code[right] == CONSTANT)) or (
            op == DIVIDE and code[right] == CONSTANT
        )
        if not (splits or scaled or op == NEGATE):
            j += 1
            continue
        for k in range(j, number - 1):
            terms[k] = terms[k + 1]
        number -= 1
        number = _add_term(terms, number, left, code)
        if op != NEGATE:
            number = _add_term(terms, number, right, code)
        j = _ZERO
    return number


@inlined
def choose_fitted(tape: Tape, count: Int, number: Int, most: Int, work: Work) -> Int:
    """List the first `most` constants inside the `number` terms in `work.fitted`; return how many there are.

    `tape.depends` marks the nodes that depend on them.
    """
    feeds = tape.wanted
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
    fitted = _ZERO
    for i in range(count):
        op = tape.code[i]
        depends: bool | np.bool_ = False
        if feeds[i]:
            if op == CONSTANT:
                depends = fitted < most and fitted < MOST_FITTED and not work.held[i]
                if depends:
                    work.fitted[fitted] = i
                    fitted += 1
            elif op != VARIABLE:
                depends = tape.depends[tape.left[i]] or (ARITY_OF[op] > 1 and tape.depends[tape.right[i]])
        tape.depends[i] = depends
    return fitted


@inlined
def fit_terms(number: Int, rows: Rows, work: Work, scale: Floats) -> None:
    """Set `scale` to the b, a_1, ... that minimise the squared error, and `work.residual` to the residuals.

    The method is modified Gram-Schmidt on the centred terms. The coefficient of a term that is constant, or a
    combination of earlier terms, is 0.
    """
    n = rows.length
    basis = work.basis
    for start in range(_ZERO, n, LANES):
        copy(place(work.residual, _ZERO, start), place(rows.centred, _ZERO, start))
    for j in range(number):
        term = work.terms[j]
        mean = product(work.values, term, rows.mask, _ZERO, n) / n
        work.means[j] = mean
        centre_into(basis, j, work.values, term, mean, rows)
        power = product(basis, j, basis, j, n)
        length = power
        for i in range(j):
            ratio = product(basis, i, basis, j, n) * work.inverse[i]
            work.ratio[i, j] = ratio
            _subtract_multiple(basis, j, ratio, basis, i, n)
        if j > 0:
            length = product(basis, j, basis, j, n)
        usable = length > _COLLINEAR * power and power > _NEGLIGIBLE * mean * mean * n
        inverse = 1.0 / length if usable else 0.0
        work.inverse[j] = inverse
        amount = product(basis, j, work.residual, _ZERO, n) * inverse if usable else 0.0 * power  # NaN stays NaN
        scale[1 + j] = amount
        _subtract_multiple(work.residual, _ZERO, amount, basis, j, n)
    scale[0] = rows.facts[0]
    for j in range(number - 1, -1, -1):
        if work.inverse[j] == 0.0:
            scale[1 + j] = 0.0
            continue
        for k in range(j + 1, number):
            scale[1 + j] -= work.ratio[j, k] * scale[1 + k]
        scale[0] -= scale[1 + j] * work.means[j]


@inlined
def _subtract_multiple(out: Floats, i: Int, factor: float, source: Floats, j: Int, length: Int) -> None:
    """Subtract `factor` times source[j] from out[i], in the first `length` columns."""
    for start in range(_ZERO, length, LANES):
        add_scaled(place(out, i, start), -factor, place(source, j, start))


@inlined
def residual_of(number: Int, rows: Rows, work: Work, scale: Floats) -> None:
    """Set `work.residual` to the target minus (b + a_1 t_1 + ...), with the coefficients in `scale`."""
    residual = work.residual
    for start in range(_ZERO, rows.length, LANES):
        out = place(residual, _ZERO, start)
        fill(out, -scale[0])
        add_scaled(out, 1.0, place(rows.target, _ZERO, start))
        for j in range(number):
            add_scaled(out, -scale[1 + j], place(work.values, work.terms[j], start))
    centre_into(residual, _ZERO, residual, _ZERO, 0.0, rows)


@inlined
def errors(rows: Rows, work: Work, result: Floats) -> None:
    """Set result[0] to the mean absolute and result[1] to the mean squared residual, both inf when not finite."""
    n = rows.length
    sum_ = 0.0
    for start in range(_ZERO, n, LANES):
        sum_ += total_magnitude(place(work.residual, _ZERO, start), place(rows.mask, _ZERO, start))
    square = product(work.residual, _ZERO, work.residual, _ZERO, n)
    finite = np.isfinite(square) and np.isfinite(sum_)
    result[0] = sum_ / n if finite else INFINITY
    result[1] = square / n if finite else INFINITY


@inlined
def measure_tape(
    tape: Tape, count: Int, rows: Rows, is_linear: bool, partly: bool, work: Work, scale: Floats, result: Floats
) -> None:
    """Evaluate the tape on `rows` and set the errors in `result` (2,); `work.terms` must be set.

    This counts as one point evaluation at each row. With `is_linear`, b, a_1, ... are fitted to the terms. With
    `partly`, only nodes that depend on fitted constants are evaluated again.
    """
    wanted = tape.depends if partly else tape.wanted
    forward(
        count, tape.code, tape.left, tape.right, tape.constants, wanted, rows.inputs, rows.waves, rows.length,
        work.values, work.functions,
    )  # fmt: skip
    if is_linear:
        fit_terms(work.number[0], rows, work, scale)
    else:
        residual_of(work.number[0], rows, work, scale)
    errors(rows, work, result)


@inlined
def _forward_list(lists: Lists, p: Int, live: Hashes, rows: Rows, work: Work) -> None:
    """Write the values of the nodes of list `p` that are marked in `live` to `work.values`; row i belongs to node i."""
    for start in range(_ZERO, rows.length, LANES):
        for word in range(live.shape[0]):
            waiting = live[word]
            while waiting != _NONE:
                i = (word << 6) + lowest_bit(waiting)
                waiting &= waiting - _UNIT
                _forward_node(lists, p, i, rows, start, work)


@inlined
def _forward_node(lists: Lists, p: Int, i: Int, rows: Rows, start: Int, work: Work) -> None:
    op, left = np.int64(lists.code[p, i]), np.int64(lists.left[p, i])
    out = place(work.values, i, start)
    if op == VARIABLE:
        copy(out, place(rows.inputs, left, start))
    elif op == CONSTANT:
        fill(out, lists.constants[p, i])
    elif (op == SIN or op == COS) and rows.waves.shape[0] > 0 and lists.code[p, left] == VARIABLE:
        copy(out, place(rows.waves, 2 * np.int64(lists.left[p, left]) + (op - SIN), start))
    else:
        right = np.int64(lists.right[p, i])
        apply_operator(op, out, place(work.values, left, start), place(work.values, right, start), work.functions)


@inlined
def measure_plainly(lists: Lists, p: Int, live: Hashes, rows: Rows, work: Work, result: Floats) -> None:
    """Evaluate list `p` on `rows` without a tape and without fitting; set the errors in `result` (2,).

    `live` marks the live nodes of the list.
    """
    _forward_list(lists, p, live, rows, work)
    output = np.int64(lists.code.shape[1] - 1)
    for start in range(_ZERO, rows.length, LANES):
        out = place(work.residual, _ZERO, start)
        copy(out, place(rows.target, _ZERO, start))
        add_scaled(out, -1.0, place(work.values, output, start))
    centre_into(work.residual, _ZERO, work.residual, _ZERO, 0.0, rows)
    errors(rows, work, result)
    work.settled[0] = True


@inlined
def _jacobian(tape: Tape, count: Int, fitted: Int, is_linear: bool, rows: Rows, scale: Floats, work: Work) -> None:
    """Fill `work.columns` with the derivatives of the output with respect to the fitted constants, for fixed a_j."""
    adjoints = work.adjoints
    for start in range(_ZERO, rows.length, LANES):
        for i in range(count):
            if tape.depends[i]:
                fill(place(adjoints, i, _ZERO), 0.0)
        for j in range(work.number[0]):
            fill(place(adjoints, work.terms[j], _ZERO), scale[1 + j])
        reverse_block(
            count, tape.code, tape.left, tape.right, tape.depends, work.values, start, adjoints, work.functions
        )
        for i in range(fitted):
            copy(place(work.columns, i, start), place(adjoints, work.fitted[i], _ZERO))


@inlined
def _project(i: Int, rows: Rows, work: Work) -> None:
    """Subtract from column `i` its projection on 1 and the terms; if only rounding errors remain, set it to 0.

    Such a column belongs to a constant whose effect the coefficients can replace, such as c in a exp(x + c). A step
    along rounding errors would be enormous, and would spoil the steps of all other constants.
    """
    n = rows.length
    columns = work.columns
    mean = product(columns, i, rows.mask, _ZERO, n) / n
    centre_into(columns, i, columns, i, mean, rows)
    whole = product(columns, i, columns, i, n) + n * mean * mean
    for j in range(work.number[0]):
        if work.inverse[j] > 0.0:
            ratio = product(work.basis, j, columns, i, n) * work.inverse[j]
            _subtract_multiple(columns, i, ratio, work.basis, j, n)
    if product(columns, i, columns, i, n) <= _SUPERFLUOUS * whole:
        for start in range(_ZERO, n, LANES):
            fill(place(columns, i, start), 0.0)


@inlined
def _normal_equations(
    tape: Tape, count: Int, fitted: Int, is_linear: bool, rows: Rows, scale: Floats, work: Work
) -> None:
    """Fill `work.matrix` and `work.gradient` for the values in `work`; columns are projected, see `_project`."""
    _jacobian(tape, count, fitted, is_linear, rows, scale, work)
    n = rows.length
    columns = work.columns
    for i in range(fitted):
        if is_linear:
            _project(i, rows, work)
        else:
            centre_into(columns, i, columns, i, 0.0, rows)
        work.gradient[i] = -product(columns, i, work.residual, _ZERO, n)
        for j in range(i + 1):
            work.matrix[i, j] = product(columns, i, columns, j, n)


@inlined
def _solve(size: Int, damping: float, work: Work) -> bool:
    """Solve (A + damping diag A) step = -gradient by Cholesky; return False if the matrix is not positive definite."""
    damped = work.damped
    for i in range(size):
        for j in range(i):
            s = work.matrix[i, j]
            for k in range(j):
                s -= damped[i, k] * damped[j, k]
            damped[i, j] = s * damped[j, j]
        s = work.matrix[i, i] * (1.0 + damping) + 1e-300
        for k in range(i):
            s -= damped[i, k] * damped[i, k]
        if not s > 1e-15 * work.matrix[i, i] or not np.isfinite(s):
            return False
        damped[i, i] = 1.0 / np.sqrt(s)
    for i in range(size):
        s = -work.gradient[i]
        for k in range(i):
            s -= damped[i, k] * work.step[k]
        work.step[i] = s * damped[i, i]
    for i in range(size - 1, -1, -1):
        s = work.step[i]
        for k in range(i + 1, size):
            s -= damped[k, i] * work.step[k]
        work.step[i] = s * damped[i, i]
        if not np.isfinite(work.step[i]):
            return False
    return True


@inlined
def fit(
    tape: Tape, count: Int, rows: Rows, options: Fit, most: Int, steps: Int, ceiling: float, work: Work,
    scale: Floats, result: Floats,
) -> Int:  # fmt: skip
    """Fit coefficients and inner constants of the tape to `rows`, in place; return the number of point evaluations.

    A value at a row counts as 1 point evaluation; a gradient at a row counts as 2 more.

    Args:
        most: largest number of fitted constants, coefficients and b included.
        steps: largest number of Levenberg-Marquardt steps; the fit ends earlier when it is exact or has stalled.
        ceiling: no step is taken if the loss after fitting the coefficients is above this.
        scale: result: b, a_1, ...
        result: result, (2,): mean absolute and mean squared error on `rows`.
    """
    number = collect_terms(tape, count, options.terms, work.terms)
    work.number[0] = number
    is_linear = options.terms > 0
    reset_scale(scale)
    room = max(most - (number if is_linear else _ZERO) - 1, options.least)
    fitted = choose_fitted(tape, count, number, room if steps > 0 else _ZERO, work)
    evaluations = _ZERO
    damping = _FIRST_DAMPING
    left = steps
    partly = False
    while True:
        measure_tape(tape, count, rows, is_linear, partly, work, scale, work.trial)
        evaluations += rows.length
        if not partly or work.trial[1] < result[1]:
            is_stalled = partly and 1.0 - work.trial[1] / result[1] < _STALLED
            result[0] = work.trial[0]
            result[1] = work.trial[1]
            _keep_into(work.kept_scale, scale)
            is_exact = result[1] <= _EXACT * rows.facts[1]
            work.settled[0] = fitted == 0 or is_exact or is_stalled or not np.isfinite(result[1])
            if work.settled[0] or left == 0 or (not partly and result[options.loss] > ceiling):
                break
            _normal_equations(tape, count, fitted, is_linear, rows, scale, work)
            evaluations += 2 * rows.length
            damping *= 0.1 if partly else 1.0
        else:
            _keep_into(scale, work.kept_scale)
            for j in range(fitted):
                tape.constants[work.fitted[j]] = work.kept[j]
            damping *= 10.0
        while left > 0 and not _solve(fitted, damping, work):
            damping *= 10.0
            left -= 1
        if left == 0:
            break
        left -= 1
        partly = True
        for j in range(fitted):
            work.kept[j] = tape.constants[work.fitted[j]]
            tape.constants[work.fitted[j]] += work.step[j]
    return evaluations


@inlined
def _keep_into(target: Floats, source: Floats) -> None:
    for j in range(source.shape[0]):
        target[j] = source[j]
