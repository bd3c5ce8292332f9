"""Products of variables: libraries of them, their values, and the programs that are sums of them."""

from collections.abc import Iterator, Sequence
from itertools import combinations_with_replacement

import numpy as np

from atoll_coordinator.model.structure.term_libraries import product_of, sum_of
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.operators import VARIABLE
from atoll_core.expression.program import Expression, Program
from atoll_core.expression.writing.expansion import terms_of
from atoll_core.expression.writing.sums_of_products import UndefinedError

Product = tuple[int, ...]
"""Variables (indices) in ascending order, as often as they are factors; none: the constant."""


def products(columns: Sequence[int], degree: int) -> list[Product]:
    """Return all products of these variables up to a degree, the constant first."""
    return [term for order in range(degree + 1) for term in combinations_with_replacement(columns, order)]


def libraries(
    columns: Sequence[int], rows: float, degrees: Sequence[int], most: int = SETTINGS.sparse.largest_library
) -> Iterator[tuple[list[Product], bool]]:
    """Yield all products up to each degree, as far as so many rows decide them, and whether the largest is among them.

    Each term of a library takes `rows_per_term` rows that know nothing of each other; there are at `most` so many.
    """
    candidates = [products(columns, degree) for degree in degrees]
    allowed = [terms for terms in candidates if len(terms) <= min(most, rows / SETTINGS.sparse.rows_per_term)]
    for terms in allowed:
        yield terms, len(allowed) == len(candidates)


def values_of_products(terms: Sequence[Product], inputs: FloatArray) -> FloatArray:
    """Return the values (K, R) at `inputs` (V, R), factors multiplied in their order."""
    values = np.ones((len(terms), inputs.shape[1]))
    for row, term in zip(values, terms, strict=True):
        for variable in term:
            row *= inputs[variable]
    return values


def expression_of(term: Product) -> Expression:
    """Return a product as an expression."""
    return product_of([(VARIABLE, variable) for variable in term])


def sum_of_products(terms: Sequence[Product], coefficients: Sequence[float]) -> Program:
    """Return the sum of products with these coefficients."""
    return sum_of([expression_of(term) for term in terms], coefficients)


def products_of(program: Program, degree: int) -> list[Product] | None:
    """Return the products that `program` sums up; None where it is no sum of products of at most this degree."""
    try:
        monomials = [monomial for monomial, _ in terms_of(program)]
    except UndefinedError:
        return None
    found: list[Product] = []
    for monomial in monomials:
        if any(atom[0] != VARIABLE or exponent < 0 for atom, exponent in monomial):
            return None
        found.append(tuple(sorted(atom[1] for atom, exponent in monomial for _ in range(exponent))))
    return sorted(found, key=lambda term: (len(term), term)) if max(map(len, found), default=0) <= degree else None
