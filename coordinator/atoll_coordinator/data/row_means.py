"""Averages oversampled rows: means replace rows, as many as the states' time scales need. Pure.

The reason is that lengths of segments, pieces and windows are numbers of rows. At a sampling rate ten times as high, a
piece would be a tenth as long, and along so short a piece a line describes any curve. Averaging n rows divides the
independent error by sqrt(n).

Letters: R rows of one trajectory, B blocks of rows, S states.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.differentiation.derivatives import StateEstimate
from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.trajectories.measurements import Measurements
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, IntArray
from atoll_core.data.notes import Note

_LEAST_BLOCKS: Final = SETTINGS.smoothing.bins // 2
"""Fewest means of the longest trajectory, because loess needs rows."""
_SCANNED: Final = 2 * SETTINGS.rows.most
"""A correlation length is found from about this number of evenly spaced rows of the longest trajectory, enough to
resolve a thousandth of it."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """Blocks of rows of one trajectory; each block becomes one row.

    `ranges` (B, 2) are half-open and cover all rows; `is_whole` (B,) is false for parts of a block that was divided
    because an input changes fast within it.
    """

    ranges: IntArray
    is_whole: npt.NDArray[np.bool_]

    @property
    def centres(self) -> IntArray:
        """The row in the middle of each block (B,)."""
        return np.asarray((self.ranges[:, 0] + self.ranges[:, 1]) // 2)

    @property
    def sizes(self) -> IntArray:
        """Number of rows of each block (B,)."""
        return np.asarray(self.ranges[:, 1] - self.ranges[:, 0])

    @property
    def divided_rows(self) -> int:
        """Number of rows in divided blocks."""
        return int(self.sizes[~self.is_whole].sum())

    def means(self, values: FloatArray) -> FloatArray:
        """Return the mean (B,) of `values` (R,) over each block, summed in order."""
        return np.array([moments(values[first:end])[0] for first, end in self.ranges.tolist()])

    def divided(self, is_divided: npt.NDArray[np.bool_]) -> "Blocks":
        """Return the blocks; each marked block (B,) is divided into two halves."""
        ranges: list[tuple[int, int]] = []
        is_whole: list[bool] = []
        for (first, end), is_here, whole in zip(self.ranges.tolist(), is_divided, self.is_whole.tolist(), strict=True):
            middle = (first + end) // 2
            ranges += [(first, middle), (middle, end)] if is_here else [(first, end)]
            is_whole += [False, False] if is_here else [whole]
        return Blocks(np.array(ranges, np.int64), np.array(is_whole))


def average_oversampled_rows(measurements: Measurements, estimates: Sequence[StateEstimate]) -> Measurements:
    """Return `measurements` with means in place of rows if there are far more rows than the states' time scales need.

    Otherwise the same object is returned. The same object is also returned if the noise of all states is negligible,
    because a row is then as good as a mean.

    The mean of a state is the mean of its residuals plus the smoothed value at the centre, so that curvature causes no
    bias. An input may change so fast, for instance at a switch, that its means would move the states by more than their
    noise. Blocks are then divided there, down to single rows, and states count as not measured in the divided blocks.
    Rows of inputs that are held between rows stay unchanged, because no row holds the mean over a switch.
    """
    count = 1 if measurements.roles.held else rows_of_mean(measurements, estimates)
    most = SETTINGS.inference.part * measurements.row_count
    while count > 1:
        blocks = _blocks(measurements, estimates, count, most)
        if sum(part.divided_rows for part in blocks) <= most:
            return _averaged(measurements, estimates, blocks, count)
        count //= 2
    return measurements


def estimates_of_means(estimates: Sequence[StateEstimate], of_rows: Sequence[StateEstimate]) -> list[StateEstimate]:
    """Return the `estimates` of means with the outliers of the rows: means do not show outliers."""
    return [
        replace(
            one,
            has_heavy_tails=one.has_heavy_tails or rows.has_heavy_tails,
            outliers=rows.outliers if one.outliers is None else one.outliers + (rows.outliers or 0),
        )
        for one, rows in zip(estimates, of_rows, strict=True)
    ]


def rows_of_mean(measurements: Measurements, estimates: Sequence[StateEstimate]) -> int:
    """Return the number of rows of a mean; 1 if rows are not averaged.

    After averaging, the shortest correlation length of the states has as many rows as the shortest segments. The number
    of rows is at most the larger of two numbers. With the first, there are so few means that models are compared on all
    of them. With the second, a piece spans the longest trajectory.
    """
    lengths = [last - first for (first, last), out in zip(measurements.ranges, measurements.held_out, strict=True)
               if not out]  # fmt: skip
    longest, piece = max(lengths), SETTINGS.shooting.piece
    of_whole = 1 if longest <= piece else math.ceil(longest / (piece * (1.0 - SETTINGS.inference.part)))
    most = min(max(sum(lengths) // SETTINGS.selection.compared_rows, of_whole), longest // _LEAST_BLOCKS)
    least = SETTINGS.selection.least_noise  # below this noise errors are systematic, and means are no better
    if most < 2 or all(estimate.is_interpolated or estimate.relative_noise < least for estimate in estimates):
        return 1
    fewest = SETTINGS.shooting.lengths[0]
    return max(1, min(most, *(correlation_length(measurements, estimate) // fewest for estimate in estimates)))


def correlation_length(measurements: Measurements, estimate: StateEstimate) -> int:
    """Return the number of rows after which the autocorrelation of a state's increments falls below 1/e.

    For a sinusoid this is 0.19 of its period. Held-out trajectories are not used; sums run in order.
    """
    ranges = [place for place, out in zip(measurements.ranges, measurements.held_out, strict=True) if not out]
    stride = max(1, max(last - first for first, last in ranges) // _SCANNED)
    parts = [np.diff(estimate.values[first:last:stride]) for first, last in ranges]
    mean = moments(np.concatenate(parts))[0]
    parts = [part - mean for part in parts]

    def lagged(lag: int) -> float:
        products = [part[: len(part) - lag] * part[lag:] for part in parts if len(part) > lag]
        return float(np.cumsum(np.concatenate(products))[-1]) if products else 0.0

    least, longest = lagged(0) / math.e, max(map(len, parts))
    return stride * next((lag for lag in range(1, longest) if not lagged(lag) > least), longest)


# ------------------------------------------------------------------------------------------------------ which rows


def _blocks(
    measurements: Measurements, estimates: Sequence[StateEstimate], count: int, most_divided: float
) -> list[Blocks]:
    """Return the blocks of each trajectory for means of `count` rows, divided where inputs change fast.

    The limit for the error of an input's integral follows from three assumptions. An error of the input of one standard
    deviation is tolerated as long as the noise hides the motion that it causes. Inputs change a state's rate by no more
    than the rate's standard deviation. The errors of the blocks within a correlation length are independent, and their
    sum stays below the noise of a mean.
    """
    assert measurements.trajectories is not None
    blocks = [even_blocks(last - first, count) for first, last in measurements.ranges]
    searched, reach = measurements.searched_rows, math.inf
    for estimate in estimates:
        speed = moments(np.ascontiguousarray(estimate.velocity[searched]))[1]
        if speed > 0.0:
            reach = min(reach, estimate.noise / math.sqrt(count * SETTINGS.shooting.lengths[0]) / speed)
    for along in measurements.inputs:
        limit = reach * moments(np.concatenate(along))[1]
        parts = zip(blocks, measurements.trajectories.times, along, strict=True)
        blocks = [divided_blocks(part, times, values, limit, most_divided) for part, times, values in parts]
    return blocks


def even_blocks(rows: int, count: int) -> Blocks:
    """Return blocks of about `count` rows."""
    blocks = max(rows // count, min(rows, _LEAST_BLOCKS))
    edges = [index * rows // blocks for index in range(blocks + 1)]
    return Blocks(np.array(list(pairwise(edges)), np.int64), np.ones(blocks, np.bool_))


def divided_blocks(
    blocks: Blocks, times: FloatArray, values: FloatArray, limit: float, most: float = math.inf
) -> Blocks:
    """Return blocks divided so that the integral of an input, computed from the means, is wrong by at most `limit`.

    The error of the integral from the beginning of a block to each of its rows counts. Dividing stops once more than
    `most` rows are in divided blocks.
    """
    while True:
        wanted = interpolated(times[blocks.centres], input_means(blocks, times, values), times)
        errors = (wanted - values) * np.diff(times, append=2.0 * times[-1] - times[-2])
        is_wrong = np.array(
            [float(np.max(np.abs(np.cumsum(errors[first:end])))) > limit for first, end in blocks.ranges.tolist()]
        )
        is_divided = is_wrong & (blocks.sizes > 1)
        if not is_divided.any() or blocks.divided_rows > most:
            return blocks
        blocks = blocks.divided(is_divided)


def input_means(blocks: Blocks, times: FloatArray, values: FloatArray) -> FloatArray:
    """Return an input (B,) at the centres of blocks, from a least-squares parabola through the rows of each block.

    Each block is fitted separately, so that no value is carried over a switch of the input. With three rows or fewer
    the parabola passes through the middle row.
    """
    centres = blocks.centres
    ages = times - np.repeat(times[centres], blocks.sizes)
    lengths = np.maximum(times[blocks.ranges[:, 1] - 1] - times[blocks.ranges[:, 0]], 1e-300)
    ages = ages / np.repeat(lengths, blocks.sizes)
    m1, m2, m3, m4 = (blocks.means(ages**power) for power in (1, 2, 3, 4))
    u0, u1, u2 = (blocks.means(values * ages**power) for power in (0, 1, 2))
    first, second, third = m2 * m4 - m3 * m3, m2 * m3 - m1 * m4, m1 * m3 - m2 * m2  # cofactors of the normal equations
    is_fitted = blocks.sizes > 3
    whole = np.where(is_fitted, first + m1 * second + m2 * third, 1.0)
    return np.where(is_fitted, (first * u0 + second * u1 + third * u2) / whole, values[centres])


def interpolated(times: FloatArray, values: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the piecewise cubic through `values` (R,), R >= 3, at the times `wanted`.

    The slope at each row is the slope of the parabola through the row and its two neighbours.
    """
    steps = np.diff(times)
    rises = np.diff(values) / steps
    inner = (steps[1:] * rises[:-1] + steps[:-1] * rises[1:]) / (steps[1:] + steps[:-1])
    slopes = np.concatenate([[2.0 * rises[0] - inner[0]], inner, [2.0 * rises[-1] - inner[-1]]])
    before = np.clip(np.searchsorted(times, wanted, side="right") - 1, 0, len(steps) - 1)
    step = steps[before]
    share = (wanted - times[before]) / step
    rest = 1.0 - share
    ends = values[before] * rest * rest * (1.0 + 2.0 * share) + values[before + 1] * share * share * (3.0 - 2.0 * share)
    return np.asarray(ends + step * share * rest * (slopes[before] * rest - slopes[before + 1] * share))


