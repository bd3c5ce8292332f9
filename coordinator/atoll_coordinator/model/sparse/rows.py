"""Builders of rows for the equation of one state: left sides, columns of terms, and the covariance of the errors of
both.

- `RegressionRows` have columns without errors: targets, bins of the steps of a process.
- `RateRows` are estimated derivatives with a standard error for each row. These errors are systematic: all errors
  together count as `systematic_numbers` independent numbers, for any number of rows. A few errors are a hundred times
  as large as estimated.
- `WeakRows` are integrals over windows of the trajectories, so that no data are differentiated. A test function b
  vanishes at both ends of a window. The law dx/dt = sum c_k f_k is multiplied by b and integrated by parts:

      - int b' x dt = sum c_k int b f_k dt

  (Messenger & Bortz 2021). Powers of measured states are replaced by Hermite polynomials, which depend on the variance
  of the noise. Then the expectation of a product of measured states is the product of the true states. The variance of
  a residual follows from the variance of the measurements (errors in variables: Bortz, Messenger & Dukic 2023), so that
  a test can tell whether residuals are noise. Windows here are long and use the trapezoidal rule; `many_variables` has
  short windows.

Letters: K terms, N rows of a regression, W windows of L rows, R rows of all trajectories, T some of these, V variables.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, Final, Generic, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from atoll_coordinator.data.differentiation.interpolation import estimate_value_noise, make_signal, predict_left_out
from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.recording import Recording, StateSmoothing, Trajectory
from atoll_coordinator.model.description_length import log
from atoll_coordinator.model.sparse.atoms import Atom, Product
from atoll_coordinator.model.sparse.kernels.elimination import (
    spread_window_weights,
    sum_error_products,
    windowed_sums,
)
from atoll_coordinator.model.thinning import thinned_places
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

CAUCHY = 2.385
"""A residual of this many standard errors has half the weight. With this value, the estimate is 95 % efficient for
normal errors (Holland & Welsch 1977)."""
NORMAL_DEVIATION = 1.4826
"""The standard deviation of normal errors divided by their median absolute value."""
_LEAST_SCALE = 1e-6
"""Guard: smaller residuals, in standard errors, are rounding errors."""
_STRETCHES = 20
"""Number of blocks of rows that represent a larger table: a law of a hundred products needs a few hundred windows."""
_SMOOTHNESS = 4
"""Numerics: the power p of the test functions (1 - s^2)^p. It determines how fast the error of the trapezoidal rule
decreases with the time step."""
_LEAST_HALF = 5
"""Numerics: half width of the shortest window, in rows; nine rows of the window have weights. A left side has an error
by the trapezoidal rule and an error by noise. If the noise is `_LEAST_HALF_NOISE`, a share of the standard deviation,
the first is a tenth of the second (from the Fourier transform of (1 - s^2)^4 at one wave per row)."""
_LEAST_HALF_NOISE = 0.01

Errors = tuple[FloatArray, FloatArray]
"""Covariances of errors, summed over rows: the covariances (K, K) of columns with each other, and the covariances (K,)
of columns with the left sides, with the opposite sign."""


@dataclass(frozen=True, eq=False)
class Assessment:
    """The residuals of a sum compared with their errors: the `weights` (N,) of rows, and the `misfit` in nats.

    `excess` is the ratio of the residuals to their errors; `probability` is the probability of residuals at least this
    large, if all residuals are noise (1: it is not known).
    """

    weights: FloatArray
    misfit: float
    excess: float
    probability: float = 1.0


@dataclass(frozen=True, eq=False)
class RegressionRows:
    """Rows to which a sum of terms is fitted. Columns have no errors, and the variance of residuals is fitted.

    `inputs` (V, R) are the values of the variables at which atoms are evaluated, and `sides` (N,) are the left sides. A
    sum of squared residuals below `least` counts as `least`. Fits and new weights alternate, at most `reweightings`
    times. The residuals of a law are at most `largest_excess` times as large as their errors. `is_precise` tells that
    the residuals of a wrong sum are many times as large as their errors.
    """

    inputs: FloatArray
    sides: FloatArray
    least: float = field(default=1e-300, kw_only=True)
    reweightings: ClassVar[int] = 1
    largest_excess: ClassVar[float] = SETTINGS.inference.excess
    is_precise: ClassVar[bool] = False

    @property
    def independent(self) -> float:
        """Number of independent rows: rows that have no measurements in common."""
        return float(len(self.sides))

    @property
    def numbers(self) -> float:
        """Number of independent numbers in a misfit."""
        return self.independent

    @property
    def side_errors(self) -> FloatArray:
        """The standard errors (N,) of the sides, up to a common factor."""
        return np.ones(len(self.sides))

    @property
    def trusted(self) -> "RegressionRows":
        """The rows on which functions are compared."""
        return self

    def columns(self, atoms: Sequence[Atom]) -> FloatArray:
        """Return the columns (K, N) of terms."""
        return self.columns_of(np.array([atom.values for atom in atoms]).reshape(len(atoms), self.inputs.shape[1]))

    def columns_of(self, values: FloatArray) -> FloatArray:
        """Return the columns (K, N) of terms with the `values` (K, R)."""
        return values

    @property
    def windows(self) -> tuple[Ints, FloatArray]:
        """The first row (N,) of each window and the weights (N, L) of its rows; columns are sums over windows."""
        return np.arange(len(self.sides)), np.ones((len(self.sides), 1))

    def gradients(self, atoms: Sequence[Atom]) -> FloatArray | None:
        """Return the derivatives (K, V, ...) of terms by the variables. None if the variables have no errors."""
        del atoms
        return None

    def errors(self, gradients: FloatArray, weights: FloatArray) -> Errors:
        """Return the covariances of the errors of terms with these gradients, for weights (N,) of the rows."""
        raise NotImplementedError

    def assess(self, atoms: Sequence[Atom], coefficients: Sequence[float], residuals: FloatArray) -> Assessment | None:
        """Return the assessment of a sum with these `residuals` (N,); None if a residual has no variance."""
        del atoms, coefficients
        square = math.fsum((residuals * residuals).tolist())
        return Assessment(np.ones(len(residuals)), 0.5 * self.numbers * log(max(square, self.least)), math.inf)


# -------------------------------------------------------------------------------------------------- derivatives


@dataclass(frozen=True, eq=False)
class RateRows(RegressionRows):
    """Rows whose `sides` (N,) are derivatives. `uncertainty` (N,) are the standard errors of the derivatives, all above
    0; `inputs` (V, N) are the values of the variables."""

    uncertainty: FloatArray
    reweightings = SETTINGS.effort.steps
    largest_excess = 1.0
    is_precise = True

    @property
    def side_errors(self) -> FloatArray:
        """The standard errors (N,)."""
        return self.uncertainty

    @property
    def numbers(self) -> float:
        """The number of independent numbers n. It follows from the misfit of `assess`: ``systematic_numbers`` ln(scale)
        is equal to n/2 ln(scale^2)."""
        return 2.0 * SETTINGS.selection.systematic_numbers

    @property
    def trusted(self) -> "RateRows":
        """The rows with the smallest errors, a fixed share of all rows.

        Errors of interpolation are not normal: if a state changes too fast for the sampling interval, a few errors are
        a hundred times as large as estimated.
        """
        count = max(int(SETTINGS.sparse.trusted_share * len(self.sides)), 1)
        rows = self.side_errors <= np.sort(self.side_errors)[count - 1]
        return RateRows(np.ascontiguousarray(self.inputs[:, rows]), self.sides[rows], self.side_errors[rows])

    def assess(self, atoms: Sequence[Atom], coefficients: Sequence[float], residuals: FloatArray) -> Assessment:
        """Return the assessment by the scale of the residuals: the residuals divided by their standard errors, which
        are only known up to a factor.

        The scale follows from the median. The misfit is ``systematic_numbers`` ln(scale), as for normal errors of
        unknown variance. Large residuals have less weight (Cauchy).
        """
        del atoms, coefficients
        sizes = np.abs(residuals) / self.side_errors
        scale = max(NORMAL_DEVIATION * float(np.sort(sizes)[len(sizes) // 2]), _LEAST_SCALE)
        weights = 1.0 / (self.side_errors * np.sqrt(1.0 + (sizes / (CAUCHY * scale)) ** 2))
        return Assessment(weights, SETTINGS.selection.systematic_numbers * log(scale), scale)


def rate_rows(recording: Recording, names: Sequence[str], variable: str) -> RateRows | None:
    """Return the derivatives of `variable`, a state; `names` (V,) are symbols of states, rates and inputs.

    None if derivatives were not stored, or are constant. Errors are at least as large as the errors of a solver. If
    there are more rows than `RowSettings.most`, they are thinned like the rows of the search.
    """
    parts = [trajectory for trajectory in recording.trajectories if not trajectory.held_out]
    symbols = (*recording.state_symbols, *recording.velocity_symbols, *recording.input_symbols)
    places, state = [symbols.index(name) for name in names], recording.states.index(variable)
    columns, values, errors = [], [], []
    for part in parts:
        if part.rates is None or part.rate_errors is None:
            return None
        velocities = part.slopes if recording.velocity_symbols else part.slopes[:0]
        columns.append(np.concatenate([part.smoothed, velocities, part.inputs])[places])
        values.append(part.rates[state])
        ends = part.rate_errors[state]  # a single estimate may be too small: use the largest of neighbours
        wider = ends.copy()
        wider[1:] = np.maximum(wider[1:], ends[:-1])
        wider[:-1] = np.maximum(wider[:-1], ends[1:])
        errors.append(wider)
    inputs, rates, uncertainty = np.concatenate(columns, axis=1), np.concatenate(values), np.concatenate(errors)
    known = np.isfinite(uncertainty) & np.isfinite(rates) & np.isfinite(inputs).all(axis=0)
    if not known.any():
        return None
    least = SETTINGS.shooting.exact * moments(rates[known])[1]
    if not least > 0.0:
        return None
    rows = np.flatnonzero(known)
    rows = rows[thinned_places(len(rows), SETTINGS.rows.most)]
    return RateRows(np.ascontiguousarray(inputs[:, rows]), rates[rows], np.maximum(uncertainty[rows], least))


# ------------------------------------------------------------------------------------------------- measurements


@dataclass(frozen=True, eq=False)
class MeasuredRows:
    """Rows of the trajectories that are not held out: `times` (R,) are their times, and `ranges` are ranges of
    consecutive rows.

    Large tables are subsampled in evenly spread blocks.

    `values` (V, R) are the measured variables; missing values are replaced by smoothed values. `smoothed` (V, R) are
    the smoothed variables. `noise` (V,) are the standard deviations of the errors; they are 0 for inputs and for
    interpolated states.
    """

    times: FloatArray
    ranges: tuple[tuple[int, int], ...]
    values: FloatArray
    smoothed: FloatArray
    noise: FloatArray


def measured_rows_of(recording: Recording, names: Sequence[str]) -> MeasuredRows:
    """Return the rows of the variables `names` (V,), symbols of states and inputs."""
    parts = [trajectory for trajectory in recording.trajectories if not trajectory.held_out]
    symbols = (*recording.state_symbols, *recording.input_symbols)
    places = [symbols.index(name) for name in names]
    states = np.concatenate([part.measured for part in parts], axis=1)
    smoothed = np.concatenate([part.smoothed for part in parts], axis=1)
    inputs = np.concatenate([_mean_inputs(part) for part in parts], axis=1)
    if recording not in _NOISE:
        _NOISE[recording] = [_noise(parts, place, smoothing) for place, smoothing in enumerate(recording.smoothing)]
    block_ranges = _select_blocks([len(part.times) for part in parts])
    rows = np.concatenate([np.arange(first, end) for first, end in block_ranges])
    ends = np.cumsum([end - first for first, end in block_ranges]).tolist()
    return MeasuredRows(
        np.concatenate([part.times for part in parts])[rows],
        tuple(zip([0, *ends[:-1]], ends, strict=True)),
        np.concatenate([np.where(np.isfinite(states), states, smoothed), inputs])[places][:, rows],
        np.concatenate([smoothed, inputs])[places][:, rows],
        np.array([*_NOISE[recording], *([0.0] * len(inputs))])[places],
    )


_NOISE: Final = WeakKeyDictionary[Recording, list[float]]()
"""The noise of all states of a recording, see `_noise`. It is computed once for all equations. Threads may compute it
twice, with equal results."""


def _mean_inputs(part: Trajectory) -> FloatArray:
    """Return the inputs (U, R) at the rows. A step input has the mean of its values in the time steps before and after
    the row.

    The mean is weighted by the lengths of the steps. With this mean, the trapezoidal rule integrates test functions
    times a step input correctly.
    """
    held = np.asarray(np.isnan(part.input_slopes).any(axis=1))
    if not held.any():
        return part.inputs
    steps = np.diff(part.times)
    before, after = np.append(0.0, steps), np.append(steps, 0.0)
    previous = np.concatenate([part.inputs[:, :1], part.inputs[:, :-1]], axis=1)
    means = (before * previous + after * part.inputs) / (before + after)
    return np.where(held[:, None], means, part.inputs)


def _select_blocks(lengths: Sequence[int]) -> list[tuple[int, int]]:
    """Return the first row and the end of each block. The blocks represent trajectories with these `lengths`; if there
    are few rows, the blocks are whole trajectories."""
    parts = -(-sum(lengths) // SETTINGS.rows.in_sums)
    stretch = SETTINGS.rows.in_sums // _STRETCHES if parts > 1 else max(lengths)
    ends = np.cumsum(lengths).tolist()
    return [
        (first, min(first + stretch, end))
        for start, end in zip([0, *ends[:-1]], ends, strict=True)
        for first in range(start, end, stretch)
    ][::parts]


def _noise(parts: Sequence[Trajectory], place: int, smoothing: StateSmoothing) -> float:
    """Return the standard deviation of a state's errors: the smoother's noise, or the prediction error if this error is
    smaller.

    If a state changes fast, the residuals of the smoother are larger than the errors of measurement.
    """
    if smoothing.method == "interpolation" or smoothing.quantisation is not None:
        return 0.0 if smoothing.method == "interpolation" else smoothing.noise
    signals = [
        make_signal(part.times, part.measured[place].copy(), None).measured
        for part in parts
        if np.count_nonzero(np.isfinite(part.measured[place])) >= SETTINGS.common.fewest_rows
    ]
    return min(smoothing.noise, estimate_value_noise(*predict_left_out(signals))) if signals else smoothing.noise


# ---------------------------------------------------------------------------------------------------- weak form

Value = TypeVar("Value")


class OfTerms(Generic[Value]):
    """Values that were computed for terms: many regressions of one equation have the same terms.

    Products are known by their factors; functions are known as long as the term exists. Threads may compute a value
    twice, with equal results.
    """

    def __init__(self, compute: Callable[[Atom], Value]) -> None:
        self._compute = compute
        self._products: dict[Product, Value] = {}
        self._functions: WeakKeyDictionary[Atom, Value] = WeakKeyDictionary()

    def __call__(self, atom: Atom) -> Value:
        """Return the value of a term."""
        if atom.shape.function is not None:
            value = self._functions.get(atom)
            if value is None:
                value = self._functions[atom] = self._compute(atom)
            return value
        if atom.shape.factors not in self._products:
            self._products[atom.shape.factors] = self._compute(atom)
        return self._products[atom.shape.factors]


@dataclass(frozen=True, eq=False)
class WeakRows(RegressionRows):
    """Windows along trajectories for the equation of variable `target`; a `share` of the windows is independent.

    `first` (W,) is the first row of each window; `bump` and `slope` (W, L) are the test functions and their
    derivatives, multiplied by the weights of the quadrature rule. Atoms are evaluated on the measured rows.
    """

    measured: MeasuredRows
    target: int
    first: Ints
    bump: FloatArray
    slope: FloatArray
    share: float
    reweightings = 2

    @property
    def independent(self) -> float:
        """Number of independent windows: windows that have no rows in common."""
        return len(self.first) * self.share

    def columns(self, atoms: Sequence[Atom]) -> FloatArray:
        """Return the integrals (K, W) of the terms, corrected for noise in products of measured variables."""
        return np.array([self._column_of(atom) for atom in atoms]).reshape(len(atoms), len(self.first))

    def columns_of(self, values: FloatArray) -> FloatArray:
        """Return the integrals (K, W) of functions with these `values` (K, R)."""
        return self._sums(self.bump, values)

    @property
    def windows(self) -> tuple[Ints, FloatArray]:
        """The first row (W,) of each window and the weights (W, L) of its rows."""
        return self.first, self.bump

    @cached_property
    def _column_of(self) -> OfTerms[FloatArray]:
        """The integrals (W,) of a term."""

        measured, first, bump = self.measured, self.first, self.bump

        def column(atom: Atom) -> FloatArray:
            factors = atom.shape.factors
            if atom.shape.function is None:
                values = _product(factors, _powers(measured.values, measured.noise, len(factors)))
            else:
                values = atom.values
            return np.asarray(window_integrals(first, bump, values[None])[0])

        return OfTerms(column)

    @cached_property
    def _thinned(self) -> Ints:
        """Indices (T,) of the rows that represent all rows in sums of errors."""
        return thinned_places(len(self.measured.times), SETTINGS.rows.most)

    def gradients(self, atoms: Sequence[Atom]) -> FloatArray:
        """Return the derivatives (K, V, T) of terms by the variables on the thinned rows."""
        gradients = np.zeros((len(atoms), len(self.inputs), len(self._thinned)))
        for own, atom in zip(gradients, atoms, strict=True):
            self._add_slopes(own, atom, 1.0, self._thinned_slopes_of(atom))
        return gradients

    def _add_slopes(
        self, slopes: FloatArray, atom: Atom, coefficient: float, by_variable: Mapping[int, FloatArray]
    ) -> None:
        """Add the derivatives of a term, times a coefficient, to `slopes` (V, T)."""
        sizes = self.measured.noise
        for variable, part in by_variable.items():
            if atom.shape.function is None:
                slopes[variable] += coefficient * part
            else:
                slopes[variable] += coefficient * part / (2.0 * sizes[variable])

    @cached_property
    def _slopes_of(self) -> OfTerms[Mapping[int, FloatArray]]:
        """The slopes of a term on all rows, see `_slopes_on`."""
        return OfTerms(self._slopes_on(slice(None)))

    @cached_property
    def _thinned_slopes_of(self) -> OfTerms[Mapping[int, FloatArray]]:
        """The slopes of a term on the thinned rows, see `_slopes_on`."""
        if len(self._thinned) == len(self.measured.times):
            return self._slopes_of
        return OfTerms(self._slopes_on(self._thinned))

    def _slopes_on(self, rows: Ints | slice) -> Callable[[Atom], Mapping[int, FloatArray]]:
        """Return the function from a term to its slopes on some rows (T,), by variable: derivatives of a product, and
        central differences of a function, not divided by the step.

        The step is one standard deviation of the errors: this step also averages over the higher orders.
        """
        smoothed, noise = np.ascontiguousarray(self.measured.smoothed[:, rows]), self.measured.noise

        def slopes(atom: Atom) -> Mapping[int, FloatArray]:
            factors = atom.shape.factors
            if atom.shape.function is None:
                powers = _powers(smoothed, np.zeros(len(noise)), len(factors))
                return {variable: _product(factors, powers, variable) for variable in sorted({*factors})}
            found = {}
            for variable, size in enumerate(noise.tolist()):
                if size > 0.0 and atom.depends_on(variable):
                    step = np.zeros((len(noise), 1))
                    step[variable] = size
                    with np.errstate(all="ignore"):
                        found[variable] = atom.over(smoothed + step).values - atom.over(smoothed - step).values
            return found

        return slopes

    def errors(self, gradients: FloatArray, weights: FloatArray) -> Errors:
        """Return the covariances, summed over windows, of the errors of the integrals of terms with these gradients (K,
        V, T)."""
        squares, halves = self._row_weights(weights * weights)
        products, cross = np.zeros((len(gradients), len(gradients))), np.zeros(len(gradients))
        variances = self.measured.noise * self.measured.noise
        sum_error_products(np.ascontiguousarray(gradients), variances, self.target, squares, halves, products, cross)
        return products, cross

    def _row_weights(self, weights: FloatArray) -> Errors:
        """Return the weights (T,) of the errors of thinned rows: one array is for products of two integrals, the other
        is for products of an integral and a left side.

        `weights` (W,) are the weights of windows.
        """
        sums = np.zeros((2, len(self.measured.times)))
        spread_window_weights(self.first, self.bump, self.slope, weights, sums[0], sums[1])
        share = len(self.measured.times) / len(self._thinned)
        return share * sums[0, self._thinned], share * sums[1, self._thinned]

    def variances(self, atoms: Sequence[Atom], coefficients: Sequence[float]) -> FloatArray:
        """Return the variance (W,) of the residuals of a sum.

        The variance is of first order in the noise. Numbers are added in a fixed order, so that results are equal to
        the bit: these laws may end a search.
        """
        slopes, used = np.zeros_like(self.inputs), set[int]()
        for atom, coefficient in zip(atoms, coefficients, strict=True):
            by_variable = self._slopes_of(atom)
            self._add_slopes(slopes, atom, coefficient, by_variable)
            used |= by_variable.keys()
        sizes = self.measured.noise * self.measured.noise
        own, squares, both = self._squared_weights
        variances = sizes[self.target] * own
        variances += 2.0 * sizes[self.target] * self._sums(both, slopes[self.target : self.target + 1])[0]
        part = slopes[sorted(used)]
        for square, sums in zip(sizes[sorted(used)].tolist(), self._sums(squares, part * part), strict=True):
            variances += square * sums
        return np.asarray(variances)

    @cached_property
    def _squared_weights(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The sums (W,) of the squared slopes of the test functions, and the weights (W, L) of squared values, and of
        values times the slope."""
        own = self._sums(self.slope * self.slope, np.ones((1, len(self.measured.times))))[0]
        return own, self.bump * self.bump, self.slope * self.bump

    def assess(self, atoms: Sequence[Atom], coefficients: Sequence[float], residuals: FloatArray) -> Assessment | None:
        """Return the assessment by the log-likelihood of the residuals.

        Each residual is weighted by the share of independent windows, and its variance depends on the sum. The misfit
        is minus the log-likelihood of the true states. These are the states nearest to the measurements for which the
        equation holds. To first order, a window adds half of the squared residual divided by its variance. The
        logarithm of the variance is left out, since the density of the measurements about the true states does not
        depend on the equation. With the logarithm, sums that vary little with the states would be preferred (errors in
        variables, functional case: Fuller 1987, section 2.3). The number of fitted coefficients is subtracted from the
        degrees of freedom.
        """
        from scipy import special

        variances = self.variances(atoms, coefficients)
        if not (variances > 0.0).all():
            return None
        weights = 1.0 / np.sqrt(variances)
        scaled = residuals * weights
        squares = self.independent * math.fsum((scaled * scaled).tolist()) / len(scaled)
        free = max(self.independent - len(atoms), 1.0)
        return Assessment(weights, 0.5 * squares, math.sqrt(squares / free), float(special.chdtrc(free, squares)))

    def _sums(self, weights: FloatArray, values: FloatArray) -> FloatArray:
        return window_integrals(self.first, weights, values)


