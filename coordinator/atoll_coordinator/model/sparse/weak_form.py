"""The equation of one state in weak form: integrated against test functions, so that nothing is differentiated.

With a test function b that vanishes at both ends of a window, dx/dt = sum c_k f_k gives, by parts,

    - int b' x dt = sum c_k int b f_k dt

(Messenger & Bortz 2021). Products of measured states have the expectation of the true ones when powers are Hermite
polynomials of the noise's variance. The variance of what an equation leaves in a window follows from that of the
measurements (errors in variables: Bortz, Messenger & Dukic 2023), so that a residual is known to be noise or not.

Letters: K terms, W windows of L rows, N rows of all trajectories, V variables.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from atoll_coordinator.data.differentiation.interpolation import estimate_value_noise, make_signal, predict_left_out
from atoll_coordinator.data.recording import Recording, Smoothing, Trajectory
from atoll_coordinator.model.sparse.kernels.least_squares import windowed_sums
from atoll_coordinator.model.sparse.products import Product
from atoll_coordinator.model.thinning import thinned_places
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints


@dataclass(frozen=True, eq=False)
class Measured:
    """Rows of the trajectories that are not held out: `times` (N,), `ranges` of rows that follow one another.

    Of very many rows they are stretches, spread evenly.

    `values` (V, N) are the variables as measured, smoothed where nothing was; `smoothed` (V, N); `noise` (V,) the
    standard deviations of the errors, 0 for inputs and for states that were interpolated.
    """

    times: FloatArray
    ranges: tuple[tuple[int, int], ...]
    values: FloatArray
    smoothed: FloatArray
    noise: FloatArray


def measured_of(recording: Recording, names: Sequence[str]) -> Measured:
    """Return the rows of the variables `names` (V,), symbols of states and inputs."""
    parts = [trajectory for trajectory in recording.trajectories if not trajectory.held_out]
    symbols = (*recording.state_symbols, *recording.input_symbols)
    places = [symbols.index(name) for name in names]
    states = np.concatenate([part.measured for part in parts], axis=1)
    smoothed = np.concatenate([part.smoothed for part in parts], axis=1)
    inputs = np.concatenate([_mean_inputs(part) for part in parts], axis=1)
    noise = [_noise(parts, place, smoothing) for place, smoothing in enumerate(recording.smoothing)]
    stretches = _stretches([len(part.times) for part in parts])
    rows = np.concatenate([np.arange(first, end) for first, end in stretches])
    ends = np.cumsum([end - first for first, end in stretches]).tolist()
    return Measured(
        np.concatenate([part.times for part in parts])[rows],
        tuple(zip([0, *ends[:-1]], ends, strict=True)),
        np.concatenate([np.where(np.isfinite(states), states, smoothed), inputs])[places][:, rows],
        np.concatenate([smoothed, inputs])[places][:, rows],
        np.array([*noise, *([0.0] * len(inputs))])[places],
    )


def _mean_inputs(part: Trajectory) -> FloatArray:
    """Return the inputs (U, R) at the rows, of held ones the mean over both steps beside a row, by their lengths.

    With these a trapezoidal rule integrates test functions times a held input as it jumps.
    """
    held = np.asarray(np.isnan(part.input_slopes).any(axis=1))
    if not held.any():
        return part.inputs
    steps = np.diff(part.times)
    before, after = np.append(0.0, steps), np.append(steps, 0.0)
    previous = np.concatenate([part.inputs[:, :1], part.inputs[:, :-1]], axis=1)
    means = (before * previous + after * part.inputs) / (before + after)
    return np.where(held[:, None], means, part.inputs)


def _stretches(lengths: Sequence[int]) -> list[tuple[int, int]]:
    """Return first row and end of the stretches that stand for trajectories of these `lengths`: whole ones if few."""
    parts = -(-sum(lengths) // SETTINGS.sparse.most_rows)
    stretch = SETTINGS.sparse.stretch if parts > 1 else max(lengths)
    ends = np.cumsum(lengths).tolist()
    return [
        (first, min(first + stretch, end))
        for begun, end in zip([0, *ends[:-1]], ends, strict=True)
        for first in range(begun, end, stretch)
    ][::parts]


def _noise(parts: Sequence[Trajectory], place: int, smoothing: Smoothing) -> float:
    """Return the deviation of a state's errors: the smoother's, or that by which most rows are predicted, if less.

    What a smoother leaves of fast passages is no error.
    """
    if smoothing.method == "interpolation" or smoothing.quantisation is not None:
        return 0.0 if smoothing.method == "interpolation" else smoothing.noise
    signals = [
        make_signal(part.times, part.measured[place].copy(), None).measured
        for part in parts
        if np.count_nonzero(np.isfinite(part.measured[place])) >= SETTINGS.checks.min_rows
    ]
    return min(smoothing.noise, estimate_value_noise(*predict_left_out(signals))) if signals else smoothing.noise


@dataclass(frozen=True, eq=False)
class WeakForm:
    """Windows along trajectories for the equation of variable `target`.

    `first` (W,) is the first row of each window; `bump` and `slope` (W, L) are the test functions and their
    derivatives, times the weights of the trapezoidal rule.
    """

    measured: Measured
    target: int
    first: Ints
    bump: FloatArray
    slope: FloatArray

    @property
    def independent(self) -> float:
        """How many windows there are that know nothing of each other: one for each half width."""
        return len(self.first) * SETTINGS.sparse.step * 2.0

    @property
    def sides(self) -> FloatArray:
        """The left sides (W,)."""
        return np.asarray(-self._sums(self.slope, self.measured.values[self.target : self.target + 1])[0])

    def columns(self, terms: Sequence[Product]) -> FloatArray:
        """Return the integrals (K, W) of the terms, products of variables."""
        powers = _powers(self.measured.values, self.measured.noise, max(map(len, terms), default=0))
        return self._sums(self.bump, np.array([_product(term, powers) for term in terms]))

    def integrals(self, values: FloatArray) -> FloatArray:
        """Return the integrals (W,) of a function's values (N,)."""
        return np.asarray(self._sums(self.bump, values[None])[0])

    def variances(self, terms: Sequence[Product], coefficients: Sequence[float]) -> FloatArray:
        """Return the variance (W,) of what the sum of terms leaves in each window, to first order in the noise."""
        powers = _powers(self.measured.smoothed, np.zeros(len(self.measured.noise)), max(map(len, terms), default=0))
        places = range(len(self.measured.noise))
        return self.variances_of(np.array([_slope(terms, coefficients, powers, place) for place in places]))

    def variances_of(self, slopes: FloatArray) -> FloatArray:
        """Return the same for a function with these derivatives (V, N) by the variables.

        What decides which laws there are is summed in a fixed order: they may end a search.
        """
        squares = self.measured.noise * self.measured.noise
        own = squares[self.target]
        variances = own * self._sums(self.slope * self.slope, np.ones((1, slopes.shape[1])))[0]
        variances += 2.0 * own * self._sums(self.slope * self.bump, slopes[self.target : self.target + 1])[0]
        for square, sums in zip(squares.tolist(), self._sums(self.bump * self.bump, slopes * slopes), strict=True):
            variances += square * sums
        return np.asarray(variances)

    def gradients(self, terms: Sequence[Product]) -> tuple[FloatArray, Ints]:
        """Return the derivatives (K, V, R) of terms by the variables on some rows, and which rows these are (R,)."""
        rows = thinned_places(len(self.measured.times), SETTINGS.rows.most)
        powers = _powers(self.measured.smoothed[:, rows], np.zeros(len(self.measured.noise)), max(map(len, terms)))
        places = range(len(self.measured.noise))
        return np.array([[_slope([term], [1.0], powers, place) for place in places] for term in terms]), rows

    def row_weights(self, weights: FloatArray, rows: Ints) -> tuple[FloatArray, FloatArray]:
        """Return how much errors of some `rows` (R,) count in products of integrals, and in those with left sides.

        Windows have these `weights` (W,); rows stand for all.
        """
        sums = np.zeros((2, len(self.measured.times)))
        for place in range(self.bump.shape[1]):
            part = weights * self.bump[:, place]
            np.add.at(sums[0], self.first + place, part * self.bump[:, place])
            np.add.at(sums[1], self.first + place, part * self.slope[:, place])
        share = len(self.measured.times) / len(rows)
        return share * sums[0, rows], share * sums[1, rows]

    def _sums(self, weights: FloatArray, values: FloatArray) -> FloatArray:
        return window_integrals(self.first, weights, values)