# ---------------------------------------------------------------------------------------------------- their values


def _averaged(
    measurements: Measurements, estimates: Sequence[StateEstimate], blocks: Sequence[Blocks], count: int
) -> Measurements:
    whole, roles, ranges = measurements.trajectories, measurements.roles, measurements.ranges
    assert whole is not None
    weights = np.ones(measurements.row_count) if measurements.weights is None else measurements.weights
    states = {
        name: [
            _state_means(part, values, estimate, weights, slice(*place))
            for part, values, place in zip(blocks, along, ranges, strict=True)
        ]
        for (name, along), estimate in zip(whole.states.items(), estimates, strict=True)
    }
    rows = np.concatenate([first + part.centres for (first, _), part in zip(ranges, blocks, strict=True)])
    columns = {name: values[rows] for name, values in measurements.columns.items()}
    columns |= {name: np.concatenate(parts) for name, parts in states.items()}
    for name, along in zip(roles.inputs, measurements.inputs, strict=True):
        if name != roles.time:
            columns[name] = np.concatenate([*map(input_means, blocks, whole.times, along)])
    if roles.weights is not None:  # inverse variances of independent errors add up in a mean
        parts = zip(blocks, ranges, strict=True)
        columns[roles.weights] = np.concatenate(
            [part.means(weights[slice(*place)]) * part.sizes for part, place in parts]
        )
    ends = np.cumsum([0, *(len(part.ranges) for part in blocks)]).tolist()
    sentence = Note(
        f"States change little from row to row: means of {count} rows replace the {measurements.row_count} rows, "
        f"{len(rows)} in all. Noise and residuals refer to the means."
    )
    times = tuple(times[part.centres] for times, part in zip(whole.times, blocks, strict=True))
    return replace(
        measurements,
        columns=columns,
        ranges=tuple(pairwise(ends)),
        trajectories=replace(whole, times=times, states=states),
        warnings=(*measurements.warnings, sentence),
        rows_of_mean=count,
    )


def _state_means(
    blocks: Blocks, values: FloatArray, estimate: StateEstimate, weights: FloatArray, place: slice
) -> FloatArray:
    """Return the means (B,) of a state along trajectory `place`.

    They are NaN in divided blocks and where most rows are missing.
    """
    if estimate.is_interpolated:
        return np.asarray(values[blocks.centres])
    smoothed, is_measured = estimate.values[place], np.isfinite(values)
    known = is_measured * weights[place]
    if estimate.robustness_weights is not None:
        known = known * estimate.robustness_weights[place]
    residuals = np.where(is_measured, values - smoothed, 0.0)
    totals, shares = blocks.means(known), blocks.means(is_measured.astype(np.float64))
    is_known = blocks.is_whole & (totals > 0.0) & (2.0 * shares >= 1.0)
    means = blocks.means(known * residuals) / np.where(is_known, totals, 1.0)
    return np.where(is_known, smoothed[blocks.centres] + means, np.nan)
