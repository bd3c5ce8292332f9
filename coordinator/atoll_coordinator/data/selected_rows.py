"""Selects the rows of the search by the uncertainty of derivatives, or by weight; reasons for excluded rows. Pure.

For interpolated states, two kinds of rows are excluded: the ends of trajectories, and rows with very uncertain
derivatives (jumps, and passages near a singularity that the sampling does not resolve). For smoothed states, rows are
excluded if their total uncertainty (standard error and estimated bias) is far above the median.

Oversampled rows are averaged first: means replace rows, as many as the states' time scales need. The reason is that
lengths of segments, pieces and windows are numbers of rows. At a sampling rate ten times as high, a piece would be a
tenth as long, and along so short a piece a line describes any curve. Averaging n rows divides the independent error by
sqrt(n).

Letters: R rows of one trajectory, B blocks of rows, S states.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.differentiation.derivatives import ROUNDING, StateEstimate, bounded_standard_deviation
from atoll_coordinator.data.differentiation.interpolation import END_ROWS, mark_ends
from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.differentiation.smoothing import ROUNDS
from atoll_coordinator.data.recording import ExcludedRow, Reason
from atoll_coordinator.data.trajectories.measurements import Measurements
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, IntArray
from atoll_core.data.notes import Note

LIMITS = SETTINGS.rows
FAR_OUT = LIMITS.over_median_uncertainty
_GAP_STEPS: Final = 3.0
"""A time step counts as a gap if it is this many times as long as the median time step of its trajectory."""
_END_SHARE: Final = 0.25
"""Rows closer to the end of a trajectory than this share of a span have most neighbours on one side."""


@dataclass(frozen=True)
class SelectedRows:
    """The selected rows: `searched` for the search, `held_out` of held-out trajectories.

    For each state, `uncertain` has the rows of searched trajectories whose derivative of this state is too uncertain,
    and `excluded` the rows that are not used because of it, with the reasons; `warnings` are sentences for the user.
    """

    searched: list[int]
    held_out: list[int]
    uncertain: tuple[frozenset[int], ...]
    excluded: tuple[tuple[ExcludedRow, ...], ...]
    warnings: tuple[str, ...]


def select_rows(measurements: Measurements, estimates: Sequence[StateEstimate], *, paper: bool) -> SelectedRows:
    """Return the rows that all targets use (all rows for `paper`); the same limits apply to held-out rows."""
    assert measurements.trajectories is not None
    times = measurements.trajectories.times
    is_known = np.all([estimate.is_known for estimate in estimates], axis=0)
    every = measurements.searched_rows
    searched = [row for row in every if is_known[row]]
    held_out = [row for row in measurements.held_out_rows if is_known[row]]
    selected, within, warnings = searched, held_out, list[str]()
    uncertain = [frozenset[int]()] * len(estimates)
    if not paper:
        interpolated = [estimate for estimate in estimates if estimate.is_interpolated]
        smoothed = [estimate for estimate in estimates if not estimate.is_interpolated]
        ends = mark_ends([len(part) for part in times]) if interpolated else np.zeros(measurements.row_count)
        inner = [row for row in searched if ends[row] == 0.0]
        certain = _certain_interpolated(interpolated, inner)
        selected = _certain_smoothed(smoothed, certain)
        totals = [estimate.total_uncertainty for estimate in estimates]
        limits = [float(np.max(total[selected], initial=0.0)) for total in totals]
        pairs = list(zip(totals, limits, strict=True))
        uncertain = [frozenset(row for row in every if limit < total[row] < math.inf) for total, limit in pairs]
        within = [row for row in held_out if ends[row] == 0.0 and all(total[row] <= limit for total, limit in pairs)]
        if len(inner) < len(searched):
            rows = f"{END_ROWS} rows at each end of a trajectory"
            warnings.append(Note(f"Data without noise are interpolated, not smoothed; {rows} are left out."))
        if len(certain) < len(inner):
            count = f"{len(inner) - len(certain)} of {len(inner)} rows"
            warnings.append(f"{count} change too fast for the sampling interval and are left out.")
        if len(selected) < len(certain):
            count = f"{len(certain) - len(selected)} of {len(certain)} rows"
            at = "(at ends and jumps)"
            warnings.append(f"{count} have uncertain derivatives {at} and are left out of the search.")
    excluded = [
        explain_excluded_rows(times, estimate, own, frozenset(every))
        for estimate, own in zip(estimates, uncertain, strict=True)
    ]
    return SelectedRows(selected, within, tuple(uncertain), tuple(excluded), tuple(warnings))


def _certain_interpolated(estimates: Sequence[StateEstimate], inner: list[int]) -> list[int]:
    """Return the rows of `inner` whose relative uncertainty is small enough for every state.

    The uncertainty of a target is the mean over its rows, but equations are compared by mean squared error. If a few
    rows are far more uncertain than the others, their errors dominate the squares, and a wrong term that fits these
    errors looks like an improvement. So the most uncertain rows are left out until, for every state, the root mean
    square of the uncertainty is at most `most_uneven` times its mean.
    """
    if not estimates or not inner:
        return inner
    selected = inner
    least = math.ceil(LIMITS.least_kept * len(inner))
    for _ in range(ROUNDS):
        worst = np.zeros(len(inner))
        for estimate in estimates:
            deviation = bounded_standard_deviation(estimate.derivative[selected], SETTINGS.common.negligible)
            worst = np.maximum(worst, estimate.uncertainty[inner] / deviation)
        ordered = np.sort(worst).tolist()
        limit = max(SETTINGS.common.clean, FAR_OUT * ordered[len(inner) // 2], ordered[least - 1])
        selected = [row for row, uncertainty in zip(inner, worst.tolist(), strict=True) if uncertainty <= limit]
    for estimate in estimates:
        uncertainty = estimate.uncertainty[selected].tolist()
        ordered = sorted(uncertainty)
        total, square, enough = 0.0, 0.0, 0
        for count, value in enumerate(ordered, start=1):
            total += value
            square += value * value
            if count <= least or square * count <= (LIMITS.most_uneven * total) ** 2:
                enough = count
        limit = ordered[enough - 1] if enough else math.inf
        selected = [row for row, value in zip(selected, uncertainty, strict=True) if value <= limit]
    return selected


def _certain_smoothed(estimates: Sequence[StateEstimate], rows: list[int]) -> list[int]:
    """Return the rows whose total uncertainty, relative to its median, is small enough for every state."""
    worst = np.zeros(len(rows))
    for estimate in estimates:
        uncertainty = estimate.total_uncertainty[rows]
        median = float(np.sort(uncertainty)[len(rows) // 2]) if rows else 0.0
        if median > 0.0:
            worst = np.maximum(worst, uncertainty / median)
    ordered = np.sort(worst).tolist()
    least = min(max(math.ceil(LIMITS.least_kept * len(rows)), SETTINGS.common.fewest_rows), len(rows))
    limit = max(FAR_OUT, ordered[least - 1]) if rows else FAR_OUT
    return [row for row, value in zip(rows, worst.tolist(), strict=True) if value <= limit]


def explain_excluded_rows(
    times: Sequence[FloatArray], estimate: StateEstimate, uncertain: Collection[int], searched: Collection[int]
) -> tuple[ExcludedRow, ...]:
    """Return the rows that the search does not see because of one state, and its outliers, in order.

    Row numbers and `times` run through all trajectories, one after the other. Derivatives are too uncertain at the rows
    `uncertain`; the rows `searched` belong to trajectories that are not held out.
    """
    lengths = [len(part) for part in times]
    cut_off = mark_ends(lengths) if estimate.is_interpolated else np.zeros(sum(lengths))
    span = 0 if estimate.smoother is None else estimate.smoother.rows
    weights, is_known = estimate.robustness_weights, estimate.is_known
    excluded: list[ExcludedRow] = []
    first = 0
    for number, part in enumerate(times):
        rows, steps = len(part), np.diff(part)
        known = np.flatnonzero(is_known[first : first + rows]).tolist() or [0, rows - 1]
        reach = max(END_ROWS, int(_END_SHARE * min(span, rows)))
        is_near_gap = np.zeros(rows, np.bool_)
        for step in np.flatnonzero(steps > _GAP_STEPS * float(np.sort(steps)[len(steps) // 2])).tolist():
            is_near_gap[max(step + 1 - END_ROWS, 0) : step + 1 + END_ROWS] = True
        for row in range(rows):
            place = first + row
            is_outlier = weights is not None and weights[place] == 0.0
            is_missing = not is_known[place]
            if place not in searched or not (place in uncertain or cut_off[place] or is_outlier or is_missing):
                continue
            reasons: dict[Reason, bool] = {
                "missing": is_missing,
                "outlier": is_outlier,
                "end": cut_off[place] or min(row - known[0], known[-1] - row) < reach,
                "gap": bool(is_near_gap[row]),
                "jump": True,
            }
            excluded.append(ExcludedRow(number, row, next(reason for reason, holds in reasons.items() if holds)))
        first += rows
    return tuple(excluded)


def thin_searched_rows(selected: SelectedRows, states: Sequence[FloatArray], most: int = LIMITS.most) -> SelectedRows:
    """Return the selection, reduced to about `most` rows for the search if it has more; `states` are (R,) each.

    Derivatives of neighbouring rows come from the same measurements, so little information is lost. The kept rows are
    spread evenly over the row numbers and over the path length of each state, so that fast motion keeps enough rows.
    """
    rows = selected.searched
    if len(rows) <= most:
        return selected
    place = evenly = np.arange(len(rows)) / (len(rows) - 1)
    for state in states:
        way = np.cumsum(np.abs(np.diff(state[rows], prepend=state[rows[0]])))  # summed one after another, not in pairs
        place = place + (way / way[-1] if way[-1] > 0.0 else evenly)
    numbers = np.floor(place * ((most - 1) / (len(states) + 1)))
    is_kept = np.diff(numbers, prepend=-1.0) > 0.0
    kept = [row for row, keep in zip(rows, is_kept.tolist(), strict=True) if keep]
    sentence = Note(f"The search sees {len(kept)} of {len(rows)} rows, spread evenly; models are judged by all.")
    return replace(selected, searched=kept, warnings=(*selected.warnings, sentence))


def normalize_weights(weights: FloatArray | None) -> FloatArray | None:
    """Return positive weights (inverse variances) over their mean; None if there are none, or if all are equal."""
    if weights is None:
        return None
    scaled = weights / float(np.max(weights))
    mean, deviation = moments(scaled)
    return None if deviation <= ROUNDING * mean else np.ascontiguousarray(scaled / mean)


def select_weighty_rows(weights: FloatArray | None, rows: list[int]) -> list[int]:
    """Return the `rows` whose weight is not far below the median weight; at least a fixed share of the rows is kept.

    The search gives all rows equal weight (ADR 0027), so rows with far larger errors have to be left out of it.
    """
    if weights is None:
        return rows
    ordered = np.sort(weights[rows]).tolist()
    least = ordered[len(rows) - max(1, math.ceil(LIMITS.least_kept * len(rows)))]
    limit = min(ordered[len(rows) // 2] / LIMITS.over_median_uncertainty**2, least)
    return [row for row in rows if weights[row] >= limit]


_LEAST_BLOCKS: Final = SETTINGS.smoothing.bins // 2
"""Fewest means of the longest trajectory, because loess needs rows."""
_SCANNED: Final = 2 * LIMITS.most
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
