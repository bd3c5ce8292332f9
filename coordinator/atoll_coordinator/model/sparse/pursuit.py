"""Matching pursuit: it decides which functions are added to a sum, and fits their inner constants.

How it works. The terms that explain most of the residuals are added to a sum (orthogonal matching pursuit, Pati et al.
1993), with inner constants from a grid; then all constants are fitted together. `many_variables` finds laws in this
way. `pursue` finds candidates for trajectories: a polynomial and up to two products with functions; a few best sums are
kept after each addition. Then terms are eliminated one after another. The sum has the polynomial from the beginning, so
that a function is not chosen only because a polynomial term is missing. Pursuit also finds laws with two such
functions. A search that changes one node at a time can reach these laws only through worse equations.

Doubts. Targets are smoothed derivatives, whose errors are not known for each row. So all rows have equal weights. The
best sums of each length are returned; other modules compare them along trajectories.

Letters: A atoms, K terms, N rows.
"""

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np

from atoll_coordinator.model.batches import BatchFunction
from atoll_coordinator.model.least_squares import coefficients_of
from atoll_coordinator.model.sparse.atoms import Atom, Shape, powers, products, products_with_functions
from atoll_coordinator.model.sparse.kernels.elimination import explained_shares
from atoll_coordinator.model.sparse.regression import SparseRegression, Sum
from atoll_coordinator.model.sparse.rows import NORMAL_DEVIATION, RegressionRows
from atoll_coordinator.model.thinning import thinned_places
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, Problem
from atoll_core.expression.kernels.tape import Ints
from atoll_core.expression.operators import ADD, MULTIPLY
from atoll_core.expression.program import Program, operators_in

_SHARES_OF_STEPS = (1.0, 0.3, 0.1)
"""Shares of a step. They are tried one after another until a share makes the description shorter."""
_SMALLEST_PART = 1e-13
"""A column has a part that is orthogonal to the terms. If the squared length of this part is below this share of the
column's squared length, the part is a rounding error."""
_NEARLY_ALIKE = 1e-8
"""A pair of columns is not tried if the squared sine of the angle between them is smaller, since rounding errors would
decide the rank of this pair."""
_MOST_ATOMS: Final = SETTINGS.sparse.most_atoms // 10
"""Most atoms of a dictionary: the time for all pairs grows with the square of their number. With all operators, a
dictionary for two states has 1,570 atoms, for three states 3,980."""
_BLOCK: Final = 128
"""Number of columns that are compared with all columns at a time: the sums of a block stay in the second cache."""

# --------------------------------------------------------------------------------------------- a sum with constants


def fit_sum(rows: RegressionRows, atoms: Sequence[Atom], shared: frozenset[Atom] = frozenset()) -> Sum | None:
    """Return the sum of all these terms with fitted coefficients and unchanged inner constants. None if the rows do not
    determine the coefficients."""
    regression = SparseRegression(rows, atoms, shared)
    return regression.refit(range(len(atoms)), 1.0 / rows.side_errors) if regression.is_solvable else None


def fit_inner_constants(fit: Sum) -> Sum:
    """Return the sum with fitted inner constants. They are fitted by Gauss-Newton steps of all constants together.

    The derivatives of terms by their inner constants are treated as further terms, with their own errors.
    """
    rows, shared = fit.regression.rows, fit.regression.shared
    inner = [place for place, atom in enumerate(fit.atoms) if atom.shape.has_constant and atom not in shared]
    for _ in range(SETTINGS.effort.steps if inner else 0):
        assert fit.assessment is not None
        atoms = fit.atoms
        wider = SparseRegression(rows, [*atoms, *(atoms[place].derivative_by_constant() for place in inner)])
        factors = wider.refit_coefficients(fit.assessment.weights) if wider.is_solvable else None
        if factors is None:
            break
        slopes = iter(factors[len(atoms) :])
        steps = {place: next(slopes) / factors[place] if factors[place] else 0.0 for place in inner}
        better = None
        for share in _SHARES_OF_STEPS:
            moved = [
                atom.move_constant(share * steps[place]) if place in steps else atom for place, atom in enumerate(atoms)
            ]
            regression = SparseRegression(rows, moved, shared)
            if regression.is_solvable:
                better = regression.refit(range(len(moved)), fit.assessment.weights)
            if better is not None and better.nats <= fit.nats:
                break
        if better is None or not better.nats <= fit.nats:
            break
        gain, fit = fit.nats - better.nats, better
        if gain < SETTINGS.selection.least_gain:
            break
    return fit


