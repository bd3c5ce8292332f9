"""The law of one state from its derivatives: a short sum that leaves no more than their errors."""

from collections.abc import Collection, Iterable, Iterator, Sequence

from atoll_coordinator.model.criteria import structure_length
from atoll_coordinator.model.pools import Law
from atoll_coordinator.model.sparse.elimination import shortest
from atoll_coordinator.model.sparse.products import libraries
from atoll_coordinator.model.sparse.rates.functions import extended
from atoll_coordinator.model.sparse.rates.networks import with_network
from atoll_coordinator.model.sparse.rates.rate_rows import RateRows
from atoll_coordinator.model.sparse.rates.rate_sums import RateSum, polished, pruned, shortest_sum
from atoll_coordinator.model.sparse.rates.screening import screened
from atoll_coordinator.model.sparse.shapes import Atom, powers
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.operators import TANH


def find_rate_laws(rows: RateRows, columns: Sequence[int], operators: Collection[int]) -> tuple[Law, ...]:
    """Return the law, none where no sum of a few terms leaves as little as the derivatives' errors.

    Polynomials of the first and second degree first, then a node of a network, then these polynomials with functions,
    then those of higher degree; at last the function taken in first is exchanged.

    Args:
        rows: of the derivative sought.
        columns: variables that may be used.
        operators: codes of operators that may be used.
    """
    kept = screened(rows, columns)
    for alike in _sums(rows, kept, operators) if kept else ():
        best = shortest(rate_sum for rate_sum in alike if rate_sum.scale <= 1.0)
        if best is not None:
            program = best.program()
            return (Law(program, structure_length(program), best.scale, is_tested=True, is_of_rates=True),)
    return ()


def _sums(rows: RateRows, columns: Sequence[int], operators: Collection[int]) -> Iterator[list[RateSum]]:
    """Yield the shortest sums of one kind after another."""
    sizes = libraries(columns, len(rows.values), range(1, SETTINGS.sparse.degree + 1))
    polynomials = [list(map(Atom, powers(rows.inputs, terms))) for terms, _ in sizes]
    low, high = polynomials[:2], polynomials[2:]
    for atoms in low:
        yield _shortest(rows, [atoms])
    if TANH in operators and low:
        yield _shortest(rows, [atoms for atoms in [with_network(rows, low[0], columns)] if atoms])
    beginnings: list[Sequence[Atom]] = [*low]
    for _ in range(SETTINGS.sparse.pursued_functions):
        longer = [extended(rows, begun, columns, operators) for begun in beginnings]
        yield _shortest(rows, [atoms for group in longer for atoms in group])
        beginnings = [group[0] for group in longer if group]
    for atoms in high:
        yield _shortest(rows, [atoms])
    exchanged = [extended(rows, _without_first(begun), columns, operators) for begun in beginnings]
    yield _shortest(rows, [atoms for group in exchanged for atoms in group])


def _without_first(atoms: Sequence[Atom]) -> list[Atom]:
    """Return the atoms without the function that was taken in first, which may have stood in for another."""
    first = next((place for place, atom in enumerate(atoms) if atom.shape.function is not None), len(atoms))
    return [*atoms[:first], *atoms[first + 1 :]]


def _shortest(rows: RateRows, libraries: Iterable[Sequence[Atom]]) -> list[RateSum]:
    """Return the shortest sum of each library, inner constants fitted."""
    sums = (shortest_sum(rows, atoms) for atoms in libraries)
    return [pruned(rows, polished(rows, rate_sum)) for rate_sum in sums if rate_sum is not None]