WindowRows = TypeVar("WindowRows", bound=WeakRows)


def windows_of(
    kind: type[WindowRows], measured: MeasuredRows, target: int, first: Ints, weights: tuple[FloatArray, FloatArray],
    share: float, *more: object,
) -> WindowRows:  # fmt: skip
    """Return windows of the class `kind` with these weights of rows, and their left sides; see `WeakRows`."""
    sides = -window_integrals(first, weights[1], measured.values[target : target + 1])[0]
    return kind(measured.values, np.asarray(sides), measured, target, first, *weights, share, *more)


def window_integrals(first: Ints, weights: FloatArray, values: FloatArray) -> FloatArray:
    """Return the sums (K, W) of `values` (K, R) times `weights` (W, L), over the rows from `first` (W,) on."""
    sums = np.zeros((len(values), len(first)))
    windowed_sums(first, np.ascontiguousarray(weights), np.ascontiguousarray(values), sums)
    return sums


def _powers(values: FloatArray, noise: FloatArray, highest: int) -> list[FloatArray]:
    """Return unbiased estimates of the powers (V, R) of the true values, by exponent.

    With a true value x and an error e, E He_n(x + e) = x^n for Hermite polynomials with the variance of e: He_(n+1)(y)
    = y He_n(y) - n var He_(n-1)(y).
    """
    powers = [np.ones_like(values), values]
    for exponent in range(1, highest):
        powers.append(values * powers[exponent] - exponent * (noise * noise)[:, None] * powers[exponent - 1])
    return powers


