"""The measured trajectories as arrays for fits: all rows one after another, and the pieces that are simulated. Pure.

`measurements_of` collects values, weights and inputs of a `Recording` for the states of one system; `thin`, `part`,
`pieces` and `strided` return subsets. Hidden states have no measured values, and a column may be computed from several
states. Doubts: states without an equation become inputs with their smoothed values. The errors of the smoothed values
do not affect the weights.

Letters: N rows of all trajectories, S states, D states with an equation here, M columns computed from states, O
    measured columns, K states with an offset, U inputs, B pieces, T trajectories.
"""

from bisect import bisect
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.recording import Recording, Trajectory
from atoll_coordinator.model.shooting.smoothing_noise import VarianceModel, estimate_variances
from atoll_coordinator.model.thinning import lattice_step
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

_LONG_RUN: Final = 10.0
"""A state rests in runs of equal values that are this many times as long as the median of its runs.

With 3, a sine of ten steps would count as resting at its extremes. Without this limit, the assumed rounding errors of
a decay to rest are up to 2.6 times the true errors. With it, they are at most 1.25 times the true errors for
oscillations, growth, decays and outbreaks of 20 or 60 steps (tested), but up to 3 times for pulses of 2 to 5 steps.
"""
BLOW_UP_WIDTHS: Final = 3.0
"""A simulated state counts as blown up if it leaves the measured range by more than this many widths of the range."""
_CONSTANT: Final = 1e-12
"""A state whose range is below this share of its size is constant up to rounding errors."""
_LARGEST_SHARE: Final = 0.1
"""Upper limit of a ratio: the variance of normal errors divided by the squared reach of robustness weights. Errors
outside of the reach have weight 0; above this limit, they would matter. For weights that reach to six median errors,
the ratio is 0.061."""


@dataclass(frozen=True, eq=False)
class InitialRanges:
    """Bounds `lower` and `upper` (T, D) on the initial states of trajectories, at their first `times` (T,).

    Equal bounds are a given initial value, which is not fitted. An infinite bound is no bound.
    """

    times: FloatArray
    lower: FloatArray
    upper: FloatArray