# ------------------------------------------------------------------------------------------------ one term more


class ResidualGains:
    """Computes the share of the squared residuals of a sum that a further term explains. Rows are weighted by their
    errors and by missing terms. The variance of the missing terms is assumed to be equal on all rows. It is estimated
    from the median absolute residual, as for normal residuals.

    Args:
        rows: the rows with the left sides.
        atoms: terms of the sum, on these rows.
    """

    def __init__(self, rows: RegressionRows, atoms: Sequence[Atom]) -> None:
        columns = rows.columns(atoms)
        self._weights = _weights_with_missing_terms(rows, columns)
        sizes = np.sqrt(((columns * self._weights) ** 2).sum(axis=1))[:, None]
        self._basis = np.linalg.qr((columns * self._weights / np.where(sizes > 0.0, sizes, 1.0)).T)[0].T
        left = rows.sides * self._weights
        for _ in range(2):  # the second time for rounding errors of the first
            left = left - (self._basis @ left) @ self._basis
        self._residuals = left / math.sqrt(max(float(left @ left), 1e-300))

    @property
    def squares(self) -> FloatArray:
        """The weights (N,) of squared columns."""
        return np.asarray(self._weights**2)

    @property
    def vectors(self) -> FloatArray:
        """The residuals, divided by their length, and an orthonormal basis of the terms; both weighted: (1 + K, N)."""
        return np.asarray(self._weights * np.vstack([self._residuals, self._basis]))

    def gains(self, columns: FloatArray) -> FloatArray:
        """Return the share (A,) of the squared residuals that each of the columns (A, N) explains. The share is 0 if
        the part of the column orthogonal to the terms is a rounding error."""
        return np.asarray(gains_of_terms([self], columns)[0])

    def orthogonal_parts(self, columns: FloatArray) -> "OrthogonalParts":
        """Return the parts of the columns (A, N) that are orthogonal to the terms, scaled to unit length. A part that
        is a rounding error becomes 0."""
        parts = columns * self._weights
        squares = (parts**2).sum(axis=1)
        parts -= (parts @ self._basis.T) @ self._basis
        orthogonal = (parts**2).sum(axis=1)
        parts /= np.sqrt(np.where(orthogonal > _SMALLEST_PART * squares, orthogonal, math.inf))[:, None]
        return OrthogonalParts(parts, parts @ self._residuals)


def _weights_with_missing_terms(rows: RegressionRows, columns: FloatArray) -> FloatArray:
    """Return the weights (N,) of rows for sums of `columns` (K, N), see `ResidualGains`. If all errors are equal, all
    weights are 1, because a common factor changes no share."""
    values, errors = rows.sides, rows.side_errors
    missing, weights = float(values.std()), np.ones(len(values))
    for _ in range(0 if (errors == errors[0]).all() else SETTINGS.effort.steps):
        weights = 1.0 / np.sqrt(errors**2 + missing**2)
        left = values - coefficients_of(columns * weights, values * weights) @ columns
        square = (NORMAL_DEVIATION * float(np.median(np.abs(left)))) ** 2 - float(np.median(errors)) ** 2
        before, missing = missing, math.sqrt(max(square, 0.0))
        if abs(missing - before) <= 1e-2 * before:
            break
    return weights