def _product(term: Product, powers: Sequence[FloatArray], without: int | None = None) -> FloatArray:
    """Return the values (R,) of a product, or of its derivative by the variable `without`."""
    product = np.ones(powers[0].shape[1])
    for variable, exponent in Counter(term).items():
        if variable == without:
            product = product * (exponent * powers[exponent - 1][variable])
        else:
            product = product * powers[exponent][variable]
    return product


def weak_rows(measured: MeasuredRows, target: int, half: int) -> WeakRows | None:
    """Return windows of ``2 half + 1`` rows; integrals use the trapezoidal rule. None if all trajectories are too short
    for a window."""
    length, step = 2 * half + 1, max(1, round(2.0 * half / SETTINGS.sparse.windows_in_width))
    first = [row for start, end in measured.ranges for row in range(start, end - length + 1, step)]
    if not first:
        return None
    rows = np.array(first, dtype=np.int64)
    times = measured.times[rows[:, None] + np.arange(length)]
    width = (times[:, -1:] - times[:, :1]) / 2.0
    place = (times - times[:, :1]) / width - 1.0
    steps = np.diff(times, axis=1)
    weights = np.zeros_like(times)
    weights[:, 1:] += 0.5 * steps
    weights[:, :-1] += 0.5 * steps
    order = _SMOOTHNESS
    inside = np.maximum(1.0 - place * place, 0.0)
    below = np.ones_like(inside)
    for _ in range(order - 1):  # only multiplications, which give equal bits on every machine
        below = below * inside
    bump, slope = below * inside, -2.0 * order * place * below / width
    share = 2.0 / SETTINGS.sparse.windows_in_width
    return windows_of(WeakRows, measured, target, rows, (bump * weights, slope * weights), share)