def window_integrals(first: Ints, weights: FloatArray, values: FloatArray) -> FloatArray:
    """Return the sums (K, W) of `values` (K, N) times `weights` (W, L), over the rows from `first` (W,) on."""
    sums = np.zeros((len(values), len(first)))
    windowed_sums(first, np.ascontiguousarray(weights), np.ascontiguousarray(values), sums)
    return sums


def weak_form(measured: Measured, target: int, half: int) -> WeakForm | None:
    """Return the weak form with windows of ``2 half + 1`` rows; None where trajectories are too short for any."""
    length, step = 2 * half + 1, max(1, round(half * SETTINGS.sparse.step * 2.0))
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
    order = SETTINGS.sparse.smoothness
    inside = np.maximum(1.0 - place * place, 0.0)
    below = _power(inside, order - 1)
    bump, slope = below * inside, -2.0 * order * place * below / width
    return WeakForm(measured, target, rows, bump * weights, slope * weights)


def _power(values: FloatArray, exponent: int) -> FloatArray:
    """Return a whole power by multiplications alone."""
    power = np.ones_like(values)
    for _ in range(exponent):
        power = power * values
    return power


def _powers(values: FloatArray, noise: FloatArray, highest: int) -> list[FloatArray]:
    """Return the powers (V, N) of the true values, by exponent, as far as the expectation goes.

    E He_n(x + e) = x^n for Hermite polynomials of the variance of e: He_(n+1) = x He_n - n var He_(n-1).
    """
    powers = [np.ones_like(values), values]
    for exponent in range(1, highest):
        powers.append(values * powers[exponent] - exponent * (noise * noise)[:, None] * powers[exponent - 1])
    return powers


def _product(term: Product, powers: Sequence[FloatArray], without: int | None = None) -> FloatArray:
    """Return the values (N,) of a product; with one factor `without`, times its exponent: the derivative."""
    product = np.ones(powers[0].shape[1])
    for variable, exponent in Counter(term).items():
        if variable == without:
            product = product * (exponent * powers[exponent - 1][variable])
        else:
            product = product * powers[exponent][variable]
    return product


def _slope(
    terms: Sequence[Product], coefficients: Sequence[float], powers: Sequence[FloatArray], variable: int
) -> FloatArray:
    """Return the derivative (N,) of the sum of terms by a variable."""
    total = np.zeros(powers[0].shape[1])
    for term, coefficient in zip(terms, coefficients, strict=True):
        if variable in term:
            total = total + coefficient * _product(term, powers, variable)
    return total