@dataclass(frozen=True, eq=False)
class OrthogonalParts:
    """Unit vectors `parts` (A, N), and their scalar products (A,) with the normalised residuals."""

    parts: FloatArray
    along: FloatArray

    def __getitem__(self, places: slice | Ints) -> "OrthogonalParts":
        return OrthogonalParts(self.parts[places], self.along[places])

    def gains_with(self, others: "OrthogonalParts") -> FloatArray:
        """Return the share (A, B) of the squared residuals that each of these vectors explains together with each of
        the others.

        Two vectors have the scalar products a and b with the residuals, and c with each other. Together they explain
        a^2 + (b - a c)^2/(1 - c^2). The share is 0 if they are nearly parallel.
        """
        gains = self.parts @ others.parts.T
        free = 1.0 - gains * gains
        is_free = free > _NEARLY_ALIKE
        gains *= others.along
        np.subtract(self.along[:, None], gains, out=gains)
        gains *= gains
        np.divide(gains, free, out=gains, where=is_free)
        gains += others.along**2
        gains *= is_free
        return gains


def gains_of_terms(sums: Sequence[ResidualGains], columns: FloatArray) -> FloatArray:
    """Return the share (S, A) of the squared residuals of each of the sums that each of the columns (A, N) explains.
    The share is 0 if the part of the column orthogonal to the terms is a rounding error."""
    vectors, squares = [one.vectors for one in sums], np.array([one.squares for one in sums]).T
    first = np.cumsum([0, *map(len, vectors[:-1])])
    stacked, gains = np.ascontiguousarray(np.concatenate(vectors).T), np.empty((len(columns), len(sums)))
    for start in range(0, len(columns), _BLOCK):
        block = columns[start : start + _BLOCK]
        along, sizes = (block @ stacked) ** 2, block**2 @ squares
        explained = along[:, first]
        orthogonal = sizes + explained - np.add.reduceat(along, first, axis=1)
        is_free = orthogonal > _SMALLEST_PART * sizes
        gains[start : start + _BLOCK] = np.where(is_free, explained / np.where(is_free, orthogonal, 1.0), 0.0)
    return np.ascontiguousarray(gains.T)


@dataclass(frozen=True, eq=False)
class Grid:
    """Terms with inner constants from a grid, `atoms`, and their columns (A, N). The terms of a shape are consecutive;
    `first` (S,) has the place of the first term of each shape."""

    atoms: Sequence[Atom]
    columns: FloatArray
    first: Ints

    @cached_property
    def shapes(self) -> list[Shape]:
        """The shapes (S,) that have terms."""
        return [self.atoms[place].shape for place in self.first.tolist()]

    @cached_property
    def ranges(self) -> list[slice]:
        """The places of the terms of each shape."""
        return [slice(*ends) for ends in pairwise([*self.first.tolist(), len(self.atoms)])]


def make_grid(rows: RegressionRows, shapes: Iterable[Shape]) -> Grid:
    """Return a term for each shape and each start value of its inner constant, if its values are finite.

    The values of a function are computed once for all its products.
    """
    functions: dict[tuple[int, int, float], FloatArray] = {}
    atoms, columns, first = list[Atom](), list[FloatArray](), list[int]()
    for shape in shapes:
        begin = len(atoms)
        for constant in shape.constants():
            values = shape.product
            if shape.function is not None:
                key = (id(shape.function), id(shape.u), constant)
                if key not in functions:
                    functions[key] = shape.function_values(constant)
                values = values * functions[key]
            if np.isfinite(values).all():
                atoms.append(Atom(shape, constant))
                columns.append(values)
        first += [begin] if len(atoms) > begin else []
    stacked = np.array(columns).reshape(len(atoms), rows.inputs.shape[1])
    return Grid(atoms, rows.columns_of(stacked), np.array(first, np.int64))


def rank_further_terms(
    rows: RegressionRows, sums: Sequence[Sequence[Atom]], grid: Grid, count: int
) -> Iterator[list[tuple[float, Atom]]]:
    """Yield for each of the sums `sums` the `count` best further terms of a grid, the best term of a shape each, as
    pairs (share of squared residuals explained, term)."""
    if not (sums and grid.atoms):
        yield from ([] for _ in sums)
        return
    ranges = grid.ranges
    for gains in gains_of_terms([ResidualGains(rows, atoms) for atoms in sums], grid.columns):
        best = np.maximum.reduceat(gains, grid.first)
        shapes = [shape for shape in np.argsort(-best, kind="stable")[:count].tolist() if best[shape] > 0.0]
        places = [ranges[shape].start + int(np.argmax(gains[ranges[shape]])) for shape in shapes]
        yield [(float(gains[place]), grid.atoms[place]) for place in places]