def half_width(measured: MeasuredRows, smoothing: StateSmoothing, variables: int) -> int:
    """Return the half width of a window in rows: half of the smoother's span, or less if the largest library needs more
    windows.

    In longer windows, nearly linearly dependent terms have larger errors relative to their differences. Shorter windows
    have larger errors of the trapezoidal rule; errors due to noise should be ten times as large as errors of this rule.
    With the half width h and p = `_SMOOTHNESS`, the errors of the rule in the left side decrease as h^-(p + 1), and
    errors due to noise decrease as h^-1.5.
    """
    terms = min(math.comb(variables + SETTINGS.sparse.degree, variables), SETTINGS.sparse.largest_library)
    most = int(len(measured.times) / (SETTINGS.sparse.rows_per_term * terms + 2 * len(measured.ranges) + 1))
    longest = max(end - start for start, end in measured.ranges)
    half = min(smoothing.span // 2 if smoothing.span else most, most, longest // SETTINGS.sparse.windows_in_width)
    least, exponent = _LEAST_HALF, 2 * _SMOOTHNESS - 1
    share = _LEAST_HALF_NOISE / max(smoothing.relative_noise, SETTINGS.selection.least_noise)
    while (least / _LEAST_HALF) ** exponent < share * share:
        least += 1
    return max(half, least)