@dataclass(frozen=True, eq=False)
class TrajectoryMeasurements:
    """Rows of trajectories for a system of D equations.

    Attributes:
        bounds: half-open row ranges (B, 2) of the pieces that are simulated without a break.
        owners: the trajectory of each piece (B,), as an index of `names`.
        times: times of the rows (N,).
        measured: measured values (O, N).
        weights: weights (O, N) of the measured values; values with weight 0 are not used.
        smoothed: smoothed states (D, N). For hidden states, an estimate.
        observed: indices (O,) of the measured columns among the D states and then the M columns that are computed from
            states (`OdeSystem.observations`).
        inputs: inputs (U, N).
        input_slopes: slopes (U, N) of the inputs.
        scales: standard deviations (D,) of the states.
        noise: standard deviations (O,) of the measurement errors, as the smoother estimates them.
        offset: indices (K,), among the measured states, of states with an unknown offset.
        variables: names of the components of a point: D states, then U inputs.
        names: names of the trajectories.
        has_smoothed_inputs: whether smoothed states without an equation are inputs.
        inverse_variances: relative inverse variances (O, N) of the errors; their mean over the recording is 1.
            `weights` include these numbers as a factor. None: all are 1.
        consistency: weighted mean square (O,) of normal errors, divided by their variance. It is less than one if
            robustness weights reduce large errors. None: one for all states.
        resting: a mask (O, N) of the rows of trajectories along which a state was always 0, such as an absent species.
            There the state has weight 0 and the initial value 0. None: there is no such trajectory.
        groups: index of the group of each trajectory if groups have their own constants; None: all have the same.
        input_error: interpolation error of input curves, divided by the standard deviations of the inputs. Simulated
            states have about the same relative error.
        rounding: standard deviations (O,) of the rounding errors of the measured values, 0 if they are not known; None:
            all are 0.
        column_scales: standard deviations (O,) of the measured columns; None: each column is a state.
        column_course: smoothed values (O, N) of the measured columns; None: each column is a state.
        hidden: indices of the states without measured values whose course is not known before a fit.
        initial: bounds on initial states; None: there are no bounds.
        known_limits: the `limits` of the rows of which these rows are a part; None: they follow from these rows.
    """

    bounds: Ints
    owners: Ints
    times: FloatArray
    measured: FloatArray
    weights: FloatArray
    smoothed: FloatArray
    observed: Ints
    inputs: FloatArray
    input_slopes: FloatArray
    scales: FloatArray
    noise: FloatArray
    offset: Ints
    variables: tuple[str, ...]
    names: tuple[str, ...]
    has_smoothed_inputs: bool = False
    inverse_variances: FloatArray | None = None
    consistency: FloatArray | None = None
    resting: npt.NDArray[np.bool_] | None = None
    groups: Ints | None = None
    input_error: float = 0.0
    rounding: FloatArray | None = None
    column_scales: FloatArray | None = None
    column_course: FloatArray | None = None
    hidden: tuple[int, ...] = ()
    initial: InitialRanges | None = None
    known_limits: FloatArray | None = None

    @property
    def rows(self) -> int:
        """Number of rows of all trajectories."""
        return len(self.times)

    @cached_property
    def owners_of_rows(self) -> Ints:
        """The trajectory (N,) that each row belongs to."""
        return np.repeat(self.owners, self.bounds[:, 1] - self.bounds[:, 0])

    @cached_property
    def step(self) -> float:
        """Median step from one row of a piece to the next; 1 if no piece has two rows."""
        is_inner = np.ones(self.rows, dtype=bool)
        is_inner[self.bounds[:, 0]] = False
        steps = np.diff(self.times, prepend=self.times[0])[is_inner]
        return float(np.median(steps)) if len(steps) else 1.0

    def groups_of(self, segments: Ints) -> Ints:
        """Return the group (G,) of each of these row ranges; 0 if there are no groups."""
        if self.groups is None:
            return np.zeros(len(segments), np.int64)
        return self.groups[self.owners_of_rows[segments[:, 0]]]

    @property
    def relative_noise(self) -> FloatArray:
        """The noise divided by the standard deviation of each measured column (O,)."""
        return np.asarray(self.noise / self.observed_scales)

    @property
    def observed_scales(self) -> FloatArray:
        """Standard deviations (O,) of the measured columns."""
        return self.scales[self.observed] if self.column_scales is None else self.column_scales

    @property
    def smoothed_columns(self) -> FloatArray:
        """Smoothed values (O, N) of the measured columns."""
        return self.smoothed[self.observed] if self.column_course is None else self.column_course

    @property
    def shown(self) -> Ints:
        """The indices of the measured columns, among states and computed columns, and then of the hidden states."""
        return np.array([*self.observed.tolist(), *self.hidden], np.int64)

    def column_of(self, state: int) -> int | None:
        """Return the measured column (index) of a state; None for a hidden state."""
        places = np.flatnonzero(self.observed == state)
        return int(places[0]) if len(places) else None

    def with_all_states(self) -> "TrajectoryMeasurements":
        """Return the measurements as if each state had a column, for comparisons of simulated states; columns of
        hidden states have no values."""
        states = len(self.smoothed)
        if not self.hidden and self.column_scales is None:
            return self
        columns = [self.column_of(state) for state in range(states)]
        known = [column for column in columns if column is not None]
        places = [state for state, column in enumerate(columns) if column is not None]
        measured, weights, noise = np.full_like(self.smoothed, np.nan), np.zeros_like(self.smoothed), np.zeros(states)
        measured[places], weights[places], noise[places] = self.measured[known], self.weights[known], self.noise[known]
        return replace(
            self, measured=measured, weights=weights, noise=noise, observed=np.arange(states), consistency=None,
            inverse_variances=None, resting=None, rounding=None, column_scales=None, column_course=None, initial=None,
        )  # fmt: skip

    @cached_property
    def limits(self) -> FloatArray:
        """Range (D, 2) outside of which a simulated state has blown up. It is infinite for hidden states."""
        if self.known_limits is not None:
            return self.known_limits
        low, high = self.smoothed.min(axis=1), self.smoothed.max(axis=1)
        width = np.maximum(high - low, _CONSTANT * np.maximum(np.abs(high), np.abs(low)))
        beyond = BLOW_UP_WIDTHS * width
        beyond[list(self.hidden)] = np.inf
        return np.ascontiguousarray(np.stack([low - beyond, high + beyond], axis=1))

    @cached_property
    def sizes(self) -> FloatArray:
        """Mean absolute value (D + U,) of each component of a point."""
        return np.asarray(np.abs(np.concatenate([self.smoothed, self.inputs])).mean(axis=1))

    def segments(self, length: int | None) -> Ints:
        """Return row ranges (G, 2) that cover all pieces, each with about `length` rows. None: the ranges are whole
        pieces."""
        ranges: list[tuple[int, int]] = []
        for first, end in self.bounds.tolist():
            count = 1 if length is None else max(1, round((end - first) / length))
            ranges += _cut_range(first, end, count)
        return np.array(ranges, dtype=np.int64)

    def start_ranges(self, segments: Ints) -> tuple[FloatArray, FloatArray] | None:
        """Return bounds (G, D) on the initial states of these row ranges; None without bounds.

        Only ranges that begin with a trajectory have bounds.
        """
        if self.initial is None:
            return None
        firsts = segments[:, 0]
        owners = self.owners_of_rows[firsts]
        is_first = self.times[firsts] == self.initial.times[owners]
        lower = np.where(is_first[:, None], self.initial.lower[owners], -np.inf)
        return lower, np.where(is_first[:, None], self.initial.upper[owners], np.inf)

    def with_course(self, course: FloatArray) -> "TrajectoryMeasurements":
        """Return the measurements with the values of the hidden states in `course` (D, N), such as a simulation."""
        hidden = list(self.hidden)
        smoothed, scales = self.smoothed.copy(), self.scales.copy()
        smoothed[hidden] = course[hidden]
        scales[hidden] = _sizes_of(course[hidden])
        return replace(self, smoothed=smoothed, scales=scales)

    def with_measured_course(self, relative_noise: float) -> "TrajectoryMeasurements":
        """Return the measurements as if the smoothed states were measured, with errors of this share of their standard
        deviations. So an equation of a hidden state can be fitted to its estimated course."""
        return replace(
            self, measured=self.smoothed, weights=np.ones_like(self.smoothed), noise=relative_noise * self.scales,
            observed=np.arange(len(self.smoothed)), hidden=(), consistency=None, inverse_variances=None, resting=None,
            rounding=None, column_scales=None, column_course=None,
        )  # fmt: skip

    def thin(self, most: int) -> "TrajectoryMeasurements":
        """Return pieces of the trajectories with about `most` rows in total; both early and late pieces are selected.

        If groups have their own constants, the actual numbers of rows determine the number of pieces. Then each group
        has at least one piece, if possible. With hidden states, every n-th row is selected instead: pieces in the
        middle of a trajectory would need unknown initial values.
        """
        if self.rows <= most:
            return self
        if self.hidden:
            return self.strided(-(-self.rows // most))
        length = min(SETTINGS.shooting.piece // 2, max(SETTINGS.shooting.lengths[-1], most // len(self.bounds)))
        pieces = [
            (first, min(first + length, end), owner)
            for (first, end), owner in zip(self.bounds.tolist(), self.owners.tolist(), strict=True)
            for first, end in _cut_range(first, end, max(1, round((end - first) / length)))
        ]
        rows = self.rows if self.groups is None else sum(end - first for first, end, _ in pieces)
        count = min(max(1, most * len(pieces) // rows), len(pieces))
        return self.pieces([pieces[place] for place in _choose_spread([owner for *_, owner in pieces], count)])

    def part(self, owners: Collection[int]) -> "TrajectoryMeasurements":
        """Return the pieces of these trajectories (indices of `names`)."""
        bounds = zip(self.bounds.tolist(), self.owners.tolist(), strict=True)
        return self.pieces([(first, end, owner) for (first, end), owner in bounds if owner in owners])

    def pieces(self, kept: Sequence[tuple[int, int, int]]) -> "TrajectoryMeasurements":
        """Return the measurements of the pieces `kept`; each piece is (first row, end, owner)."""
        return self._take_rows([np.arange(first, end) for first, end, _ in kept], [owner for *_, owner in kept])

    def first_rows(self, most: int) -> "TrajectoryMeasurements":
        """Return the first `most` rows of each piece; simulated states have the limits of all rows."""
        bounds = zip(self.bounds.tolist(), self.owners.tolist(), strict=True)
        part = self.pieces([(first, min(first + most, end), owner) for (first, end), owner in bounds])
        return replace(part, known_limits=self.limits)

    def strided(self, stride: int) -> "TrajectoryMeasurements":
        """Return every `stride`-th row of each piece."""
        if stride == 1:
            return self
        return self._take_rows([np.arange(first, end, stride) for first, end in self.bounds], self.owners.tolist())

    def _take_rows(self, rows_by_piece: Sequence[Ints], owners: Sequence[int]) -> "TrajectoryMeasurements":
        rows, lengths = np.concatenate(rows_by_piece), np.array([len(rows) for rows in rows_by_piece])
        ends = np.cumsum(lengths)
        by_row = (
            "measured", "weights", "inverse_variances", "smoothed", "inputs", "input_slopes", "resting",
            "column_course",
        )  # fmt: skip
        arrays: dict[str, Any] = {name: getattr(self, name) for name in by_row}
        arrays = {name: None if of is None else np.ascontiguousarray(of[:, rows]) for name, of in arrays.items()}
        return replace(
            self,
            bounds=np.stack([ends - lengths, ends], axis=1).astype(np.int64),
            owners=np.array(owners, dtype=np.int64),
            times=np.ascontiguousarray(self.times[rows]),
            **arrays,
        )


def _sizes_of(values: FloatArray) -> FloatArray:
    """Return the standard deviation of each state (D, N); the absolute value of a constant state; 1 for a state that is
    always 0."""
    sizes, widths = np.abs(values).max(axis=1, initial=0.0), values.std(axis=1)
    return np.where(widths > _CONSTANT * sizes, widths, np.where(sizes > 0.0, sizes, 1.0))


def measurements_of(
    recording: Recording, modelled: Sequence[int], *, held_out: bool = False, piece: int = SETTINGS.shooting.piece,
    observed: Sequence[int] = (),
) -> TrajectoryMeasurements:  # fmt: skip
    """Return the measurements for a system with equations for the `modelled` states (indices).

    The smoothed values of the other states become inputs, after the inputs of the recording; rows without smoothed
    values are left out. For order 2, the states are the positions of the modelled states, then their velocities, which
    are not measured. At most `piece` rows are simulated without a break. The `observed` columns (indices) are computed
    from the states of the system; they come after the measured states.

    Raises:
        ValueError: there are no such trajectories.
    """
    parts = [trajectory for trajectory in recording.trajectories if trajectory.held_out == held_out]
    apart = {*modelled, *map(recording.states.index, recording.observed)}
    others = [index for index in range(len(recording.states)) if index not in apart]
    chosen = list(modelled)
    columns = [index for index in chosen if recording.states[index] not in recording.hidden] + list(observed)
    measured = _stacked(part.measured[columns] for part in parts)
    positions = _stacked(part.smoothed[chosen] for part in parts)
    states = [positions]
    inputs, slopes = [_stacked(part.inputs for part in parts)], [_stacked(part.input_slopes for part in parts)]
    inputs.append(_stacked(part.smoothed[others] for part in parts))
    slopes.append(_stacked(part.slopes[others] for part in parts))
    if recording.order == 2:
        states.append(_stacked(part.slopes[chosen] for part in parts))
        inputs.append(_stacked(part.slopes[others] for part in parts))
        slopes.append(_stacked(_gradients(part, others) for part in parts))
    smoothed = np.concatenate(states)
    all_variances = estimate_variances(recording)
    variances = [all_variances[index] for index in columns]
    inverse = _inverse_variances(parts, columns, variances)
    weights = _stacked(_robustness_weights(part, columns) for part in parts)
    noise = np.array(
        [recording.smoothing[index].noise * variance.scale for index, variance in zip(columns, variances, strict=True)]
    )
    bounds, owners = _pieces([len(part.times) for part in parts], piece)
    resting = np.concatenate([_resting(part, columns, recording.order) for part in parts], axis=1)
    resting[len(columns) - len(observed) :] = False
    hidden = tuple(place for place, index in enumerate(chosen) if index not in columns)
    scales = np.maximum(smoothed.std(axis=1), 1e-300)
    scales[list(hidden)] = _sizes_of(smoothed[list(hidden)])
    computed = range(len(smoothed), len(smoothed) + len(observed))
    course = _stacked(part.smoothed[columns] for part in parts)
    whole = TrajectoryMeasurements(
        bounds=bounds,
        owners=owners,
        times=np.concatenate([part.times for part in parts]),
        measured=measured,
        weights=np.where(resting, 0.0, weights if inverse is None else weights * inverse),
        smoothed=np.ascontiguousarray(smoothed),
        observed=np.array([*(place for place in range(len(chosen)) if place not in hidden), *computed], np.int64),
        inputs=np.ascontiguousarray(np.concatenate(inputs)),
        input_slopes=np.ascontiguousarray(np.concatenate(slopes)),
        scales=scales,
        noise=noise,
        offset=np.array(
            [place for place, index in enumerate(columns) if recording.states[index] in recording.offsets], np.int64
        ),
        variables=_variables(recording, chosen, others),
        names=tuple(part.name for part in parts),
        has_smoothed_inputs=bool(others),
        inverse_variances=inverse,
        consistency=_consistency(parts, columns),
        resting=resting if resting.any() else None,
        groups=np.array([recording.groups.index(part.group) for part in parts], np.int64) if recording.groups else None,
        input_error=recording.input_error,
        rounding=_rounding(recording, parts, columns, variances),
        column_scales=course.std(axis=1) if observed else None,
        column_course=course if observed else None,
        hidden=hidden,
        initial=_initial_ranges(recording, parts, chosen),
    )
    return _keep_rows_with_inputs(whole, parts, others)


def _initial_ranges(recording: Recording, parts: Sequence[Trajectory], chosen: Sequence[int]) -> InitialRanges | None:
    """Return the user's bounds on initial states; None if there are none."""
    known = dict(zip((name for name, *_ in recording.initial), recording.initial, strict=True))
    names = [recording.states[index] for index in chosen]
    if not any(name in known for name in names):
        return None
    pairs = np.array([known[name][1:] if name in known else (-np.inf, np.inf) for name in names])
    lower, upper = (np.tile(ends, (len(parts), 1)) for ends in pairs.T)
    return InitialRanges(np.array([part.times[0] for part in parts]), lower, upper)


def _rounding(
    recording: Recording, parts: Sequence[Trajectory], chosen: Sequence[int], variances: Sequence[VarianceModel]
) -> FloatArray | None:
    """Return the standard deviations (O,) of rounding errors, 0 if they are not known; None: all are 0.

    The errors of values with equally many digits count as 0: their mean square is mostly that of a few large values,
    and depends on the weights of these rows. So do errors in rows at which a state rests, see `_resting_share`.
    """
    errors = np.zeros(len(chosen))
    for place, index in enumerate(chosen):
        known = recording.smoothing[index].quantisation
        if known is not None and known.kind != "digits":
            moving = 1.0 - _resting_share([part.measured[index] for part in parts])
            errors[place] = known.error * variances[place].scale * np.sqrt(moving)
    return errors if errors.any() else None


def _resting_share(parts: Sequence[FloatArray]) -> float:
    """Return the share of the rows in runs of equal values that are much longer than most runs.

    There a state rests, such as a population near 0, and its rounding errors may be much smaller than a step.
    """
    ends = [np.flatnonzero(np.diff(values, append=np.nan) != 0.0) for values in parts]
    runs = np.concatenate([np.diff(places, prepend=-1) for places in ends])
    return float(runs[runs > _LONG_RUN * np.median(runs)].sum() / runs.sum())


def _keep_rows_with_inputs(
    whole: TrajectoryMeasurements, parts: Sequence[Trajectory], others: Sequence[int]
) -> TrajectoryMeasurements:
    """Return the parts of all pieces in which all inputs that are smoothed states have known values."""
    if not others or all(part.is_known is None for part in parts):
        return whole
    is_known = np.concatenate(
        [
            np.ones(len(part.times), np.bool_) if part.is_known is None else part.is_known[others].all(0)
            for part in parts
        ]
    )
    kept = []
    for (first, end), owner in zip(whole.bounds.tolist(), whole.owners.tolist(), strict=True):
        changes = np.flatnonzero(np.diff(np.concatenate([[False], is_known[first:end], [False]]).astype(np.int8)))
        kept += [(first + start, first + stop, owner) for start, stop in changes.reshape(-1, 2).tolist()]
    kept = [stretch for stretch in kept if stretch[1] - stretch[0] > 1]
    return whole.pieces(kept) if kept else whole


def _variables(recording: Recording, chosen: list[int], others: list[int]) -> tuple[str, ...]:
    def of(symbols: Sequence[str], indices: list[int]) -> list[str]:
        return [symbols[index] for index in indices] if symbols else []

    return (
        *of(recording.state_symbols, chosen),
        *of(recording.velocity_symbols, chosen),
        *recording.input_symbols,
        *of(recording.state_symbols, others),
        *of(recording.velocity_symbols, others),
    )


def _resting(part: Trajectory, chosen: list[int], order: int) -> npt.NDArray[np.bool_]:
    """Return a mask of states that were 0 along a whole trajectory. For order 2 it is False, since velocities may
    differ from 0."""
    measured = part.measured[chosen]
    is_zero = (np.isnan(measured) | (measured == 0.0)).all(axis=1) & (measured == 0.0).any(axis=1) & (order == 1)
    return np.repeat(is_zero[:, None], measured.shape[1], axis=1)


def _robustness_weights(part: Trajectory, chosen: list[int]) -> FloatArray:
    """Return the weight of each measurement: 0 if it is missing, small if the smoother treats it as an outlier."""
    measured = np.isfinite(part.measured[chosen]).astype(np.float64)
    return measured if part.robustness_weights is None else measured * part.robustness_weights[chosen]


def _consistency(parts: Sequence[Trajectory], chosen: list[int]) -> FloatArray | None:
    """Return, for each state, the weighted mean square of normal errors e divided by their variance: E[w e^2] / (E[w]
    var e).

    The weights are w = (1 - (e/c)^2)^2 for errors below c, the reach of the weights. With x = (var e)/c^2, the mean of
    w is 1 - 2x + 3x^2, and E[w e^2] is (1 - 6x + 15x^2) var e. If the reach is six median errors, errors above c add
    less than a thousandth. x is computed from the mean of the weights above zero.
    """
    if all(part.robustness_weights is None for part in parts):
        return None
    weights = [
        np.ones(part.measured[chosen].shape) if part.robustness_weights is None else part.robustness_weights[chosen]
        for part in parts
    ]
    counts = np.concatenate([np.isfinite(part.measured[chosen]) for part in parts], axis=1)
    factors = []
    for weight, count in zip(np.concatenate(weights, axis=1), counts, strict=True):
        counted = weight[count & (weight > 0.0)]
        mean = float(counted.mean()) if len(counted) else 1.0
        share = min((1.0 - np.sqrt(max(3.0 * mean - 2.0, 0.0))) / 3.0, _LARGEST_SHARE)
        factors.append((1.0 - 6.0 * share + 15.0 * share**2) / (1.0 - 2.0 * share + 3.0 * share**2))
    return np.array(factors)


def _inverse_variances(
    parts: Sequence[Trajectory], chosen: list[int], variances: Sequence[VarianceModel]
) -> FloatArray | None:
    """Return the inverse variances (O, N) that follow from the user's weights and the residuals of smoothing. None if
    all are 1."""
    if all(part.weights is None for part in parts) and not any(variance.proportional for variance in variances):
        return None
    several = list[FloatArray]()
    for part in parts:
        weights = np.ones((len(chosen), len(part.times)))  # a hidden state alone has no measured column
        for row, (index, variance) in enumerate(zip(chosen, variances, strict=True)):
            weights[row] = variance.weights(part.smoothed[index])
        several.append(weights if part.weights is None else weights * part.weights)
    return _stacked(iter(several))


def _stacked(arrays: Iterator[FloatArray]) -> FloatArray:
    return np.ascontiguousarray(np.concatenate(list(arrays), axis=1))


def _pieces(lengths: Sequence[int], most: int) -> tuple[Ints, Ints]:
    """Return the bounds and the owners of the pieces; `lengths` are the numbers of rows of the trajectories."""
    ranges: list[tuple[int, int]] = []
    owners: list[int] = []
    start = 0
    for owner, length in enumerate(lengths):
        pieces = _cut_range(start, start + length, -(-length // most))
        ranges += pieces
        owners += [owner] * len(pieces)
        start += length
    return np.array(ranges, dtype=np.int64), np.array(owners, dtype=np.int64)


def _cut_range(first: int, end: int, count: int) -> list[tuple[int, int]]:
    """Return `count` half-open ranges of nearly equal length that cover the range from `first` to `end`."""
    cuts = [first + (end - first) * index // count for index in range(count + 1)]
    return list(pairwise(cuts))


def _choose_spread(owners: Sequence[int], count: int) -> list[int]:
    """Return the indices of `count` pieces: the same number from each trajectory, both early and late pieces.

    `owners` has the trajectory of each piece.

    If every n-th piece were selected, it could always be the first piece of a trajectory. Then later parts would be
    missing, such as an attractor or an input that is switched on. A lattice avoids this: pieces come from all parts of
    a trajectory, and from distant parts of neighbouring trajectories.
    """
    step = lattice_step(count)
    left: dict[int, list[int]] = {}
    for place, owner in enumerate(owners):
        left.setdefault(owner, []).append(place)
    ranges = {owner: (places[0], len(places)) for owner, places in left.items()}
    selection = []
    for index in range(count):
        owner = owners[(2 * index + 1) * len(owners) // (2 * count)]
        first, size = ranges[owner]
        wanted = first + size * (2 * (index * step % count) + 1) // (2 * count)
        free = left[owner]
        after = bisect(free, wanted)
        near = range(max(after - 1, 0), min(after + 1, len(free)))
        selection.append(free.pop(min(near, key=lambda place: abs(free[place] - wanted))))
    return sorted(selection)


def _gradients(part: Trajectory, states: list[int]) -> FloatArray:
    return np.asarray(np.gradient(part.slopes[states], part.times, axis=1)) if states else part.slopes[states]