def rank_pairs(
    gains: ResidualGains, grid: Grid, prices: FloatArray, most: float, count: int
) -> Iterator[tuple[float, tuple[Atom, Atom]]]:
    """Yield the `count` best pairs of terms of a grid, the best pair of two shapes each, as (share of squared residuals
    explained, pair).

    `prices` (S,) are the prices of the shapes; only pairs whose price is at most `most` are computed. Shapes are sorted
    by price, so that the possible partners of a shape are consecutive. The gains of all terms of two shapes are
    computed in blocks that fit into the cache. Only the largest gain of two shapes is kept, and the gains of the best
    shapes are computed again.
    """
    order = np.argsort(prices, kind="stable")
    prices, ranges = prices[order], [grid.ranges[shape] for shape in order.tolist()]
    vectors = gains.orthogonal_parts(np.concatenate([grid.columns[places] for places in ranges]))
    first = np.cumsum([0, *(places.stop - places.start for places in ranges)])
    best, begin = np.zeros((len(order), len(order))), 0
    while begin < len(order) and 2.0 * prices[begin] <= most:
        end = max(int(np.searchsorted(first, first[begin] + _BLOCK, side="right")) - 1, begin + 1)
        last = max(int(np.count_nonzero(prices + prices[begin] <= most)), end)
        block = vectors[first[begin] : first[last]].gains_with(vectors[first[begin] : first[end]])
        _keep_below_diagonal(block)
        over_rows = np.maximum.reduceat(block, first[begin:last] - first[begin], axis=0)
        best[begin:last, begin:end] = np.maximum.reduceat(over_rows, first[begin:end] - first[begin], axis=1)
        begin = end
    best[prices[:, None] + prices > most] = 0.0
    for place in np.argsort(-best, axis=None, kind="stable")[:count].tolist():
        one, other = divmod(place, len(order))
        if not best[one, other] > 0.0:
            break
        block = vectors[first[one] : first[one + 1]].gains_with(vectors[first[other] : first[other + 1]])
        if one == other:
            _keep_below_diagonal(block)
        row, column = divmod(int(np.argmax(block)), block.shape[1])
        terms = sorted((ranges[one].start + row, ranges[other].start + column))
        yield float(block[row, column]), (grid.atoms[terms[0]], grid.atoms[terms[1]])


def _keep_below_diagonal(block: FloatArray) -> None:
    """Set the elements of the block (A, B), A >= B, on and above the diagonal to 0."""
    block[np.triu_indices(block.shape[1])] = 0.0


def rank_functions(
    rows: RegressionRows, sums: Sequence[Sequence[Atom]], shapes: Sequence[Shape], count: int
) -> list[list[Atom]]:
    """Return for each of the sums `sums` the `count` best further terms among products with functions, `shapes`, each
    with the best of the start values of its inner constant.

    The values of a function are computed once for all its products.
    """
    if not (shapes and sums):
        return [[] for _ in sums]
    all_gains = [ResidualGains(rows, atoms) for atoms in sums]
    squares, vectors = np.array([one.squares for one in all_gains]), [one.vectors for one in all_gains]
    counts, stacked = np.array([len(one) for one in vectors]), np.concatenate(vectors)
    by_function: dict[tuple[int, int], list[int]] = {}
    for place, shape in enumerate(shapes):
        by_function.setdefault((id(shape.function), id(shape.u)), []).append(place)
    shares, best = np.zeros((len(sums), len(shapes))), np.zeros((len(sums), len(shapes)))
    for places in by_function.values():
        constants = np.array(shapes[places[0]].constants())
        if not len(constants):
            continue
        with np.errstate(all="ignore"):
            functions = np.array([shapes[places[0]].function_values(constant) for constant in constants.tolist()])
        factors = np.array([shapes[place].product for place in places])
        gains = np.zeros((len(sums), *factors.shape[:1], *functions.shape[:1]))
        explained_shares(
            factors, functions, *rows.windows, squares, stacked, counts, _SMALLEST_PART, gains
        )  # fmt: skip
        shares[:, places], best[:, places] = gains.max(axis=2), constants[gains.argmax(axis=2)]
    return [
        [Atom(shapes[place], constant[place]) for place in np.argsort(-own, kind="stable")[:count] if own[place] > 0.0]
        for own, constant in zip(shares, best.tolist(), strict=True)
    ]


