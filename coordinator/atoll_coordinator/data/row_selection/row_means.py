"""Rows that follow one another faster than the states change, averaged to as many as the time scales need. Pure.

A law shows in trajectories over the states' own times. Fits, pieces and libraries count rows: sampled ten times as
fast, the same motion would be compared in pieces a tenth as long, along which a line describes any curve. Means keep
the information of the rows: independent errors of a mean of n rows are smaller by the square root of n.

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

LIMITS = SETTINGS.rows
_LEAST_BLOCKS: Final = SETTINGS.smoothing.bins // 2
"""Means of a trajectory, at least, if it has as many rows: loess needs some."""
_SCANNED: Final = 2 * LIMITS.most
"""Rows of a trajectory, about, by which its correlation length is found: enough for a thousandth of it."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """Parts of the rows of one trajectory, each of which becomes one row.

    `ranges` (B, 2) are half-open and cover all rows; `is_whole` (B,) is false for the parts of a block that had to be
    divided, because an input changes fast in it.
    """

    ranges: IntArray
    is_whole: npt.NDArray[np.bool_]

    @property
    def centres(self) -> IntArray:
        """The row in the middle of each block (B,)."""
        return np.asarray((self.ranges[:, 0] + self.ranges[:, 1]) // 2)

    @property
    def sizes(self) -> IntArray:
        """How many rows each block has (B,)."""
        return np.asarray(self.ranges[:, 1] - self.ranges[:, 0])

    @property
    def divided_rows(self) -> int:
        """How many rows are in divided blocks."""
        return int(self.sizes[~self.is_whole].sum())

    def means(self, values: FloatArray) -> FloatArray:
        """Return the mean (B,) of `values` (R,) over each block, summed in order."""
        return np.array([moments(values[first:end])[0] for first, end in self.ranges.tolist()])

    def divided(self, is_divided: npt.NDArray[np.bool_]) -> "Blocks":
        """Return the blocks with some of them (B,) in two halves each."""
        ranges: list[tuple[int, int]] = []
        is_whole: list[bool] = []
        for (first, end), is_here, whole in zip(self.ranges.tolist(), is_divided, self.is_whole.tolist(), strict=True):
            middle = (first + end) // 2
            ranges += [(first, middle), (middle, end)] if is_here else [(first, end)]
            is_whole += [False, False] if is_here else [whole]
        return Blocks(np.array(ranges, np.int64), np.array(is_whole))


def average_oversampled_rows(measurements: Measurements, estimates: Sequence[StateEstimate]) -> Measurements:
    """Return `measurements` with means in place of rows where there are far more than the states' time scales need.

    The same object otherwise, and where the noise of all states is negligible: then each row is as good as a mean. The
    mean of a state is the mean of its residuals, added to the smoothed value in the middle: so it has no bias by
    curvature. Where an input changes so fast that its means would move the states by more than their noise, as where it
    is switched, blocks are divided, down to single rows, and the states count as not measured there. Rows of inputs
    that are held between rows stay as they are: a mean over a switch is held by no row.
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
    """Return the `estimates` of means with the outliers, which only rows show."""
    return [
        replace(
            one,
            has_heavy_tails=one.has_heavy_tails or rows.has_heavy_tails,
            outliers=rows.outliers if one.outliers is None else one.outliers + (rows.outliers or 0),
        )
        for one, rows in zip(estimates, of_rows, strict=True)
    ]


def rows_of_mean(measurements: Measurements, estimates: Sequence[StateEstimate]) -> int:
    """Return the number of rows of a mean; 1 where rows are to stay as they are.

    The states' fastest correlation length gets as many rows as the shortest segments have, or more where so few rows
    are needed neither for a comparison of all of them nor for pieces that are whole trajectories.
    """
    lengths = [last - first for (first, last), out in zip(measurements.ranges, measurements.held_out, strict=True)
               if not out]  # fmt: skip
    longest, piece = max(lengths), SETTINGS.shooting.piece
    of_whole = 1 if longest <= piece else math.ceil(longest / (piece * (1.0 - SETTINGS.inference.part)))
    most = min(max(sum(lengths) // SETTINGS.selection.compared_rows, of_whole), longest // _LEAST_BLOCKS)
    least = SETTINGS.selection.least_noise  # below it errors are systematic, and means are no better
    if most < 2 or all(estimate.is_interpolated or estimate.relative_noise < least for estimate in estimates):
        return 1
    fewest = SETTINGS.shooting.lengths[0]
    return max(1, min(most, *(correlation_length(measurements, estimate) // fewest for estimate in estimates)))


def correlation_length(measurements: Measurements, estimate: StateEstimate) -> int:
    """Return after how many rows the autocorrelation of a state's steps from row to row falls below 1/e.

    For a sinusoid that is 0.19 of its period. Held-out trajectories are not looked at; sums run in order.
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
    """Return the blocks of each trajectory for means of `count` rows, divided where inputs need it.

    An input may err by its standard deviation for as long as the noise hides the motion that this causes. Inputs make a
    state's rate vary by no more than its standard deviation. The errors of the blocks of a correlation length add up as
    independent ones, to no more than the noise of a mean.
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
    """Return the blocks so divided that the integral of an input, from their rows, errs by no more than `limit`.

    Errors count from the beginning of a block to any of its rows. Dividing ends once more than `most` rows are in
    divided blocks.
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
    """Return an input (B,) at the centres of blocks: of the parabola that fits the rows of each block best.

    Each block counts for itself, so that nothing is carried over a switch of the input. With three rows and fewer the
    parabola passes through the row in the middle.
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
    """Return the cubics through `values` (R,), three or more, at the times `wanted`.

    The slope at each row is the slope of the parabola through it and its neighbours.
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
    """Return a state (B,) along the rows at one `place`: NaN in divided blocks and where most rows are missing."""
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
