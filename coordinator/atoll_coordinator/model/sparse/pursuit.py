"""Candidates that are sums of a polynomial and of products with functions, by matching pursuit with a beam.

The products with functions that give the smallest residuals are added to a polynomial (orthogonal matching pursuit,
Pati et al. 1993), all constants of the best sums are fitted, inner ones too, and the best go on; then the least
significant terms are removed one after another. With the polynomial there from the beginning, the gain of another term
does not decide which function is taken. A search that changes one place of an equation at a time reaches such laws only
through worse ones. Targets are smoothed derivatives, whose errors are not known row by row: rows count alike, and the
best sums of each length are returned, to be compared along trajectories.

Letters: A atoms, K terms, R rows.
"""

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from atoll_coordinator.model.batches import BatchFunction
from atoll_coordinator.model.least_squares import Descent, Solver, coefficients_of, inverse, minimize, solver
from atoll_coordinator.model.sparse.atoms import Atom, Shape, powers, products, program_of, shapes
from atoll_coordinator.model.thinning import thinned_places
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, Problem
from atoll_core.expression.operators import ADD, MULTIPLY
from atoll_core.expression.program import Program, operators_in

_DEGREE: Final = SETTINGS.sparse.degree - 1
"""Highest degree of the polynomial that functions are added to; in products with functions it is one less."""

_ROUNDING: Final = 1e-11
"""Share of a unit column beyond others that is rounding."""
_NEARLY_ALIKE: Final = 1e-8
"""Pairs of atoms with a smaller squared sine are not tried: rounding would decide."""
_RANKED_PAIRS: Final = 2000
"""Pairs that are sorted: one pair of terms has dozens, which differ in inner constants."""
_MOST_PAIRED: Final = 4000
"""With more atoms no pairs are tried: a matrix of gains takes 128 MB for this many, as with twenty states."""


@dataclass(frozen=True, eq=False)
class _Sum:
    """A fitted sum: its terms by shape (index), inner constants and coefficients (K,), its `residuals` (R,)."""

    terms: tuple[int, ...]
    constants: FloatArray
    coefficients: FloatArray
    residuals: FloatArray

    @cached_property
    def square(self) -> float:
        return float(self.residuals @ self.residuals)

    @property
    def key(self) -> tuple[int, ...]:
        return tuple(sorted(self.terms))

    def without(self, place: int) -> tuple[tuple[int, ...], FloatArray]:
        return self.terms[:place] + self.terms[place + 1 :], np.delete(self.constants, place)


def pursue(
    problem: Problem, columns: Sequence[int], operators: Collection[int], needed: Collection[int] = (),
    most: float = math.inf,
) -> list[Program]:  # fmt: skip
    """Return the sums with the smallest residuals, some of each number of constants, constants fitted.

    Args:
        problem: a target and its inputs; some rows are taken.
        columns: indices of the variables that may be used.
        operators: codes of the operators that may be used.
        needed: codes, one of which each sum has; any sum will do without.
        most: sums with more nats, for all terms with their constants, are dropped.
    """
    if not {ADD, MULTIPLY} <= set(operators) or not columns:
        return []
    settings = SETTINGS.sparse
    rows = thinned_places(problem.inputs.shape[1], settings.pursued_rows)
    inputs = np.ascontiguousarray(problem.inputs[:, rows])
    with np.errstate(all="ignore"):
        pursuit = _Pursuit(inputs, columns, operators, problem.target.values[rows], frozenset(needed), most)
        error = problem.target.uncertainty * problem.target.standard_deviation
        return pursuit.run(len(rows) * error * error)


@dataclass(frozen=True, eq=False)
class Pursuit:
    """The space of a pursuit, see `pursue`."""

    columns: tuple[int, ...]
    operators: frozenset[int]
    needed: frozenset[int] = frozenset()
    most: float = math.inf


PURSUED: Final[BatchFunction[Problem, Pursuit, tuple[Program, ...]]] = BatchFunction(
    "pursued sums", Problem, Pursuit, tuple[Program, ...],
    lambda problem, of: tuple(pursue(problem, of.columns, of.operators, of.needed, of.most)),
)  # fmt: skip
"""The sums with the smallest residuals of a target, by the space of a pursuit."""

_Promise = tuple[float, tuple[int, ...], FloatArray]
"""A sum that is not fitted yet: about its sum of squared residuals, its terms and inner constants."""


