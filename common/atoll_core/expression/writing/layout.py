"""Writes a sum as an expression, in reading order, with the cheapest form of its terms, factors and signs.

The cost is the number of numbers, variables, operators and functions in the text; leading minus signs are free. If two
expressions have equal counts, the expression with fewer numbers is cheaper; after that, the numbers of functions, minus
signs and digits decide, in this order.
"""

import math
from collections.abc import Iterator
from functools import lru_cache
from operator import itemgetter
from typing import Final

from atoll_core.expression import operators as op
from atoll_core.expression.program import Expression
from atoll_core.expression.writing.sums_of_products import (
    ONE,
    Atom,
    Monomial,
    Sum,
    cleaned,
    raised_number,
    scaled,
    times,
)

NODE: Final = 1 << 36
"""Cost of a node. All other costs are smaller: they decide between expressions with equal numbers of nodes."""
_INNER_QUOTIENT: Final = 3 * NODE
"""Extra cost of a quotient in a divisor: such an expression is undefined at one place where its function has a
value."""
_NUMBER: Final = 1 << 28
_FUNCTION: Final = 1 << 20
_SIGN: Final = 1 << 12

Written = tuple[int, Expression]
"""Cost and expression."""
Term = tuple[bool, int, Expression]
"""Whether a term is negative; and the cost and the expression of the term without its sign."""


@lru_cache(maxsize=50_000)
def written(terms: Sum) -> Written:
    """Return the cheapest expression of a sum with its present terms and brackets."""
    if not terms:
        return _number(0.0)
    listed = _listed([_term(*term) for term in in_order(terms)])
    return min([listed, *_grouped(terms)], key=itemgetter(0))


@lru_cache(maxsize=50_000)
def _number(value: float) -> Written:
    text = f"{abs(value):.17g}"
    digits = len(text) if float(text) == abs(value) and len(text) < 9 else len(repr(abs(value)))
    return NODE + _NUMBER + digits + (_SIGN if value < 0.0 else 0), value


def _signed(negative: bool, cost: int, expression: Expression) -> Written:
    if not negative:
        return cost, expression
    negated = _negated(expression)
    return cost + _SIGN, (op.NEGATE, expression) if negated is None else negated


def _negated(expression: Expression) -> "Expression | None":
    """Return the negative of a number, or of a product or quotient that begins with a number. None for other
    expressions."""
    if isinstance(expression, float):
        return -expression
    if isinstance(expression, tuple) and expression[0] in (op.MULTIPLY, op.DIVIDE):
        code, first, *rest = expression
        negated = _negated(first)
        return None if negated is None else (code, negated, *rest)
    return None


def _listed(terms: list[Term]) -> Written:
    """Write the sum of `terms` from left to right, as additions and subtractions. The first positive term is moved to
    the front."""
    lead = next((index for index, (negative, _, _) in enumerate(terms) if not negative), 0)
    terms.insert(0, terms.pop(lead))
    total, expression = _signed(*terms[0])
    for negative, cost, other in terms[1:]:
        total += NODE + cost + (_SIGN if negative else 0)
        expression = (op.SUBTRACT if negative else op.ADD, expression, other)
    return total, expression


def _grouped(terms: Sum) -> Iterator[Written]:
    """If several terms have equal coefficients, yield the sum in which the coefficient is written once, before a
    bracket with these terms."""
    groups: dict[float, list[tuple[Monomial, float]]] = {}
    for monomial, coefficient in terms:
        if monomial != ONE and abs(coefficient) != 1.0:
            groups.setdefault(abs(coefficient), []).append((monomial, coefficient))
    shared = [(size, group) for size, group in groups.items() if len(group) > 1]
    if not shared:
        return
    grouped = {term for _, group in shared for term in group}
    parts = [_term(*term) for term in in_order(tuple(term for term in terms if term not in grouped))]
    for size, group in shared:
        sign = 1.0 if any(coefficient > 0.0 for _, coefficient in group) else -1.0
        cost, inner = written(tuple((monomial, sign * coefficient / size) for monomial, coefficient in group))
        number, text = _number(size)
        parts.append((sign < 0.0, cost + number + NODE, (op.MULTIPLY, text, inner)))
    yield _listed(parts)


def in_order(terms: Sum) -> list[tuple[Monomial, float]]:
    """Return terms in reading order: numbers, products of variables by degree, quotients, functions."""
    return sorted(terms, key=_place) if len(terms) > 1 else list(terms)


def _place(term: tuple[Monomial, float]) -> tuple[object, ...]:
    monomial, _ = term
    has_function, has_quotient, degree = False, False, 0
    variables: list[tuple[int, int]] = []
    for atom, exponent in monomial:
        if atom[0] == op.VARIABLE:
            variables.append((atom[1], -exponent))
        elif atom[0] != op.ADD:
            has_function = True
        if exponent < 0:
            has_quotient = True
        else:
            degree += exponent
    return (monomial != ONE, has_function, has_quotient, degree, tuple(variables), monomial)