# ------------------------------------------------------------------------------------- candidates for trajectories

_DEGREE: Final = SETTINGS.sparse.degree - 1
"""Highest degree of the polynomial to which functions are added. Functions are multiplied by products of a degree that
is one lower."""

_Terms = tuple[int, ...]


def pursue(
    problem: Problem, columns: Sequence[int], operators: Collection[int], needed: Collection[int] = (),
    most: float = math.inf,
) -> list[Program]:  # fmt: skip
    """Return the sums with the smallest residuals, a few sums for each number of constants. Their constants are fitted.

    Args:
        problem: a target and its inputs; a subset of the rows is used.
        columns: indices of the variables that may be used.
        operators: codes of the operators that may be used.
        needed: operator codes; each sum must have at least one of them. Empty: no condition.
        most: sums are dropped if the price of their terms and constants is more than this many nats.
    """
    if not {ADD, MULTIPLY} <= set(operators) or not columns:
        return []
    places = thinned_places(problem.inputs.shape[1], SETTINGS.sparse.rows)
    error = problem.target.uncertainty * problem.target.standard_deviation
    inputs = np.ascontiguousarray(problem.inputs[:, places])
    rows = RegressionRows(inputs, problem.target.values[places], least=max(len(places) * error * error, 1e-300))
    with np.errstate(all="ignore"):
        return _Pursuit(rows, columns, operators, frozenset(needed), most).run()


@dataclass(frozen=True, eq=False)
class Pursuit:
    """The search space of a pursuit, see `pursue`."""

    columns: tuple[int, ...]
    operators: frozenset[int]
    needed: frozenset[int] = frozenset()
    most: float = math.inf


PURSUED: Final[BatchFunction[Problem, Pursuit, tuple[Program, ...]]] = BatchFunction(
    "pursued sums", Problem, Pursuit, tuple[Program, ...],
    lambda problem, of: tuple(pursue(problem, of.columns, of.operators, of.needed, of.most)),
)  # fmt: skip
"""The batch function: it returns the sums with the smallest residuals of a target, from the search space of a
pursuit."""


