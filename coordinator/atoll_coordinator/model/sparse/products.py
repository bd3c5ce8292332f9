"""Programs as sums of products of variables, where they are such."""

from collections.abc import Iterable, Mapping

from atoll_coordinator.model.structure.term_libraries import Factor, Term
from atoll_core.expression.operators import ADD, CONSTANT, DIVIDE, MULTIPLY, NEGATE, SQUARE, SUBTRACT, VARIABLE
from atoll_core.expression.program import Program

_Sum = Mapping[tuple[int, ...], float]
"""Coefficients by the variables of a product, sorted, as often as they are its factors."""


def products_of(program: Program, degree: int) -> list[Term] | None:
    """Return the products that `program` sums up; None where it is no sum of products of at most this degree."""
    sums: list[_Sum | None] = []
    for code, left, right, value in program.nodes():
        if code == VARIABLE:
            sums.append({(left,): 1.0})
        elif code == CONSTANT:
            sums.append({(): value})
        else:
            sums.append(_operated(code, sums[left], sums[right], degree))
    total = sums[-1]
    if total is None:
        return None
    kept = sorted((key for key, value in total.items() if value), key=lambda key: (len(key), key))
    return [tuple(Factor(variable) for variable in key) for key in kept]


def _operated(code: int, left: _Sum | None, right: _Sum | None, degree: int) -> _Sum | None:
    if left is None:
        return None
    if code == NEGATE:
        return _added(left, {}, -1.0, 0.0)
    if code == SQUARE:
        return _multiplied(left, left, degree)
    if right is None:
        return None
    if code in (ADD, SUBTRACT):
        return _added(left, right, 1.0, 1.0 if code == ADD else -1.0)
    if code == MULTIPLY:
        return _multiplied(left, right, degree)
    divisor = right.get((), 0.0)
    return _added(left, {}, 1.0 / divisor, 0.0) if code == DIVIDE and len(right) == 1 and divisor else None


def _added(left: _Sum, right: _Sum, left_factor: float, right_factor: float) -> _Sum:
    return _collected([*((key, left_factor * value) for key, value in left.items()),
                       *((key, right_factor * value) for key, value in right.items())])  # fmt: skip


def _multiplied(left: _Sum, right: _Sum, degree: int) -> _Sum | None:
    if max(map(len, left)) + max(map(len, right)) > degree:
        return None
    return _collected(
        (tuple(sorted((*left_term, *right_term))), factor * value)
        for left_term, factor in left.items()
        for right_term, value in right.items()
    )


def _collected(products: Iterable[tuple[tuple[int, ...], float]]) -> _Sum:
    total: dict[tuple[int, ...], float] = {}
    for key, value in products:
        total[key] = total.get(key, 0.0) + value
    return total