def _term(monomial: Monomial, coefficient: float) -> Term:
    """Return the cheapest expression of a term."""
    if not monomial:
        return (coefficient < 0.0, *_number(abs(coefficient)))
    if len(monomial) == 1 and monomial[0][1] == 1 and monomial[0][0][0] == op.VARIABLE and abs(coefficient) == 1.0:
        return coefficient < 0.0, NODE, (op.VARIABLE, monomial[0][0][1])
    brackets = {atom: exponent for atom, exponent in monomial if atom[0] == op.ADD}
    scales = {atom: _own_scale(atom[1]) for atom in brackets}
    best = _write_scaled(monomial, coefficient, scales)
    for atom, exponent in brackets.items():
        if abs(exponent) == 1:
            others = math.prod(raised_number(scales[other], -brackets[other]) for other in brackets if other != atom)
            own = cleaned(raised_number(times(coefficient, others), exponent))
            best = min(best, _write_scaled(monomial, coefficient, {**scales, atom: own}), key=itemgetter(1))
    return best


def _with_tangents(monomial: Monomial) -> list[tuple[Atom, int]]:
    """Return the factors of a monomial, with sin u/cos u joined to one factor, ``(DIVIDE, u, SIN)``, and cos u/sin u
    likewise."""
    if not any(atom[0] == op.SIN for atom, _ in monomial):
        return list(monomial)
    exponents = dict(monomial)
    for (kind, *arguments), exponent in monomial:
        partner = (op.COS, *arguments) if kind == op.SIN else ()
        other = exponents.get(partner, 0)
        if exponent * other < 0:
            count = min(abs(exponent), abs(other))
            sign = 1 if exponent > 0 else -1
            exponents[(op.SIN, *arguments)] -= sign * count
            exponents[partner] += sign * count
            exponents[(op.DIVIDE, *arguments, op.SIN if sign > 0 else op.COS)] = count
    return [item for item in exponents.items() if item[1]]


@lru_cache(maxsize=20_000)
def _own_scale(terms: Sum) -> float:
    """Return the factor that makes a bracket cheapest."""
    sizes = dict.fromkeys((1.0, *(1.0 / abs(coefficient) for _, coefficient in terms)))
    costs = {cleaned(size): written(scaled(terms, cleaned(size)))[0] for size in sizes if math.isfinite(size)}
    return min(costs, key=lambda size: costs[size])


def _write_scaled(monomial: Monomial, coefficient: float, scales: dict[Atom, float]) -> Term:
    """Return a term with its brackets multiplied by `scales`, and its coefficient divided accordingly."""
    above: list[Written] = []
    below: list[Written] = []
    for atom, scale in scales.items():
        coefficient = times(coefficient, raised_number(scale, -dict(monomial)[atom]))
    coefficient = cleaned(coefficient)
    factors = _with_tangents(monomial)
    if len(factors) > 1:
        factors.sort(key=lambda item: _factor_place(item[0]))
    for atom, exponent in factors:
        flips, written_atom = _atom(atom, scales.get(atom, 1.0), wants_flip=coefficient < 0.0 and exponent % 2 == 1)
        coefficient = -coefficient if flips else coefficient
        cost, expression = written_atom
        if abs(exponent) > 1:
            cost, expression = cost + 2 * NODE, _chained([written_atom] * abs(exponent))
        if exponent > 0:
            above.append((cost, expression))
        else:
            has_quotient = atom[0] == op.ADD and any(count < 0 for inner, _ in atom[1] for _, count in inner)
            below.append((cost + _INNER_QUOTIENT * has_quotient, expression))
    size = abs(coefficient)
    if size != 1.0:
        above.insert(0, _number(size))
    cost = sum(factor[0] for factor in (*above, *below)) + NODE * (len(above) + len(below) - 1)
    if not above:
        return coefficient < 0.0, cost + 2 * NODE, (op.INVERSE, _chained(below))
    expression = _chained(above)
    return coefficient < 0.0, cost, (op.DIVIDE, expression, _chained(below)) if below else expression


def _chained(factors: list[Written]) -> Expression:
    expression = factors[0][1]
    for _, factor in factors[1:]:
        expression = (op.MULTIPLY, expression, factor)
    return expression


def _factor_place(atom: Atom) -> tuple[object, ...]:
    """Return the sort key of factors in reading order: variables, functions, brackets."""
    return (atom[0] != op.VARIABLE, atom[0] == op.ADD, atom)


def _atom(atom: Atom, scale: float, *, wants_flip: bool) -> tuple[bool, Written]:
    """Return whether an atom is written as its negative, and its expression."""
    kind = atom[0]
    if kind == op.VARIABLE:
        return False, (NODE, (op.VARIABLE, atom[1]))
    if kind == op.POW:
        base, exponent = written(atom[1]), written(atom[2])
        return False, (base[0] + exponent[0] + NODE + _FUNCTION, (op.POW, base[1], exponent[1]))
    argument = scaled(atom[1], scale) if kind == op.ADD else atom[1]
    flips = kind in (op.ADD, op.SIN, op.TANH, op.DIVIDE) and _should_flip(argument, wants_flip=wants_flip)
    if flips or (kind == op.COS and _should_flip(argument, wants_flip=False)):
        argument = scaled(argument, -1.0)
    cost, expression = written(argument)
    if kind == op.ADD:
        return flips, (cost, expression)
    if kind == op.DIVIDE:
        other = op.COS if atom[2] == op.SIN else op.SIN
        return flips, (cost + NODE + _FUNCTION, (op.DIVIDE, (atom[2], expression), (other, expression)))
    return flips, (cost + NODE + _FUNCTION, (kind, expression))


def _should_flip(terms: Sum, *, wants_flip: bool) -> bool:
    """Tell whether the negative of a sum is written: because all terms are negative, or because a change of sign is
    wanted and possible."""
    signs = {coefficient > 0.0 for _, coefficient in terms}
    return signs == {False} or (wants_flip and len(signs) == 2)
