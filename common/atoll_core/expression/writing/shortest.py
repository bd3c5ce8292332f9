"""The shortest writing of a program: a search among equal sums, checked over the range of the data.

The search is best-first: it applies all identities to the cheapest sum found so far, until a number of sums have been
written (`_MOST_TRIED`). Arguments of functions and brackets are searched before the sum that contains them. The result
is deterministic, but it may not be the shortest writing: the search stops at a limit, so that printing does not take
too long.
"""

import heapq
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.expression import operators as op
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import MAX_NODES, Program, ProgramBuilder, tree_size
from atoll_core.expression.simplification import simplify_program
from atoll_core.expression.writing.identities import equal_sums
from atoll_core.expression.writing.layout import NODE, written
from atoll_core.expression.writing.sums_of_products import (
    Sum,
    UndefinedError,
    add,
    constant,
    contained,
    function,
    multiply,
    power,
    raised,
    variable,
)

_SLACK: Final = 8 * NODE
"""Identities are not applied to sums that cost more than the best sum plus this."""
_LARGEST: Final = 300
"""Nodes of the largest tree that is rewritten."""
_SMALLEST: Final = 4 * NODE
"""Expressions with fewer nodes cannot be shortened."""
_MOST_TRIED: Final = (0, 4, 30)
"""Number of sums that a search writes, by its depth."""
_MOST_ROWS: Final = 500
_POINTS: Final = 250
_TOLERANCE: Final = 1e-6


@lru_cache(maxsize=8192)
def _shortest_of(program: Program, depth: int) -> Program:
    if tree_size(program) <= _LARGEST:
        with suppress(UndefinedError):
            short = _rewritten(program, depth)
            if len(short) <= MAX_NODES:
                return short
    return simplify_program(program)


@contained
def _rewritten(program: Program, depth: int) -> Program:
    builder = ProgramBuilder()
    return builder.program(builder.build(written(best_of(sum_of(program, depth), depth))[1]))


def shortest(program: Program) -> Program:
    """Return the shortest writing of the function of `program`."""
    return _shortest_of(program, len(_MOST_TRIED) - 1)


def shortened(program: Program) -> Program:
    """Return a short writing of the function of `program`. The search for it is brief, so that hundreds of candidates
    can be shortened."""
    return _shortest_of(program, 1)


def collected(program: Program) -> Program:
    """Return `program` as a sum of products, without a search."""
    return _shortest_of(program, 0)


@contained
def sum_of(program: Program, depth: int = 0) -> Sum:
    """Return a program as a sum; searches of this depth find the best form of its brackets and arguments."""
    sums: list[Sum] = []
    for code, left, right, value in program.nodes():
        if code == op.VARIABLE:
            sums.append(variable(left))
        elif code == op.CONSTANT:
            sums.append(constant(value))
        else:
            sums.append(_operated(code, sums[left], sums[right] if op.ARITY[code] == 2 else (), depth))
    return sums[-1]


def _operated(code: int, left: Sum, right: Sum, depth: int) -> Sum:
    if code in (op.ADD, op.SUBTRACT):
        return add((1.0, left), (1.0 if code == op.ADD else -1.0, right))
    if code == op.NEGATE:
        return add((-1.0, left))
    one, other = best_of(left, depth), best_of(right, depth)
    if code == op.SQUARE or (code == op.MULTIPLY and left == right):
        return power(one, 2)
    if code == op.MULTIPLY:
        return multiply(one, other)
    if code == op.DIVIDE:
        return multiply(one, power(other, -1))
    if code == op.INVERSE:
        return power(one, -1)
    return raised(one, other) if code == op.POW else function(code, one)


@lru_cache(maxsize=50_000)
def best_of(terms: Sum, depth: int) -> Sum:
    """Return the equal sum with the shortest writing found; its brackets are searched with depth - 1."""
    if depth == 0:
        return terms
    best = (written(terms)[0], terms)
    if best[0] < _SMALLEST:
        return terms
    known, waiting, tried = {terms}, [best], 0
    while waiting and tried < _MOST_TRIED[depth]:
        cost, current = heapq.heappop(waiting)
        if cost > best[0] + _SLACK:
            break
        for other in equal_sums(current, lambda inner: best_of(inner, depth - 1)):
            if other not in known:
                known.add(other)
                tried += 1
                candidate = (written(other)[0], other)
                best = min(best, candidate)
                heapq.heappush(waiting, candidate)
            if tried >= _MOST_TRIED[depth]:
                break
    return best[1]


def shortest_over(program: Program, inputs: FloatArray) -> Program:
    """Return the shortest writing of `program`, or `program` if values differ over the box of `inputs` (V, R)."""
    return shortest_at(program, lambda: points_of(inputs))


def shortest_at(program: Program, points: Callable[[], FloatArray]) -> Program:
    """Return the result of `shortest_over`; `points` calls `points_of`, and is called only if needed."""
    short = shortest(program)
    return short if short == program or agree(program, short, points()) else program


def agree(before: Program, after: Program, points: FloatArray) -> bool:
    """Tell whether `after` has the values of `before`, up to rounding errors, wherever these are finite."""
    old, new = values_of(before, points), values_of(after, points)
    defined = np.isfinite(old)
    if not defined.any():
        return True
    # scaled first: the median may add the two middle values, and their sum may overflow
    size = float(np.median(_TOLERANCE * np.abs(old[defined])))
    return bool(np.allclose(new[defined], old[defined], rtol=_TOLERANCE, atol=size))


def points_of(inputs: FloatArray) -> FloatArray:
    """Return evenly spread rows of `inputs` (V, R >= 1), and points that fill the box around them (V, P).

    The points are an additive recurrence (Roberts 2018): no two points have an equal coordinate.
    """
    variables, rows = inputs.shape
    count = min(rows, _MOST_ROWS)
    chosen = inputs[:, np.arange(count) * rows // count]
    root = 2.0
    for _ in range(30):
        root = (1.0 + root) ** (1.0 / (variables + 1))
    steps = root ** -np.arange(1.0, variables + 1.0)
    low, high = inputs.min(axis=1), inputs.max(axis=1)
    unit = np.outer(steps, np.arange(1.0, _POINTS + 1.0)) % 1.0
    return np.ascontiguousarray(np.concatenate([chosen, low[:, None] + unit * (high - low)[:, None]], axis=1))
