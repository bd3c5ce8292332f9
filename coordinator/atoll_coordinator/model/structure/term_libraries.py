"""Candidates beside those of the search: libraries of terms, from which the least significant go one after another.

A sum of all products of variables up to some degree, with or without sines and cosines, is fitted to one state's
trajectories, the others as smoothed; then the term of least coefficient over standard error is left out, and so on
(backward elimination by Wald's test). Every sum on the way is a candidate: what a greedy search by derivative error
does not reach, or what it buries in terms that describe the smoother's errors.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, combinations_with_replacement

import numpy as np

from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.builder import Expression, ProgramBuilder
from atoll_core.expression.operators import ADD, COS, DIVIDE, MULTIPLY, SIN, SUBTRACT, VARIABLE
from atoll_core.expression.program import Program
from atoll_core.expression.simplification import simplify_program


@dataclass(frozen=True)
class Divisor:
    """What a term is divided by: a variable (index) or its square (`power` 2), and a constant added unless that is 0.

    `shift` is where the fit of that constant begins; equal divisors have one constant in common.
    """

    variable: int
    power: int = 1
    shift: float = 0.0


@dataclass(frozen=True)
class Factor:
    """A variable (index), or its sum or difference (`join`) with an`other`; as it is, or its sine or cosine.

    Instead of a factor there may be a `divisor`.
    """

    variable: int
    function: int | None = None
    other: int | None = None
    join: int = SUBTRACT
    divisor: Divisor | None = None


Term = tuple[Factor, ...]
"""A product."""


def libraries(variables: Sequence[int], operators: Collection[int]) -> Iterator[list[Term]]:
    """Yield libraries over these variables, as far as the operators (codes) allow them, the constant term first.

    Powers and products up to the second or third degree; with sines and cosines; products of these; and sines and
    cosines of sums and differences, by which phases are coupled.
    """
    if not {ADD, MULTIPLY} <= set(operators):
        return
    plain = [Factor(variable) for variable in variables]
    waves = [Factor(variable, code) for variable in variables for code in (SIN, COS)]
    coupled = [
        Factor(first, code, second, join)
        for first, second in combinations(variables, 2)
        for join in (SUBTRACT, ADD)
        for code in (SIN, COS)
    ]
    candidates = [_powers(plain, 2), _powers(plain, 3)]
    if {SIN, COS} <= set(operators):
        pairs: list[Term] = [*combinations(waves, 2)]
        single: list[Term] = [(wave,) for wave in waves]
        candidates += [[*_powers(plain, 2), *single], [(), *single, *pairs]]
        if SUBTRACT in operators:
            candidates.append([(), *single, *((wave,) for wave in coupled)])
    yield from (terms for terms in candidates if len(terms) <= SETTINGS.structure.largest_library)


def fractions(variables: Sequence[int], operators: Collection[int], sizes: Sequence[float]) -> Iterator[list[Term]]:
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
    plain = [Factor(variable) for variable in variables]
    for variable in variables:
        for power in (1, 2):
            under = Factor(variable, divisor=Divisor(variable, power, sizes[variable] ** power))
            own, others = (Factor(variable), under), [(factor,) for factor in plain if factor != Factor(variable)]
            mixed: list[Term] = [(*term, *own) for term in others]
            for quotients in ([*mixed], [own, *mixed]):
                if quotients and len(quotients) + len(_powers(plain, 2)) <= SETTINGS.structure.largest_library:
                    yield [*_powers(plain, 2), *quotients]
    if {SIN, COS} <= set(operators):
        waves: list[Term] = [(Factor(variable, code),) for variable in variables for code in (SIN, COS)]
        for variable in variables:
            over = Factor(variable, divisor=Divisor(variable))
            numerators: list[Term] = [(), *((factor,) for factor in plain if factor != Factor(variable)), *waves]
            yield [(), *((factor,) for factor in plain), *waves, *((*term, over) for term in numerators)]


def _powers(factors: Sequence[Factor], degree: int) -> list[Term]:
    return [term for order in range(degree + 1) for term in combinations_with_replacement(factors, order)]


def sum_of(terms: Sequence[Term], coefficients: Sequence[float]) -> Program:
    """Return the program of the sum of `terms`, in their order, with these coefficients."""
    total: Expression | None = None
    for term, coefficient in zip(terms, coefficients, strict=True):
        part: Expression = float(coefficient)
        for factor in term:
            part = (DIVIDE if factor.divisor else MULTIPLY, part, _expression(factor))
        total = part if total is None else (ADD, total, part)
    assert total is not None
    builder = ProgramBuilder()
    return simplify_program(builder.program(builder.build(total)))


def _expression(factor: Factor) -> Expression:
    """Return a factor, or what a term is divided by."""
    expression: Expression = (VARIABLE, factor.variable)
    if factor.divisor is not None:
        if factor.divisor.power == 2:
            expression = (MULTIPLY, expression, expression)
        if factor.divisor.shift:
            expression = (ADD, expression, factor.divisor.shift)
    if factor.other is not None:
        expression = (factor.join, expression, (VARIABLE, factor.other))
    return expression if factor.function is None else (factor.function, expression)


def column_of(term: Term, inputs: FloatArray) -> FloatArray:
    """Return the values of a term (R,) at `inputs` (V, R), NaN everywhere if its divisor is zero somewhere."""
    column = np.ones(inputs.shape[1])
    for factor in term:
        values = inputs[factor.variable]
        if factor.other is not None:
            values = values + inputs[factor.other] if factor.join == ADD else values - inputs[factor.other]
        if factor.function is not None:
            values = np.sin(values) if factor.function == SIN else np.cos(values)
        if factor.divisor is not None:
            with np.errstate(all="ignore"):
                values = 1.0 / (values**factor.divisor.power + factor.divisor.shift)
            if not np.isfinite(values).all():
                return np.full_like(column, np.nan)
        column = column * values
    return column
