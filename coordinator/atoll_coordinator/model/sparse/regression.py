"""Sparse regression: finds the short sum of terms that describes the equation of one state.

Input. A builder of rows (`rows`) gives left sides, columns of terms, and the covariance of the errors of both.
A list of atoms (`atoms`) gives the terms that a sum may have.

Criterion. The length of a description in nats: the misfit, which compares the residuals with their errors
(`RegressionRows.assess`), plus the price of each term (its structure, and 1/2 ln N for each constant). While terms are
removed, the weights of rows are fixed, and the misfit is n/2 ln(sum of weighted squares). One elimination gives this
misfit for the sums of all lengths.

Where the covariance of errors comes from. Derivatives (rates) have an error for each row, and their columns are exact.
Integrals over windows have errors of measurement in the left sides and in the columns, propagated to first order by the
derivatives of the terms. So the variance of a residual depends on the sum, and ordinary least squares would make
coefficients too small (attenuation). Two corrections are made. The mean of the products of errors is subtracted from
the normal equations (Fuller 1987). Rows are weighted by the residual variances of the previous sum: fits and new
weights alternate.

How it searches. Backward elimination from a full library (Wald's test): since the sum has all terms at the beginning,
no term is chosen only because another term is still missing. Elimination may remove a needed term early if this term is
nearly a linear combination of other terms. So single terms are added again, and the sum is eliminated again, as long as
the gain is larger than the largest gain that this number of tries gives by chance. Finally terms are removed one by
one; each time, the weights come from the remaining sum. Functions with an inner constant are terms like all others;
`many_variables` chooses the functions that are tried.

Doubts. Weights that come from a wrong sum favour this sum. The first-order variances are too small if a term is
strongly curved over the size of the noise. The errors of derivatives count as a small, fixed number of independent
numbers; this number is a guess.

Letters: K terms, M terms of a sum, N rows, V variables.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from atoll_coordinator.model.description_length import constant_nats_of, log
from atoll_coordinator.model.sparse.atoms import Atom, program_of, sum_of
from atoll_coordinator.model.sparse.kernels.elimination import (
    DEPENDENT,
    eliminate,
    find_shortest_with_each,
    scalar_products,
    sum_products,
)
from atoll_coordinator.model.sparse.rows import Assessment, Errors, RegressionRows
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program

REWEIGHTINGS = 3
"""Numerics: number of fits after which the weights of windows have settled. Each fit uses the weights of the previous
sum."""
_SETTLED = 1e-3
"""Weights have settled when the size of the residuals changes by less than this share."""


# ---------------------------------------------------------------------------------------------- elimination


@dataclass(frozen=True, eq=False)
class Elimination:
    """The sums of a backward elimination from all columns (K, N) to none, by least squares (Wald's test).

    `order` (K,) has the columns in the order of their removal. `squares` (K + 1,) has the sums of squared residuals
    with K, K - 1, ... 0 remaining columns. `coefficients` (K, K) has the coefficients at each step.
    """

    order: list[int]
    squares: FloatArray
    coefficients: FloatArray

    def remaining(self, step: int) -> list[int]:
        """Return the columns that remain at a step."""
        return sorted(self.order[step:])

    def factors(self, step: int) -> list[float]:
        """Return the coefficients of the columns that remain at a step."""
        return [float(self.coefficients[step, place]) for place in self.remaining(step)]


def eliminate_columns(
    columns: FloatArray, sides: FloatArray, errors: Errors | None = None, steps: int | None = None
) -> Elimination:
    """Return the elimination of `columns` (K, N) that are fitted to `sides` (N,), or only the first `steps` steps of
    the elimination.

    `errors` are the covariances of the errors of the columns (K, K), and of columns and sides (K,). The sum of squares
    never decreases when a term is removed.
    """
    count = len(columns)
    steps = count if steps is None else min(steps, count)
    products, cross = (np.zeros((0, 0)), np.zeros(0)) if errors is None else errors
    order, coefficients = np.zeros(count, np.int64), np.zeros((count, count))
    squares, added = np.zeros((2, count + 1))
    eliminate(
        np.ascontiguousarray(columns), np.ascontiguousarray(sides), np.ascontiguousarray(products), cross, steps,
        order, squares, coefficients, added,
    )  # fmt: skip
    return Elimination(order.tolist(), np.maximum(squares - added + added[0], squares[0]), coefficients)


class Columns(Protocol):
    """Columns (K, N) from which `select_forward` selects; they need not be in memory."""

    def column(self, place: int) -> FloatArray:
        """Return a column (N,)."""
        ...

    def dots(self, vector: FloatArray) -> FloatArray:
        """Return the products (K,) of all columns with a vector (N,)."""
        ...

    def squares(self) -> FloatArray:
        """Return the squared lengths (K,) of all columns."""
        ...


class WeightedProducts:
    """The products of up to two `factors` (V, N), then the cubes of the factors, times the `weights` (N,): (K, N)
    columns.

    Products are in the order of `products(..., 2)`. The product of a vector with all of them is the matrix of products
    of the factors, weighted by the vector.
    """

    def __init__(self, factors: FloatArray, weights: FloatArray) -> None:
        self._rows = np.ascontiguousarray(np.vstack([np.ones_like(weights), factors]).T)
        self._cubes, self._weights = factors * factors * factors, weights
        self._pairs = np.triu_indices(self._rows.shape[1])

    def column(self, place: int) -> FloatArray:
        """Return a column (N,)."""
        pairs = len(self._pairs[0])
        if place >= pairs:
            return np.asarray(self._cubes[place - pairs] * self._weights)
        first, second = (int(factors[place]) for factors in self._pairs)
        return np.asarray(self._rows[:, first] * self._rows[:, second] * self._weights)

    def dots(self, vector: FloatArray) -> FloatArray:
        """Return the products (K,) of all columns with a vector (N,)."""
        return self._sums(self._rows, self._cubes, self._weights * vector)

    def squares(self) -> FloatArray:
        """Return the squared lengths (K,) of all columns."""
        return self._sums(self._rows * self._rows, self._cubes * self._cubes, self._weights * self._weights)

    def _sums(self, rows: FloatArray, cubes: FloatArray, weights: FloatArray) -> FloatArray:
        sums = np.empty((rows.shape[1], rows.shape[1]))
        sum_products(rows, weights, sums)
        return np.concatenate([sums[self._pairs], _dots(cubes, weights)])


def select_forward(columns: Columns, side: FloatArray) -> Iterator[tuple[int, float]]:
    """Select one column after another. Yield its index, and the sum of squared residuals of the fit with this column.

    Each step selects the column that explains most of the residuals of `side` (N,): orthogonal matching pursuit. The
    selection ends when no column explains anything. Numbers are added in a fixed order, so that results are equal to
    the bit. The columns are not changed: each step reads them twice, for their products with the residuals and with the
    new direction. The squared length of a column's part that is orthogonal to the selected columns is updated.
    """
    sizes = np.sqrt(columns.squares())
    sizes[sizes == 0.0] = math.inf
    free, left, units = np.where(sizes < math.inf, 1.0, 0.0), side, np.zeros((0, len(side)))
    while True:
        gains = np.where(free > DEPENDENT, (columns.dots(left) / sizes) ** 2 / np.maximum(free, DEPENDENT), 0.0)
        best = int(np.argmax(gains))
        if not gains[best] > 0.0:
            return
        unit = _orthogonal_unit(columns.column(best) / sizes[best], units)
        units = np.vstack([units, unit])
        left = left - _dots(left[None], unit) * unit
        free = free - (columns.dots(unit) / sizes) ** 2
        free[best] = 0.0
        yield best, float(_dots(left[None], left)[0])


def _orthogonal_unit(column: FloatArray, units: FloatArray) -> FloatArray:
    """Return the part of a column (N,) that is orthogonal to the orthonormal `units` (M, N), scaled to unit length."""
    for _ in range(2):  # the second time for rounding errors of the first
        for unit in units:
            column = column - _dots(column[None], unit) * unit
    return np.asarray(column / np.sqrt(_dots(column[None], column)))


def _dots(columns: FloatArray, vector: FloatArray) -> FloatArray:
    """Return the products (K,) of columns (K, N) with a vector (N,)."""
    sums = np.zeros(len(columns))
    scalar_products(np.ascontiguousarray(vector), np.ascontiguousarray(columns), sums)
    return sums


# ---------------------------------------------------------------------------------------- sums of one library


@dataclass(frozen=True, eq=False)
class Sum:
    """A fitted sum of the terms `kept` (places) of a regression, with its `coefficients` and `nats`.

    `assessment` is None for an intermediate sum, whose nats follow from the weights of its rows.
    """

    regression: "SparseRegression"
    kept: tuple[int, ...]
    coefficients: list[float]
    nats: float
    assessment: Assessment | None = None

    @cached_property
    def atoms(self) -> tuple[Atom, ...]:
        """The terms without their coefficients."""
        return tuple(self.regression.atoms[place] for place in self.kept)

    @property
    def excess(self) -> float:
        """Ratio of the residuals to their errors; infinite if unknown."""
        return math.inf if self.assessment is None else self.assessment.excess

    def program(self) -> Program:
        """Return the sum in its shortest form as a sum of products."""
        return program_of(self.atoms, self.coefficients)

    def sum_of_products(self) -> Program:
        """Return the sum with a coefficient before each term."""
        return sum_of([atom.shape.expression(atom.constant) for atom in self.atoms], self.coefficients)


def shortest(sums: Iterable[Sum | None]) -> Sum | None:
    """Return the sum with the shortest description. If several are equally short, the first is returned. None if there
    are no sums."""
    return min((fit for fit in sums if fit is not None), key=lambda fit: fit.nats, default=None)


def descend(best: Sum, nearby: Callable[[Sum], Iterable[Sum | None]], least_gain: float = 0.0) -> Sum:
    """Return the last sum of a descent from `best`. Each step goes to the shortest of the `nearby` sums, as long as the
    gain is larger than `least_gain`."""
    while True:
        nearest = shortest(nearby(best))
        if nearest is None or not nearest.nats < best.nats - least_gain:
            return best
        best = nearest


class SparseRegression:
    """Sums of the `atoms` of one library, fitted to `rows`.

    Terms that are `shared` with another equation are described in the other equation. So their price here is only the
    price of one more use.
    """

    def __init__(self, rows: RegressionRows, atoms: Sequence[Atom], shared: frozenset[Atom] = frozenset()) -> None:
        self.rows = rows
        self.atoms = tuple(atoms)
        self.shared = shared
        self._columns, self._gradients = rows.columns(atoms), rows.gradients(atoms)

    @cached_property
    def _prices(self) -> list[float]:
        rows = self.rows.independent
        use = SETTINGS.criterion.common + constant_nats_of(rows)
        return [use if atom in self.shared else atom.shape.price(rows) for atom in self.atoms]

    @cached_property
    def is_finite(self) -> bool:
        """Whether all columns and their derivatives are finite."""
        numbers = [self._columns] if self._gradients is None else [self._columns, self._gradients]
        return all(np.isfinite(part).all() for part in numbers)

    @property
    def is_solvable(self) -> bool:
        """Whether all columns are finite, and there are fewer columns than rows."""
        return self.is_finite and len(self.atoms) < len(self.rows.sides)

    def select_terms(self, start: Sequence[int], weights: FloatArray | None = None) -> Sum | None:
        """Return the result of a search that begins with the terms `start` (indices); None if the terms cannot be
        fitted.

        The first weights are equal, or come from a fit of the terms `start` with `weights`. Later weights come from the
        previous sum, and favour this sum even if it is wrong. So at the end, terms are removed as long as this makes
        the description shorter; here the weights come from the remaining sum.
        """
        if not self.is_solvable:
            return None
        if weights is None:
            weights = np.ones(len(self.rows.sides))
        else:
            whole = self.refit(start, weights)
            if whole is None or whole.assessment is None:
                return None
            weights = whole.assessment.weights
        for reweighting in range(REWEIGHTINGS):
            found = self._best_sum(start, weights, is_extended=reweighting > 0)
            assessment = self._assess(found)
            if assessment is None:
                return None
            weights = assessment.weights
        return self.prune(self.refit(found.kept, weights))

    def prune(self, whole: Sum | None) -> Sum | None:
        """Remove terms as long as this makes the description shorter, and return the remaining sum."""
        if whole is None or whole.assessment is None:
            return None
        weights = whole.assessment.weights
        errors = self._errors(weights, whole.kept) if len(whole.kept) <= SETTINGS.effort.longest_sum else None

        def fewer(fit: Sum) -> Iterator[Sum | None]:
            for place in fit.kept if 1 < len(fit.kept) <= SETTINGS.effort.longest_sum else ():
                yield self.refit([other for other in fit.kept if other != place], weights, errors)

        return descend(whole, fewer)

    def refit(self, places: Sequence[int], weights: FloatArray, errors: Errors | None = None) -> Sum | None:
        """Return the sum of these terms after several fits, each with new weights. None if a residual has no
        variance.

        `errors` are the covariances of the errors of these and other terms for the first weights; None: they are
        computed.
        """
        before, fit = math.inf, None
        for _ in range(self.rows.reweightings):
            path = self._path(places, weights, errors or self._errors(weights, places), steps=1)
            errors = None
            fit = self._assess_sum(Sum(self, tuple(places), path.factors(0), math.inf))
            if fit.assessment is None:
                return None
            weights = fit.assessment.weights
            if abs(before - fit.excess) <= _SETTLED * fit.excess:
                break
            before = fit.excess
        return fit

    def refit_coefficients(self, weights: FloatArray) -> list[float] | None:
        """Return the coefficients of the sum of all terms after `refit`; None if a residual has no variance."""
        every = range(len(self.atoms))
        if self.rows.reweightings == 1:
            return self._path(every, weights, self._errors(weights, every), steps=1).factors(0)
        fit = self.refit(every, weights)
        return None if fit is None else fit.coefficients

    def elimination_path(
        self, places: Sequence[int], weights: FloatArray, errors: Errors | None = None
    ) -> Iterator[Sum]:
        """Yield the sums of an elimination of these terms (Wald's test), from the sum with one term to the sum with all
        terms. `weights` are the weights of rows."""
        path = self._path(places, weights, errors, steps=len(places))
        squares, price = path.squares.tolist(), 0.0
        for step in reversed(range(len(places))):
            price += self._prices[places[path.order[step]]]
            nats = 0.5 * self.rows.numbers * log(max(squares[step], self.rows.least)) + price
            yield Sum(self, tuple(places[index] for index in path.remaining(step)), path.factors(step), nats)

    def _best_sum(self, start: Sequence[int], weights: FloatArray, *, is_extended: bool) -> Sum:
        """Return the sum with the shortest description that an elimination from the terms of `start` finds.

        If `is_extended`, single terms are added again, as long as the gain is larger than a gain by chance
        (Bonferroni).
        """
        every = range(len(self.atoms))
        errors = self._errors(weights, every if is_extended else start)

        def best(places: Sequence[int]) -> Sum:
            return min([*self.elimination_path(places, weights, errors)][::-1], key=lambda fit: fit.nats)

        def longer(fit: Sum) -> Iterator[Sum]:
            candidates = [place for place in every if place not in fit.kept]
            if candidates:
                lengths = self._lengths_with_each(fit.kept, candidates, weighted, errors)
                place = min(zip(lengths, candidates, strict=True))[1]
                yield self._assess_sum(best(sorted([*fit.kept, place])))

        found, weighted = best(start), (self._columns * weights, self.rows.sides * weights)
        return descend(self._assess_sum(found), longer, log(float(len(every)))) if is_extended else found

    def _lengths_with_each(
        self, kept: Sequence[int], candidates: Sequence[int], weighted: tuple[FloatArray, FloatArray],
        errors: Errors | None,
    ) -> list[float]:  # fmt: skip
        """Return for each of the candidates the nats of the shortest sum in an elimination of the terms `kept` and the
        candidate. `weighted` are the weighted columns (K, N) and sides (N,)."""
        products, cross = (np.zeros((0, 0)), np.zeros(0)) if errors is None else errors
        lengths = np.zeros(len(candidates))
        find_shortest_with_each(
            *weighted, products, cross, np.array(kept, np.int64), np.array(candidates, np.int64),
            np.array(self._prices), float(self.rows.numbers), self.rows.least, lengths,
        )  # fmt: skip
        return lengths.tolist()

    def _assess_sum(self, fit: Sum) -> Sum:
        assessment = self._assess(fit)
        nats = math.inf if assessment is None else assessment.misfit + self._price(fit.kept)
        return Sum(self, fit.kept, fit.coefficients, nats, assessment)

    def residuals(self, fit: Sum) -> FloatArray:
        """Return the residuals (N,) of a sum."""
        residuals = self.rows.sides.copy()
        for coefficient, place in zip(fit.coefficients, fit.kept, strict=True):
            residuals -= coefficient * self._columns[place]
        return residuals

    def _assess(self, fit: Sum) -> Assessment | None:
        return self.rows.assess(fit.atoms, fit.coefficients, self.residuals(fit))

    def _price(self, places: Sequence[int]) -> float:
        return math.fsum(self._prices[place] for place in places)

    def _errors(self, weights: FloatArray, places: Sequence[int]) -> Errors | None:
        """Return the covariances of the errors of these terms, summed over the rows; 0 for all other terms."""
        if self._gradients is None:
            return None
        chosen = list(places)
        own = self.rows.errors(self._gradients[chosen], weights)
        products, cross = np.zeros((len(self.atoms), len(self.atoms))), np.zeros(len(self.atoms))
        products[np.ix_(chosen, chosen)], cross[chosen] = own
        return products, cross

    def _path(self, places: Sequence[int], weights: FloatArray, errors: Errors | None, steps: int) -> Elimination:
        chosen = np.asarray(places, dtype=np.int64)
        own = None if errors is None else (errors[0][np.ix_(chosen, chosen)], errors[1][chosen])
        return eliminate_columns(self._columns[chosen] * weights, self.rows.sides * weights, own, steps)
