"""Candidates beside those of the search: libraries of terms, from which the least significant go one after another.

A sum of all products of variables up to some degree, with or without sines and cosines, is fitted to one state's
trajectories, the others as smoothed; then the term of least coefficient over standard error is left out, and so on
(backward elimination by Wald's test). Every sum on the way is a candidate: what a greedy search by derivative error
does not reach, or what it buries in terms that describe the smoother's errors.

A term is an expression without its coefficient: here, and wherever sums are made of terms.
"""

from collections.abc import Collection, Iterator, Sequence
from itertools import combinations, combinations_with_replacement

from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.operators import ADD, COS, DIVIDE, MULTIPLY, SIN, SUBTRACT, VARIABLE
from atoll_core.expression.program import Expression, Program, ProgramBuilder
from atoll_core.expression.simplification import simplify_program


def libraries(variables: Sequence[int], operators: Collection[int]) -> Iterator[list[Expression]]:
    """Yield libraries over these variables, as far as the operators (codes) allow them, the constant term first.

    Powers and products up to the second or third degree; with sines and cosines; products of these; and sines and
    cosines of sums and differences, by which phases are coupled.
    """
    if not {ADD, MULTIPLY} <= set(operators):
        return
    plain: list[Expression] = [(VARIABLE, variable) for variable in variables]
    waves: list[Expression] = [(code, variable) for variable in plain for code in (SIN, COS)]
    candidates = [_powers(plain, 2), _powers(plain, 3)]
    if {SIN, COS} <= set(operators):
        candidates += [[*_powers(plain, 2), *waves], [1.0, *waves, *map(product_of, combinations(waves, 2))]]
        if SUBTRACT in operators:
            pairs = list(combinations(plain, 2))
            phases = [(join, *pair) for pair in pairs for join in (SUBTRACT, ADD)]
            candidates.append([1.0, *waves, *((code, phase) for phase in phases for code in (SIN, COS))])
    yield from (terms for terms in candidates if len(terms) <= SETTINGS.effort.longest_sum)


def fractions(
    variables: Sequence[int], operators: Collection[int], sizes: Sequence[float]
) -> Iterator[list[Expression]]:
    """Yield libraries with quotients, the constant term first, as far as the operators (codes) allow them.

    Powers and products up to the second degree, beside them what saturates or fades with one variable v: products of
    v, or v squared, over a constant and the same (Monod's and Holling's laws), the constant of all of them being the
    same one; and sines, cosines and variables over v.

    Args:
        variables: indices of the variables.
        operators: codes that may be used.
        sizes: the size of each variable, by index; constants of denominators begin there.
    """
    if not {ADD, MULTIPLY, DIVIDE} <= set(operators):
        return
    plain: list[Expression] = [(VARIABLE, variable) for variable in variables]
    for variable, own in zip(variables, plain, strict=True):
        others = [other for other in plain if other != own]
        for power in (1, 2):
            below = (ADD, product_of([own] * power), sizes[variable] ** power)
            mixed: list[Expression] = [(DIVIDE, product_of([other, own]), below) for other in others]
            for quotients in ([*mixed], [(DIVIDE, own, below), *mixed]):
                if quotients and len(quotients) + len(_powers(plain, 2)) <= SETTINGS.effort.longest_sum:
                    yield [*_powers(plain, 2), *quotients]
    if {SIN, COS} <= set(operators):
        waves: list[Expression] = [(code, variable) for variable in plain for code in (SIN, COS)]
        for own in plain:
            above = [1.0, *(other for other in plain if other != own), *waves]
            yield [1.0, *plain, *waves, *((DIVIDE, term, own) for term in above)]


def _powers(factors: Sequence[Expression], degree: int) -> list[Expression]:
    orders = range(degree + 1)
    return [product_of(term) for order in orders for term in combinations_with_replacement(factors, order)]


def product_of(factors: Sequence[Expression]) -> Expression:
    """Return a product, 1 where there are no factors."""
    product = factors[0] if factors else 1.0
    for factor in factors[1:]:
        product = (MULTIPLY, product, factor)
    return product


def scaled(term: Expression, factor: float) -> Expression:
    """Return a term times a number, which is the first of its factors: what is above the line is not 1 any more."""
    match term:
        case (code, first, second) if code in (MULTIPLY, DIVIDE):
            return (code, scaled(first, factor), second)
    return factor if term == 1.0 else (MULTIPLY, factor, term)


def sum_of(terms: Sequence[Expression], coefficients: Sequence[float]) -> Program:
    """Return the program of the sum of `terms`, in their order, with these coefficients."""
    total, *others = (scaled(term, float(factor)) for term, factor in zip(terms, coefficients, strict=True))
    for other in others:
        total = (ADD, total, other)
    builder = ProgramBuilder()
    return simplify_program(builder.program(builder.build(total)))