def _best(
    promises: Iterable[Iterable[_Promise]], count: int
) -> dict[tuple[int, ...], tuple[tuple[int, ...], FloatArray]]:
    """Return the terms and inner constants of the best promises, by their terms in order."""
    by_terms: dict[tuple[int, ...], _Promise] = {}
    for square, terms, constants in (promise for those in promises for promise in those):
        key = tuple(sorted(terms))
        if key not in by_terms or square < by_terms[key][0]:
            by_terms[key] = square, terms, constants
    best = sorted(by_terms.items(), key=lambda item: item[1][0])[:count]
    return {key: (terms, constants) for key, (_, terms, constants) in best}


class _Pursuit:
    def __init__(
        self, inputs: FloatArray, columns: Sequence[int], operators: Collection[int], target: FloatArray,
        needed: frozenset[int], most: float,
    ) -> None:  # fmt: skip
        self._target = target
        self._needed = needed
        self._plain = powers(inputs, products(columns, _DEGREE))
        self._shapes = list(self._plain)
        for degree in range(_DEGREE):
            plain = [shape for shape in self._plain if len(shape.factors) == degree]
            candidates = list(shapes(inputs, columns, operators, plain))
            if degree and len(self._shapes) + len(candidates) > SETTINGS.sparse.most_shapes:
                break
            self._shapes += candidates
        self._most = most
        self._least = self._remove_expensive()
        self._atoms, self._columns = self._unit_atoms()
        self._limit = 0.0
        self._fits: dict[tuple[int, ...], _Sum | None] = {}

    def _remove_expensive(self) -> float:
        """Remove the shapes with which no sum is wanted; return the price of the cheapest one that is needed."""
        prices = [shape.price(len(self._target)) for shape in self._shapes]
        is_needed = list(map(self._is_needed, self._shapes))
        least = min((price for price, needed in zip(prices, is_needed, strict=True) if needed), default=math.inf)
        beside = [price + (0.0 if needed else least) for price, needed in zip(prices, is_needed, strict=True)]
        kept = [index for index, price in enumerate(beside) if price <= self._most]
        self._shapes, self._prices = [self._shapes[index] for index in kept], np.array(prices)[kept]
        self._plain = [shape for shape in self._shapes if shape.function is None]
        return least if self._needed else 0.0

    def _is_short(self, terms: Sequence[int]) -> bool:
        """Tell whether a sum may be short enough after elimination of one of its terms."""
        return float(self._prices[list(terms)].sum()) <= self._most + self._least

    def _is_needed(self, shape: Shape) -> bool:
        return not self._needed or not self._needed.isdisjoint(operators_in(shape.expression(1.5)))

    def _unit_atoms(self) -> tuple[list[tuple[int, float]], FloatArray]:
        """Return shapes (index) with inner constants, and their values as unit columns (A, R)."""
        atoms, columns = [], []
        for index, shape in enumerate(self._shapes):
            for constant in shape.constants():
                column = shape.value(constant)
                size = math.sqrt(float(column @ column))
                if 0.0 < size < math.inf:
                    atoms.append((index, constant))
                    columns.append(column / size)
        return atoms, np.array(columns)

    def run(self, limit: float) -> list[Program]:
        """Return the best sums; the target's uncertainty alone has the sum of squares `limit`."""
        if not self._atoms:
            return []
        self._limit = limit
        sums: dict[tuple[int, ...], _Sum] = {}
        for beginning in self._beginnings():
            for candidate in self._grown(beginning):
                remainder: _Sum | None = candidate
                while remainder is not None:
                    sums[remainder.key] = remainder
                    remainder = self._without_least(remainder)
        kept: dict[int, list[_Sum]] = {}
        has_needed = [self._is_needed(shape) for shape in self._shapes]
        wanted = (candidate for candidate in sums.values() if any(has_needed[term] for term in candidate.terms))
        for candidate in self._sorted(wanted):
            constants = sum(1 + self._shapes[term].has_constant for term in candidate.terms)
            if len(kept.setdefault(constants, [])) < SETTINGS.effort.beam:
                kept[constants].append(candidate)
        most = SETTINGS.sparse.pursued_constants
        return [self._program(candidate) for size in sorted(kept) if size <= most for candidate in kept[size]]

    def _beginnings(self) -> Iterator[_Sum]:
        """Yield nothing, and all polynomials that the rows decide and that are not too large to be eliminated."""
        yield _Sum((), np.zeros(0), np.zeros(0), self._target)
        orders = [len(shape.factors) for shape in self._plain]
        for degree in range(1, max(orders, default=0) + 1):
            terms = tuple(index for index, order in enumerate(orders) if order <= degree)
            most = min(SETTINGS.effort.longest_sum, len(self._target) / SETTINGS.sparse.rows_per_term)
            if len(terms) <= most and self._is_short(terms):
                polynomial = self._solved(terms, np.ones(len(terms)))
                if polynomial is not None:
                    yield polynomial

    def _grown(self, beginning: _Sum) -> Iterator[_Sum]:
        """Yield the best sums with no, one, two ... terms more than the beginning, until the residuals are small."""
        beam = [beginning]
        for _ in range(SETTINGS.sparse.pursued_functions + (not beginning.terms)):
            yield from beam if beam[0].terms else ()
            if beam[0].square <= self._limit:
                return
            beam = self._extended(beam, beginning if beam[0] is not beginning else None)
            if not beam:
                return
        yield from beam

    def _extended(self, beam: Sequence[_Sum], beginning: _Sum | None) -> list[_Sum]:
        """Return the best sums with one term more than the sums of the beam, or with two more than the `beginning`."""
        width = 2 * SETTINGS.effort.beam
        chosen = _best((self._promises(parent) for parent in beam), width)
        are_few = len(self._atoms) <= _MOST_PAIRED
        if are_few and beginning is not None and len(beam[0].terms) == len(beginning.terms) + 1:
            chosen |= _best([self._pairs(beginning)], width)
        fits = (self._fitted(*choice) for choice in chosen.values())
        return self._sorted(fit for fit in fits if fit is not None)[: SETTINGS.effort.beam]

    def _promises(self, parent: _Sum) -> Iterator[_Promise]:
        """Yield the best further terms, inner constants as they are."""
        left, rest, norms = self._beside(parent)
        gains = np.where(norms > _ROUNDING, rest @ left, 0.0) ** 2
        seen = set[int]()
        for atom in np.argsort(-gains, kind="stable").tolist():
            term, constant = self._atoms[atom]
            is_new = term not in seen and (self._shapes[term].has_constant or term not in parent.terms)
            if is_new and self._is_short((*parent.terms, term)):
                seen.add(term)
                yield float(-gains[atom]) + parent.square, (*parent.terms, term), np.append(parent.constants, constant)
                if len(seen) >= 2 * SETTINGS.effort.beam:
                    return

    def _pairs(self, parent: _Sum) -> Iterator[_Promise]:
        """Yield the best pairs of further terms, inner constants as they are.

        Unit columns u and v, with the products a and b with the residuals, together explain
        (a^2 + b^2 - 2 a b c)/(1 - c^2), with c the product of the two.
        """
        left, rest, norms = self._beside(parent)
        usable = np.flatnonzero(norms > _ROUNDING)
        if len(usable) < 2:
            return
        unit = rest[usable]
        products = unit @ left
        cosines = unit @ unit.T
        free = 1.0 - cosines * cosines
        gains = (products[:, None] ** 2 + products**2 - 2.0 * np.outer(products, products) * cosines) / free
        gains[~(free > _NEARLY_ALIKE)] = 0.0
        gains = np.triu(gains, 1)
        count = min(_RANKED_PAIRS, gains.size - 1)
        least = -np.partition(-gains, count - 1, axis=None)[count - 1]
        best = np.flatnonzero((gains >= least) & (gains > 0.0))
        seen = set[tuple[int, int]]()
        for place in best[np.argsort(-gains.ravel()[best], kind="stable")][:count].tolist():
            (term, first), (partner, second) = (self._atoms[usable[index]] for index in divmod(place, len(usable)))
            if (term, partner) not in seen and self._is_short((*parent.terms, term, partner)):
                seen.add((term, partner))
                constants = np.append(parent.constants, (first, second))
                yield parent.square - float(gains.flat[place]), (*parent.terms, term, partner), constants
                if len(seen) >= 2 * SETTINGS.effort.beam:
                    return

    def _beside(self, parent: _Sum) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the residuals of a sum, the atoms orthogonal to its terms as unit columns (A, R), and their sizes
        before."""
        left, rest = self._target, self._columns
        if parent.terms:
            columns = self._values(parent.terms, parent.constants)
            basis = np.linalg.qr((columns / np.sqrt((columns**2).sum(axis=1))[:, None]).T)[0]
            for _ in range(2):  # the second time for rounding errors of the first
                left = left - basis @ (basis.T @ left)
                rest = rest - (rest @ basis) @ basis.T
        norms = np.sqrt((rest**2).sum(axis=1))
        return left, rest / np.maximum(norms, _ROUNDING)[:, None], norms

    def _sorted(self, sums: Iterable[_Sum]) -> list[_Sum]:
        """Return the sums without repetitions, the shortest description first."""
        unique = {candidate.key: candidate for candidate in sums}
        return sorted(unique.values(), key=self._length)

    def _length(self, candidate: _Sum) -> float:
        return self._misfit(candidate) + float(self._prices[list(candidate.terms)].sum())

    def _misfit(self, candidate: _Sum) -> float:
        return 0.5 * len(self._target) * math.log(self._counted(candidate))

    def _counted(self, candidate: _Sum) -> float:
        """Return the sum of squared residuals, at least the sum by the target's uncertainty."""
        return max(candidate.square, self._limit, 1e-300)

    def _without_least(self, candidate: _Sum) -> _Sum | None:
        """Return the sum without its least significant term (Wald's test), None of a single one."""
        jacobian, count = self._jacobian(candidate), len(candidate.terms)
        if count < 2 or not np.isfinite(jacobian).all():
            return None
        variances = np.diag(inverse(jacobian @ jacobian.T))[:count]
        gains = candidate.coefficients**2 / np.maximum(variances, 1e-300)
        return self._fitted(*candidate.without(int(np.argmin(gains))))

    def _values(self, terms: Sequence[int], constants: FloatArray) -> FloatArray:
        return np.array([self._shapes[term].value(c) for term, c in zip(terms, constants.tolist(), strict=True)])

    def _jacobian(self, candidate: _Sum) -> FloatArray:
        """Return the derivatives of the sum by its coefficients, then by its inner constants."""
        slopes = [
            coefficient * self._shapes[term].slope(constant)
            for term, constant, coefficient in zip(
                candidate.terms, candidate.constants.tolist(), candidate.coefficients.tolist(), strict=True
            )
            if self._shapes[term].has_constant
        ]
        return np.array([*self._values(candidate.terms, candidate.constants), *slopes])

    def _fitted(self, terms: tuple[int, ...], constants: FloatArray) -> _Sum | None:
        """Return the sum of these terms with all constants fitted, None where it has no finite value on some row."""
        key = tuple(sorted(terms))
        if key not in self._fits:
            self._fits[key] = self._fit(terms, constants)
        return self._fits[key]

    def _fit(self, terms: tuple[int, ...], constants: FloatArray) -> _Sum | None:
        """Return the fitted sum: damped steps of inner constants, coefficients solved for at each."""
        begun = self._solved(terms, constants)
        inner = [place for place, term in enumerate(terms) if self._shapes[term].has_constant]
        if begun is None or not inner:
            return begun

        def linearise(at: _Sum) -> Solver[FloatArray]:
            jacobian, unit = self._jacobian(at), len(self._target) / self._counted(at)  # nats for half a square
            return solver(unit * (jacobian @ jacobian.T), -unit * (jacobian @ at.residuals))

        def move(at: _Sum, step: FloatArray) -> tuple[_Sum, float] | None:
            moved = at.constants.copy()
            moved[inner] += step[len(terms) :]
            following = self._solved(terms, moved)
            return None if following is None else (following, self._misfit(at) - self._misfit(following))

        return minimize(Descent(begun, linearise, move))

    def _solved(self, terms: tuple[int, ...], constants: FloatArray) -> _Sum | None:
        """Return the sum with the coefficients of least squares at these inner constants."""
        columns = self._values(terms, constants)
        sizes = np.sqrt((columns**2).sum(axis=1))
        if not (np.isfinite(sizes).all() and (sizes > 0.0).all()):
            return None
        coefficients = coefficients_of(columns, self._target)
        return _Sum(terms, constants, coefficients, self._target - coefficients @ columns)

    def _program(self, candidate: _Sum) -> Program:
        pairs = zip(candidate.terms, candidate.constants.tolist(), strict=True)
        return program_of([Atom(self._shapes[term], constant) for term, constant in pairs], candidate.coefficients)