class _Pursuit:
    def __init__(
        self,
        rows: RegressionRows,
        columns: Sequence[int],
        operators: Collection[int],
        needed: frozenset[int],
        most: float,
    ) -> None:
        self._rows, self._needed = rows, needed
        self._sums: dict[_Terms, Sum] = {}
        shapes = powers(rows.inputs, products(columns, _DEGREE))
        shapes += products_with_functions(rows.inputs, columns, operators, _MOST_ATOMS)
        self._prices = {shape: shape.price(rows.independent) for shape in shapes}
        needed_prices = [price for shape, price in self._prices.items() if self._is_needed(shape)]
        needed_price = min(needed_prices, default=math.inf) if needed else 0.0
        self._most = most + needed_price
        """Largest price of a sum. It is above the limit, because a sum may be short enough after a term is
        eliminated."""
        self._tried = [
            shape
            for shape, price in self._prices.items()
            if price + (0.0 if self._is_needed(shape) else needed_price) <= most
        ]
        self._grid = make_grid(rows, self._tried)

    def _is_needed(self, shape: Shape) -> bool:
        return not self._needed or not self._needed.isdisjoint(operators_in(shape.expression(1.5)))

    def run(self) -> list[Program]:
        """Return the best sums of each number of constants."""
        for beginning in self._starting_sums():
            beam = [beginning]
            for turn in range(SETTINGS.sparse.functions + (not beginning.kept)):
                if not (beam and self._is_short(beam[0].atoms)) or self._squared_residuals(beam[0]) <= self._rows.least:
                    break
                beam = self._extend(beam, has_pairs=turn == 1 and not beginning.kept)
        self._extend(self._fit_sums(fit.atoms for fit in self._shortest(self._sums.values())))
        by_size: dict[int, list[Sum]] = {}
        for fit in self._sums.values():
            if self._is_short(fit.atoms) and any(self._is_needed(atom.shape) for atom in fit.atoms):
                by_size.setdefault(sum(1 + atom.shape.has_constant for atom in fit.atoms), []).append(fit)
        sizes = [size for size in sorted(by_size) if size <= SETTINGS.sparse.most_constants]
        best = (self._fit_sums(fit.atoms for fit in self._shortest(by_size[size], 2)) for size in sizes)
        return [fit.program() for fits in best for fit in self._shortest(fits)]

    def _starting_sums(self) -> Iterator[Sum]:
        """Yield the first sums: polynomials that the rows determine and that are short enough for elimination."""
        most = min(SETTINGS.effort.longest_sum, len(self._rows.sides) / SETTINGS.sparse.rows_per_term)
        plain = [Atom(shape) for shape in self._tried if shape.function is None]
        for degree in range(-1, _DEGREE + 1):
            atoms = [atom for atom in plain if len(atom.shape.factors) <= degree]
            if len(atoms) <= most:
                yield from self._fit_sums([atoms])

    def _extend(self, beam: Sequence[Sum], *, has_pairs: bool = False) -> list[Sum]:
        """Return the best sums with one more term than the sums of the beam. If `has_pairs`, sums of any two terms are
        also tried."""
        width, grown = SETTINGS.effort.kept, list[tuple[float, tuple[Atom, ...]]]()
        further = rank_further_terms(self._rows, [fit.atoms for fit in beam], self._grid, width)
        for fit, terms in zip(beam, further, strict=True):
            square = self._squared_residuals(fit)
            grown += [(square * (1.0 - share), (*fit.atoms, atom)) for share, atom in terms]
        if has_pairs and self._grid.atoms:
            square = float(self._rows.sides @ self._rows.sides)
            prices = np.array([self._prices[shape] for shape in self._grid.shapes])
            pairs = rank_pairs(ResidualGains(self._rows, ()), self._grid, prices, self._most, width)
            grown += [(square * (1.0 - share), pair) for share, pair in pairs]
        by_terms: dict[_Terms, tuple[Atom, ...]] = {}
        for _, atoms in sorted(grown, key=lambda pair: pair[0]):
            if self._is_short(atoms):
                by_terms.setdefault(_terms(atoms), atoms)
        return self._shortest(self._fit_sums([*by_terms.values()][:width]))

    def _is_short(self, atoms: Sequence[Atom]) -> bool:
        return math.fsum(self._prices[atom.shape] for atom in atoms) <= self._most

    def _fit_sums(self, sums: Iterable[Sequence[Atom]]) -> list[Sum]:
        """Return the sums of these terms with all constants fitted. The smaller sums, from which terms were eliminated,
        are also stored."""
        fits = [fit_inner_constants(fit) for fit in (fit_sum(self._rows, atoms) for atoms in sums) if fit is not None]
        for fit in fits:
            for shorter in fit.regression.elimination_path(range(len(fit.atoms)), np.ones(len(self._rows.sides))):
                key = _terms(shorter.atoms)
                if key not in self._sums or shorter.nats < self._sums[key].nats:
                    self._sums[key] = shorter
        return fits

    def _shortest(self, fits: Iterable[Sum], width: int = 1) -> list[Sum]:
        return sorted(fits, key=lambda fit: fit.nats)[: width * SETTINGS.effort.beam]

    def _squared_residuals(self, fit: Sum) -> float:
        residuals = fit.regression.residuals(fit)
        return float(residuals @ residuals)


def _terms(atoms: Sequence[Atom]) -> _Terms:
    """Return a key that is equal for sums with the same shapes; their constants do not matter."""
    return tuple(sorted(id(atom.shape) for atom in atoms))
