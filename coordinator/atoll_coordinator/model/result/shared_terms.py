"""Terms that several equations have in common, such as a flux that leaves one state and enters another.

`find_shared_terms` expands the brackets of all equations and compares their terms. Two terms are the same if they
differ only in their factors: their inner numbers, such as c in 2*u/(c + u), agree within two standard errors of their
difference. Terms that were fitted together have the same inner numbers.

Doubtful: the standard errors of two numbers are treated as independent. No shared terms are found for an equation with
too many terms. The comparison is for display and changes no equation; `inference.shared_terms` decides which terms are
fitted together.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final

from atoll_coordinator.model.refinement import Refined
from atoll_coordinator.result.findings import SharedTerm
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.operators import VARIABLE
from atoll_core.expression.program import ProgramBuilder
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.writing.expansion import Shape, inner_numbers, shape_of, terms_of
from atoll_core.expression.writing.layout import written
from atoll_core.expression.writing.sums_of_products import ONE, Monomial, UndefinedError

Flux = tuple[Shape, Mapping[str, float | None]]
_SAME_NUMBER: Final = 1e-9
"""Relative tolerance when a number in a term is matched with a constant of the equation."""


def find_shared_terms(
    equations: Mapping[str, Refined], names: Sequence[str], together: Sequence[Flux] = ()
) -> tuple[SharedTerm, ...]:
    """Return the terms that occur in at least two equations, with their `factors` in each.

    Numbers are not listed as shared terms. Single variables are listed only if they were fitted together. The result
    has the inner numbers of the first equation. For terms fitted together, `multiples` has the multiple of the flux in
    each equation.

    Args:
        equations: the shown equations, by variable.
        names: the names of all variables.
        together: the terms that were fitted together.
    """
    terms: list[tuple[Monomial, Refined, dict[str, float]]] = []
    for variable, equation in equations.items():
        for monomial, factor in _terms(equation):
            for known_monomial, owner, factors in terms:
                if variable not in factors and _are_same_term(known_monomial, owner, monomial, equation):
                    factors[variable] = factor
                    break
            else:
                terms.append((monomial, equation, {variable: factor}))
    found = []
    for monomial, _, factors in terms:
        fluxes = (dict(multiples) for shape, multiples in together if shape == shape_of(monomial))
        multiples = next((flux for flux in fluxes if factors.keys() >= flux.keys()), None)
        if len(factors) > 1 and not (_is_variable(monomial) and multiples is None):
            has_function = any(atom[0] != VARIABLE for atom, _ in monomial)
            text = _write_term(monomial, names)
            found.append(SharedTerm(term=text, has_function=has_function, factors=factors, multiples=multiples))
    return tuple(found)


def _terms(equation: Refined) -> list[tuple[Monomial, float]]:
    """Return the terms of an equation with their factors; an empty list if there are too many terms."""
    try:
        terms = terms_of(equation.program)
    except UndefinedError:
        return []
    return [(monomial, factor) for monomial, factor in terms if monomial != ONE]


def _is_variable(monomial: Monomial) -> bool:
    return len(monomial) == 1 and monomial[0][1] == 1 and monomial[0][0][0] == VARIABLE


def _are_same_term(left: Monomial, left_equation: Refined, right: Monomial, right_equation: Refined) -> bool:
    if shape_of(left) != shape_of(right):
        return False
    numbers = [inner_numbers(((monomial, 1.0),)) for monomial in (left, right)]
    if len(numbers[0]) != len(numbers[1]):
        return False
    pairs = zip(*(sorted(term_numbers, key=abs) for term_numbers in numbers), strict=True)
    return all(
        abs(first - second)
        <= 2.0 * math.hypot(_standard_error(first, left_equation), _standard_error(second, right_equation))
        for first, second in pairs
    )


def _standard_error(number: float, equation: Refined) -> float:
    """Return the standard error of a number in a term. If no error is known, 0.001 of the number is returned."""
    for constant in equation.constants:
        if abs((constant.value or 0.0) - number) <= _SAME_NUMBER * abs(number):
            if constant.std_error is not None:
                return constant.std_error
            if not constant.identifiable and constant.interval is None:
                return math.inf
    return SETTINGS.common.negligible * abs(number)


def _write_term(monomial: Monomial, names: Sequence[str]) -> str:
    builder = ProgramBuilder()
    return to_infix(builder.program(builder.build(written(((monomial, 1.0),))[1])), names)
