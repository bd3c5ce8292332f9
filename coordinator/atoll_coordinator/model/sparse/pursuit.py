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
from functools import partial
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
_RANKED_PAIRS: Final = 2000
"""Number of pairs of atoms that are sorted: one pair of shapes gives dozens of pairs with different inner constants."""
_MOST_ATOMS: Final = SETTINGS.sparse.most_atoms // 10
"""Most atoms of a dictionary, and most atoms for which pairs are tried: the matrix of the gains of all pairs takes 128
MB. With all operators, a dictionary for two states has 1,570 atoms, for three states 3,980."""

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
        both = wider.refit(range(len(wider.atoms)), fit.assessment.weights) if wider.is_solvable else None
        if both is None:
            break
        factors, slopes = both.coefficients, iter(both.coefficients[len(atoms) :])
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
        columns, values, errors = rows.columns(atoms), rows.sides, rows.side_errors
        missing, weights = float(values.std()), np.ones(len(values))
        for _ in range(SETTINGS.effort.steps):
            weights = 1.0 / np.sqrt(errors**2 + missing**2)
            left = values - coefficients_of(columns * weights, values * weights) @ columns
            square = (NORMAL_DEVIATION * float(np.median(np.abs(left)))) ** 2 - float(np.median(errors)) ** 2
            before, missing = missing, math.sqrt(max(square, 0.0))
            if abs(missing - before) <= 1e-2 * before:
                break
        sizes = np.sqrt(((columns * weights) ** 2).sum(axis=1))[:, None]
        basis = np.linalg.qr((columns * weights / np.where(sizes > 0.0, sizes, 1.0)).T)[0]
        left = values * weights
        for _ in range(2):  # the second time for rounding errors of the first
            left = left - basis @ (basis.T @ left)
        self.squares, self._basis, self._left = weights**2, weights[:, None] * basis, weights * left
        self._squared_residuals = max(float(left @ left), 1e-300)

    @property
    def vectors(self) -> FloatArray:
        """The residuals, divided by their length, and an orthonormal basis of the terms; both weighted: (1 + K, N)."""
        return np.vstack([self._left / math.sqrt(self._squared_residuals), self._basis.T])

    def gains(self, columns: FloatArray) -> FloatArray:
        """Return the share (A,) of the squared residuals that each of the columns (A, N) explains. The share is 0 if
        the part of the column orthogonal to the terms is a rounding error."""
        gains = (columns @ self._left / self._norms(columns)) ** 2 / self._squared_residuals
        return np.asarray(np.where(np.isfinite(gains), gains, 0.0))

    def gains_of_pairs(self, columns: FloatArray) -> FloatArray:
        """Return the share (A, A) of the squared residuals that columns i and j (A, N) explain together. Elements with
        i >= j are 0.

        The parts of the two columns orthogonal to the terms are scaled to unit length. Their scalar products with the
        residuals are a and b, and their scalar product with each other is c. Together they explain (a^2 + b^2 - 2 a b
        c)/(1 - c^2).
        """
        norms, along = self._norms(columns), columns @ self._basis
        products = columns @ self._left / norms
        cosines = ((columns * self.squares) @ columns.T - along @ along.T) / np.outer(norms, norms)
        free = 1.0 - cosines * cosines
        gains = (products[:, None] ** 2 + products**2 - 2.0 * np.outer(products, products) * cosines) / free
        return np.asarray(np.triu(np.where(free > _NEARLY_ALIKE, gains, 0.0), 1) / self._squared_residuals)

    def _norms(self, columns: FloatArray) -> FloatArray:
        """Return the lengths (A,) of the parts of columns that are orthogonal to the terms. The length is infinite if
        the part is a rounding error."""
        squares = columns**2 @ self.squares
        orthogonal = squares - ((columns @ self._basis) ** 2).sum(axis=1)
        return np.asarray(np.sqrt(np.where(orthogonal > _SMALLEST_PART * squares, orthogonal, math.inf)))


Grid = tuple[Sequence[Atom], FloatArray]
"""Terms with inner constants from a grid, and their columns (A, N)."""


def make_grid(rows: RegressionRows, shapes: Iterable[Shape]) -> Grid:
    """Return a term for each shape and each start value of its inner constant, if its values are finite."""
    with np.errstate(all="ignore"):
        pairs = [(atom, atom.values) for shape in shapes for atom in map(partial(Atom, shape), shape.constants())]
    pairs = [(atom, values) for atom, values in pairs if np.isfinite(values).all()]
    values = np.array([values for _, values in pairs]).reshape(len(pairs), rows.inputs.shape[1])
    return [atom for atom, _ in pairs], rows.columns_of(values)


def rank_further_terms(
    rows: RegressionRows, sums: Sequence[Sequence[Atom]], grid: Grid, count: int
) -> Iterator[list[tuple[float, Atom]]]:
    """Yield for each of the sums `sums` the `count` best further terms of a grid, as pairs (share of squared residuals
    explained, term)."""
    atoms, columns = grid
    for own in sums:
        found: dict[Shape, tuple[float, Atom]] = {}
        gains = ResidualGains(rows, own).gains(columns) if atoms else np.zeros(0)
        for place in np.argsort(-gains, kind="stable").tolist():
            found.setdefault(atoms[place].shape, (float(gains[place]), atoms[place]))
        yield sorted((pair for pair in found.values() if pair[0] > 0.0), key=lambda pair: -pair[0])[:count]


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
        if has_pairs and 0 < len(self._grid[0]) <= _MOST_ATOMS:
            grown += self._pairs()
        by_terms: dict[_Terms, tuple[Atom, ...]] = {}
        for _, atoms in sorted(grown, key=lambda pair: pair[0]):
            if self._is_short(atoms):
                by_terms.setdefault(_terms(atoms), atoms)
        return self._shortest(self._fit_sums([*by_terms.values()][:width]))

    def _pairs(self) -> Iterator[tuple[float, tuple[Atom, ...]]]:
        """Yield the best pairs of terms, as (squared residuals, pair)."""
        atoms, columns = self._grid
        gains = ResidualGains(self._rows, ()).gains_of_pairs(columns)
        count, square = min(_RANKED_PAIRS, gains.size), float(self._rows.sides @ self._rows.sides)
        least = -np.partition(-gains, count - 1, axis=None)[count - 1]
        best = np.flatnonzero((gains >= least) & (gains > 0.0))
        for share, place in zip(gains.flat[best].tolist(), best.tolist(), strict=True):
            first, second = divmod(place, len(atoms))
            yield square * (1.0 - share), (atoms[first], atoms[second])

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
