"""From a raw table to the regression problems of a job: the stages of preparation, in order. Pure.

1. Roles of columns, trajectories, and checks of the columns (`examine`).
2. Smoothing and differentiation. Both are repeated if trajectories are split at gaps in the times. Both are repeated on
   averaged rows if the rows are far denser than the states' time scales need.
3. Selection of rows, the `Dataset` of the search and the recording.

Stochastic processes are not smoothed. If the table contains the left-hand sides, nothing is differentiated.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np

from atoll_coordinator.data.columns.examination import Examination, examine
from atoll_coordinator.data.differentiation.derivatives import (
    Differentiation,
    StateEstimate,
    derivative_standard_deviation,
    representable_standard_deviation,
)
from atoll_coordinator.data.differentiation.held_inputs import estimate_driven_states
from atoll_coordinator.data.differentiation.inputs import (
    choose_input_kind,
    estimate_input_slopes,
    relative_curve_error,
)
from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.increments import assemble_process
from atoll_coordinator.data.prior_knowledge import resolve_equations
from atoll_coordinator.data.recording import (
    InputKind,
    Method,
    Preparation,
    Recording,
    Source,
    StateSmoothing,
    Trajectory,
)
from atoll_coordinator.data.roles.roles import Roles, assign_symbols
from atoll_coordinator.data.row_means import average_oversampled_rows, estimates_of_means
from atoll_coordinator.data.searched_rows import (
    SelectedRows,
    normalize_weights,
    select_searched_rows,
    select_weighty_rows,
    thin_searched_rows,
)
from atoll_coordinator.data.trajectories.measurements import Measurements, split_at_gaps
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import CLEAN_UNCERTAINTY, AnyArray, Dataset, FloatArray, Target
from atoll_core.data.table import Table
from atoll_core.errors import DataError

_MOST_OUTLIERS: Final = 0.1
"""Share of the rows above which outliers are probably not measurement errors."""
_MANY_OUTLIERS: Final = "; so many outliers suggest that rows are too far apart for --robust, not that they are wrong"


def assemble_with_given_sides(
    measurements: Measurements,
    weights: FloatArray | None,
    selected: list[int],
    equations: Collection[str],
    symbols: Mapping[str, str],
) -> Preparation:
    """Return the problems of a table that contains the left-hand sides: labels or derivatives, treated as exact.

    The `equations` become problems over the rows `selected`; fits use every row that is not held out. `weights` (R,)
    are 1 on average, None: all are 1; `symbols` maps column names to names in expressions.
    """
    roles, warnings = measurements.roles, measurements.warnings
    searched = measurements.searched_rows
    if len(selected) < len(searched):
        count = f"{len(searched) - len(selected)} of {len(searched)} rows"
        warnings = (
            *warnings, f"{count} have little weight and are left out of the search; fits use them with their weight."
        )  # fmt: skip
    targets = []
    for name, column in zip(roles.equations, roles.derivatives or roles.equations, strict=True):
        values = measurements.columns[column]
        deviation = representable_standard_deviation(column, values[selected])
        if name in equations:
            targets.append(Target(name, roles.left_hand_side(name), values, 0.0, deviation))
    inputs = np.array([measurements.columns[name] for name in roles.variables])
    whole = Dataset(tuple(symbols.values()), inputs, tuple(targets), dict(symbols), warnings)
    held_out = _take_rows(whole, measurements.held_out_rows) if any(measurements.held_out) else None
    return Preparation(
        _take_rows(whole, selected),
        held_out=held_out,
        weights=None if weights is None else weights[searched],
        counted=_take_rows(whole, searched) if len(selected) < len(searched) else None,
    )


def assemble_differentiated(
    measurements: Measurements,
    weights: FloatArray | None,
    estimates: Sequence[StateEstimate],
    selected: SelectedRows,
    equations: Collection[str],
    symbols: Mapping[str, str],
) -> Preparation:
    """Return the problems and the recording of smoothed and differentiated states.

    The `measurements` have trajectories, `weights` (R,) are the weights of all rows, and `estimates` has one estimate
    for each state. Raises DataError if too few rows are selected, or if a derivative cannot be a target.
    """
    roles = measurements.roles
    warnings = [*measurements.warnings, *selected.warnings, *_remarks(measurements, estimates, selected)]
    values = [
        estimate.values if estimate.points is None else estimate.points
        for name, estimate in zip(roles.states, estimates, strict=True)
        if name not in roles.observed
    ]
    # the number of each row stands for a hidden state until a template was fitted
    values += [np.arange(float(measurements.row_count)) for _ in roles.hidden]
    values += [estimate.velocity for estimate in estimates if roles.velocities]
    values += [np.concatenate(parts) for parts in measurements.inputs]
    targets = [
        _derivative_target(name, roles.left_hand_side(name), estimate, selected.searched)
        for name, estimate in zip(roles.states, estimates, strict=True)
        if name not in roles.observed
    ]
    targets += [
        Target(name, roles.left_hand_side(name), np.zeros(measurements.row_count), 1.0, 1.0, 1.0)
        for name in roles.hidden
    ]
    sought = tuple(target for target in targets if target.variable in equations)
    recording = _add_hidden_states(_recording(measurements, weights, estimates, selected, symbols), roles, symbols)
    error, noise = recording.input_error, max(part.relative_noise for part in recording.smoothing)
    if error > max(noise, SETTINGS.selection.least_noise):
        of_inputs = f"Between rows, inputs ({', '.join(recording.inputs)}) are uncertain by {100.0 * error:.2g} %"
        more = "equations that differ by less cannot be distinguished; sample inputs more often"
        warnings.append(f"{of_inputs} of their standard deviation, more than the noise of the states: {more}.")
    names, groups = tuple(symbols.values()), measurements.group_of_row
    whole = Dataset(names, np.array(values), sought, dict(symbols), tuple(warnings), groups)
    held_out = _take_rows(whole, selected.held_out) if selected.held_out else None
    return Preparation(_take_rows(whole, selected.searched), recording, held_out)


def _take_rows(dataset: Dataset, rows: list[int]) -> Dataset:
    targets = [replace(target, values=np.ascontiguousarray(target.values[rows])) for target in dataset.targets]
    groups = None if dataset.groups is None else np.ascontiguousarray(dataset.groups[rows])
    inputs = np.ascontiguousarray(dataset.inputs[:, rows])
    return replace(dataset, inputs=inputs, targets=tuple(targets), groups=groups)


def _derivative_target(name: str, lhs: str, estimate: StateEstimate, rows: list[int]) -> Target:
    """Return the target over all rows, with the uncertainty and the standard deviation of the selected rows.

    A noise-free derivative that changes from row to row by no more than its uncertainty may be constant. The size of
    such a derivative replaces its standard deviation. Otherwise the errors of any equation would be large relative to
    so small a standard deviation, and the search would not end.
    """
    values = np.ascontiguousarray(estimate.derivative[rows])
    scale = derivative_standard_deviation(name, values)
    uncertainty, _ = moments(np.ascontiguousarray(estimate.uncertainty[rows] / scale))
    if not math.isfinite(uncertainty):
        raise DataError(f"the uncertainty of the derivative of '{name}' cannot be estimated; sample more often")
    mean, deviation = moments(values)
    if not estimate.target_noise and uncertainty >= 1.0 and uncertainty * scale < CLEAN_UNCERTAINTY * abs(mean):
        uncertainty, scale = uncertainty * scale / abs(mean), abs(mean)
    if deviation < scale:  # constant except for rounding errors; the comparison of two orders underestimates them
        uncertainty = max(uncertainty, deviation / scale)
    return Target(name, lhs, estimate.derivative, uncertainty, scale, estimate.target_noise)


def _remarks(measurements: Measurements, estimates: Sequence[StateEstimate], selected: SelectedRows) -> list[str]:
    states = measurements.roles.states
    if len(selected.searched) < SETTINGS.common.fewest_rows:
        named = ", ".join(states)
        raise DataError(f"only {len(selected.searched)} rows of {named} can be differentiated; sample more of them")
    remarks = []
    for state, estimate in zip(states, estimates, strict=True):
        if estimate.outliers:
            count = f"{estimate.outliers} {'outlier' if estimate.outliers == 1 else 'outliers'} without weight"
            is_likely = estimate.outliers <= _MOST_OUTLIERS * measurements.row_count
            remarks.append(f"State '{state}' has {count}{'' if is_likely else _MANY_OUTLIERS}.")
    tailed = ", ".join(state for state, estimate in zip(states, estimates, strict=True) if estimate.has_heavy_tails)
    if tailed:
        remarks.append(f"Some measurements of {tailed} look like outliers; --robust removes their weight.")
    if any(measurements.held_out) and not selected.held_out:
        remarks.append("No held-out row can be differentiated well; equations are not judged by held-out rows.")
    return remarks


# ---------------------------------------------------------------------------------------------------------- recording


def _recording(
    measurements: Measurements,
    weights: FloatArray | None,
    estimates: Sequence[StateEstimate],
    selected: SelectedRows,
    symbols: Mapping[str, str],
) -> Recording:
    roles, whole = measurements.roles, measurements.trajectories
    assert whole is not None
    known: dict[str, InputKind] = dict.fromkeys(roles.held, "held")
    if roles.time is not None:
        known[roles.time] = "smooth"
    pairs = zip(roles.inputs, measurements.inputs, strict=True)
    kinds = tuple(known.get(name) or choose_input_kind(whole.times, along) for name, along in pairs)
    smoothing = []
    for state, estimate, rows, excluded in zip(
        roles.states, estimates, selected.uncertain, selected.excluded, strict=True
    ):
        smoother = estimate.smoother
        method: Method = "loess" if estimate.outliers is None else "robust loess"
        smoothing.append(
            StateSmoothing(
                state,
                "interpolation" if smoother is None else method,
                estimate.noise,
                estimate.relative_noise,
                None if smoother is None else smoother.rows,
                None if smoother is None else smoother.degree,
                len(rows),
                estimate.outliers or 0,
                excluded,
                estimate.narrower_noise,
                estimate.narrower_span,
                estimate.quantisation,
            )
        )
    return Recording(
        roles.states,
        tuple(symbols.get(name, name) for name in roles.states),  # observed columns are no variables
        tuple(symbols[name] for name in roles.velocities),
        roles.inputs,
        tuple(symbols[name] for name in roles.inputs),
        roles.order,
        whole.offset,
        tuple(smoothing),
        _trajectories(measurements, weights, estimates, kinds),
        roles.offsets,
        measurements.group_names,
        measurements.rows_of_mean,
        kinds,
        max(map(partial(relative_curve_error, whole.times), measurements.inputs, kinds), default=0.0),
    )


def _add_hidden_states(recording: Recording, roles: Roles, symbols: Mapping[str, str]) -> Recording:
    """Return the recording with the hidden states after the columns. Their course is 0 until a template is fitted."""
    if not roles.hidden and not roles.observed:
        return recording
    count = len(roles.hidden)

    def extended(values: AnyArray | None, filling: float) -> Any:
        if values is None:
            return None
        return np.concatenate([values, np.full((count, values.shape[1]), filling, values.dtype)])

    trajectories = tuple(
        replace(
            part,
            measured=extended(part.measured, np.nan), smoothed=extended(part.smoothed, 0.0),
            slopes=extended(part.slopes, 0.0), robustness_weights=extended(part.robustness_weights, 1.0),
            is_known=extended(part.is_known, 1), rates=extended(part.rates, 0.0),
            rate_errors=extended(part.rate_errors, np.inf),
        )
        for part in recording.trajectories
    )  # fmt: skip
    return replace(
        recording,
        states=(*recording.states, *roles.hidden),
        state_symbols=(*recording.state_symbols, *(symbols[name] for name in roles.hidden)),
        smoothing=(*recording.smoothing, *(StateSmoothing(name, "hidden", 0.0, 0.0) for name in roles.hidden)),
        trajectories=trajectories,
        hidden=roles.hidden,
        observed=roles.observed,
    )


def _trajectories(
    measurements: Measurements,
    weights: FloatArray | None,
    estimates: Sequence[StateEstimate],
    kinds: Sequence[InputKind],
) -> tuple[Trajectory, ...]:
    roles, whole, ranges = measurements.roles, measurements.trajectories, measurements.ranges
    assert whole is not None
    inputs = measurements.inputs
    nothing = [None] * len(ranges)

    def parts(columns: Sequence[FloatArray]) -> list[FloatArray]:
        """Return for each trajectory the columns (R,) as the rows of one array in C order."""
        stacked = np.array(columns, dtype=np.float64).reshape(len(columns), measurements.row_count)
        return [np.ascontiguousarray(stacked[:, slice(*place)]) for place in ranges]

    slopes = [estimate_input_slopes(whole.times, along, kind) for along, kind in zip(inputs, kinds, strict=True)]
    if roles.time in roles.inputs:
        slopes[roles.inputs.index(roles.time)] = [np.ones(len(times)) for times in whole.times]
    is_known = np.array([estimate.is_known for estimate in estimates])
    robustness_weights = [estimate.robustness_weights for estimate in estimates]
    is_robust = any(own is not None for own in robustness_weights)
    is_between = any(estimate.points is not None for estimate in estimates)
    ones = np.ones(measurements.row_count)
    columns = zip(
        whole.names,
        whole.times,
        parts([np.concatenate(along) for along in whole.states.values()]),
        parts([estimate.values for estimate in estimates]),
        parts([estimate.velocity for estimate in estimates]),
        parts([np.concatenate(along) for along in inputs]),
        parts([np.concatenate(along) for along in slopes]),
        measurements.held_out,
        parts([ones if own is None else own for own in robustness_weights]) if is_robust else nothing,
        nothing if weights is None else [np.ascontiguousarray(weights[slice(*place)]) for place in ranges],
        nothing if is_known.all() else [np.ascontiguousarray(is_known[:, slice(*place)]) for place in ranges],
        nothing if is_between else parts([estimate.derivative for estimate in estimates]),
        nothing if is_between else parts([estimate.total_uncertainty for estimate in estimates]),
        measurements.groups or [""] * len(ranges),
        strict=True,
    )
    return tuple(Trajectory(*column) for column in columns)


def prepare(table: Table, config: JobConfig) -> Preparation:
    """Return the regression problems of `table` under `config`, and the recording from which they were made.

    Raises UsageError if options contradict each other, DataError if the measurements cannot be used.
    """
    examination = examine(table, config)
    roles, options = examination.roles, examination.options
    units = {name: unit for name, unit in zip(table.names, table.units, strict=True) if unit} | options.units
    role_values = (roles.time, roles.states, roles.velocities, roles.inputs, roles.target, roles.order)
    source = Source(table.digest, table.files, table.rows, units, *role_values, table.read_as)
    return replace(_prepare(examination, config), source=source)


def _prepare(examination: Examination, config: JobConfig) -> Preparation:
    roles, options, measurements = examination.roles, examination.options, examination.measurements
    symbols = assign_symbols(roles.variables)
    _, equations = resolve_equations(config.model_copy(update={"data": options}), roles, symbols)

    if options.stochastic:
        return assemble_process(measurements, equations, symbols)
    weights = normalize_weights(measurements.weights)
    if measurements.trajectories is None:
        rows = select_weighty_rows(weights, measurements.searched_rows)
        return assemble_with_given_sides(measurements, weights, rows, equations, symbols)

    differentiation = Differentiation(options.order, config.preset == "paper", options.robust)
    whole, estimates = measurements, estimate_driven_states(measurements, weights, differentiation)
    measurements = split_at_gaps(whole, max(estimate.span for estimate in estimates))
    if measurements.ranges != whole.ranges:
        weights = normalize_weights(measurements.weights)
        estimates = estimate_driven_states(measurements, weights, differentiation)
    if not differentiation.paper:
        sampled = measurements
        measurements = average_oversampled_rows(sampled, estimates)
        if measurements is not sampled:
            weights = normalize_weights(measurements.weights)
            estimates = estimates_of_means(estimate_driven_states(measurements, weights, differentiation), estimates)

    selected = select_searched_rows(measurements, estimates, paper=differentiation.paper)
    if not differentiation.paper:
        selected = thin_searched_rows(selected, [estimate.values for estimate in estimates])
    return assemble_differentiated(measurements, weights, estimates, selected, equations, symbols)
