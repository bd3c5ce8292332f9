"""The laws of all states from their windows: short sums that leave no more than errors of measurement.

Each state has its own sum at first. Then functions that one has are offered to the others: a flux that leaves one state
enters another, so that its inner constant has a price once.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from atoll_coordinator.model.criteria import log
from atoll_coordinator.model.pools import Law
from atoll_coordinator.model.sparse.elimination import shortest
from atoll_coordinator.model.sparse.products import libraries
from atoll_coordinator.model.sparse.rates.functions import Beside, dictionary
from atoll_coordinator.model.sparse.shapes import Atom, powers
from atoll_coordinator.model.sparse.windows.terms import Terms, depends
from atoll_coordinator.model.sparse.windows.window_rows import WindowRows
from atoll_coordinator.model.sparse.windows.window_sums import WindowSum, eliminated, fitted, improved, polished
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.program import operators_in


@dataclass(frozen=True, eq=False)
class WindowEquation:
    """What the law of one state is sought in: its windows, the variables (indices) and operators (codes) allowed."""

    rows: WindowRows
    columns: Sequence[int]
    operators: Collection[int]

    def allows(self, atom: Atom) -> bool:
        """Tell whether a term has nothing but variables and operators that are allowed."""
        variables = range(len(self.rows.inputs))
        return all(variable in self.columns or not depends(atom.shape, variable) for variable in variables) and set(
            operators_in(atom.shape.expression(atom.constant))
        ) <= set(self.operators)


def find_window_laws(equations: Mapping[str, WindowEquation]) -> dict[str, tuple[Law, ...]]:
    """Return the law of each state, none where no short sum leaves as little as errors of measurement."""
    alone = {name: shortest_sum(equation) for name, equation in equations.items()}
    functions = list(
        _functions(window_sum for window_sum in alone.values() if window_sum is not None and _is_held(window_sum))
    )
    sums = {name: _with_shared(equations[name], window_sum, functions) for name, window_sum in alone.items()}
    return {
        name: () if window_sum is None or not _is_held(window_sum) else (_law(window_sum),)
        for name, window_sum in sums.items()
    }


def _is_held(window_sum: WindowSum) -> bool:
    return window_sum.excess <= SETTINGS.inference.excess


def _law(window_sum: WindowSum) -> Law:
    return Law(window_sum.program(), window_sum.nats, window_sum.excess, is_tested=True, is_of_rates=True)


def shortest_sum(equation: WindowEquation) -> WindowSum | None:
    """Return the shortest sum for one state: a polynomial of the second degree, and up to two products with functions.

    None where the windows decide nothing.
    """
    polynomials = _polynomials(equation)
    best = shortest(eliminated(begun) for library in polynomials for begun in _beginnings(library, equation.columns))
    for _ in range(SETTINGS.sparse.pursued_functions):
        best = None if best is None else improved(best)
        candidate = None if best is None else _with_function(equation, best, polynomials)
        if best is None or candidate is None or not candidate.nats < best.nats - log(float(SETTINGS.rates.most_atoms)):
            break
        best = candidate
    return best


def _polynomials(equation: WindowEquation) -> list[Terms]:
    """Return the products up to no, the first and the second degree, as far as the windows decide them."""
    rows = equation.rows
    sizes = libraries(equation.columns, rows.independent, range(3), SETTINGS.windows.largest_library)
    return [Terms(rows, tuple(map(Atom, powers(rows.inputs, terms)))) for terms, _ in sizes]


def _beginnings(library: Terms, columns: Sequence[int]) -> Iterator[WindowSum]:
    """Yield the sum of all terms of a library, then without the variable that can be spared best, and so on to one.

    Functions stay.
    """
    kept = list(range(len(library.atoms)))
    near = fitted(library, kept)
    free = list(columns) if len(kept) > 1 else []
    while near is not None:
        yield near
        if len(free) < 2:
            return
        tried = []
        for variable in free:
            fewer = [place for place in kept if not _can_spare(library.atoms[place], variable)]
            candidate = fitted(library, fewer, near, SETTINGS.windows.brief_rounds)
            if candidate is not None:
                tried.append((candidate.nats, variable, fewer, candidate))
        if not tried:
            return
        _, gone, kept, near = min(tried, key=lambda entry: entry[:2])
        free.remove(gone)


def _can_spare(atom: Atom, variable: int) -> bool:
    return atom.shape.function is None and depends(atom.shape, variable)


def _with_function(equation: WindowEquation, best: WindowSum, polynomials: Sequence[Terms]) -> WindowSum | None:
    """Return the shortest sum with one function more than `best`, or than none, inner constants fitted."""
    rows = equation.rows
    beginnings = [best.atoms, *(library.atoms for library in polynomials[:-1])]
    longer = (Terms(rows, atoms) for atoms in _extended(equation, beginnings))
    sums = (fitted(terms, range(len(terms.atoms))) for terms in longer)
    candidate = shortest(eliminated(polished(window_sum)) for window_sum in sums if window_sum is not None)
    if candidate is None:
        return None
    best = shortest([candidate, eliminated(polished(candidate))]) or candidate
    return shortest([best, _among(best, polynomials[-1].atoms)])


def _extended(equation: WindowEquation, beginnings: Sequence[Sequence[Atom]]) -> list[tuple[Atom, ...]]:
    """Return each of `beginnings` with one product with a function more, inner constants fitted one by one.

    Errors of terms are not counted, and windows that do not overlap are taken.
    """
    rows = equation.rows.apart()
    tried = dictionary(rows.inputs, equation.columns, equation.operators)
    errors = np.sqrt(rows.own + rows.spread(rows.sides[0] - rows.sides[1]) ** 2)
    extensions: list[tuple[Atom, ...]] = []
    for begun in beginnings:
        values = rows.integrals(np.array([atom.values for atom in begun]))
        if np.isfinite(values).all():
            beside = Beside(values, rows.sides[0], errors, rows.integrals)
            extensions += [(*begun, atom) for atom in beside.best_atoms(tried)]
    return extensions


def _among(window_sum: WindowSum, library: Sequence[Atom]) -> WindowSum | None:
    """Return the end of a search around a sum with all products of a library, inner constants as they are."""
    functions = [atom for atom in window_sum.atoms if atom.shape.function is not None]
    terms = Terms(window_sum.terms.rows, (*library, *functions), window_sum.terms.shared)
    factors = [atom.shape.factors for atom in library]
    kept = [factors.index(atom.shape.factors) for atom in window_sum.atoms if atom.shape.function is None]
    begun = fitted(terms, [*sorted(kept), *range(len(library), len(terms.atoms))])
    return None if begun is None else improved(begun)


def _functions(sums: Iterable[WindowSum]) -> Iterator[Atom]:
    """Yield all terms with functions."""
    for window_sum in sums:
        yield from (atom for atom in window_sum.atoms if atom.shape.function is not None)


def _with_shared(equation: WindowEquation, best: WindowSum | None, functions: Sequence[Atom]) -> WindowSum | None:
    """Return the shortest sum when functions of other states' laws are terms, too, with the inner constants there."""
    own = [] if best is None else list(_functions([best]))
    for function in functions:
        if any(function is term for term in own) or not equation.allows(function):
            continue
        for library in _polynomials(equation)[-1:]:
            terms = Terms(equation.rows, (*library.atoms, function), frozenset([len(library.atoms)]))
            candidate = shortest(eliminated(begun) for begun in _beginnings(terms, equation.columns))
            best = shortest([best, None if candidate is None else improved(candidate)])
    return best
