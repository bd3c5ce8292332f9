"""The regression problems of a job, put together from selected rows. Pure."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from atoll_coordinator.data.assembly.recordings import build_recording
from atoll_coordinator.data.differentiation.derivatives import StateEstimate
from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.differentiation.value_scale import (
    derivative_standard_deviation,
    representable_standard_deviation,
)
from atoll_coordinator.data.recording import Preparation, Recording
from atoll_coordinator.data.row_selection.selected_rows import SelectedRows
from atoll_coordinator.data.trajectories.measurements import Measurements
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import CLEAN_UNCERTAINTY, Dataset, FloatArray, Target
from atoll_core.errors import DataError

_MOST_OUTLIERS: Final = 0.1
"""Share of the rows beyond which outliers are said to be hardly errors of measurement."""
_MANY_OUTLIERS: Final = "; so many suggest that rows are too far apart for --robust, not that they are wrong"


def assemble_given(
    measurements: Measurements,
    weights: FloatArray | None,
    selected: list[int],
    equations: Collection[str],
    symbols: Mapping[str, str],
) -> Preparation:
    """Return the problems of a table that holds the left-hand sides: labels or derivatives, taken as exact.

    Problems are made of the `equations`, over the rows `selected`; fits use every row that is not held out. `weights`
    (R,) are 1 on average, None: all are 1; `symbols` has by column name the name in expressions.
    """
    roles, warnings = measurements.roles, measurements.warnings
    searched = measurements.searched_rows
    if len(selected) < len(searched):
        count = f"{len(searched) - len(selected)} of {len(searched)} rows"
        warnings = (
            *warnings, f"{count} have little weight and are left out of the search; fits count them by their weight."
        )  # fmt: skip
    targets = []
    for name, column in zip(roles.equations, roles.derivatives or roles.equations, strict=True):
        values = measurements.columns[column]
        deviation = representable_standard_deviation(column, values[selected])
        targets.append(Target(name, roles.left_hand_side(name), values, 0.0, deviation))
    inputs = np.array([measurements.columns[name] for name in roles.variables])
    sought = tuple(target for target in targets if target.variable in equations)
    whole = Dataset(tuple(symbols.values()), inputs, sought, dict(symbols), warnings)
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
    """Return the problems and the recording that smoothed and differentiated states make.

    The `measurements` have trajectories, `weights` (R,) are those of all rows, and there is one of the `estimates` for
    each state. Raises DataError where too few rows are selected, or a derivative cannot be a target.
    """
    roles = measurements.roles
    warnings = (*measurements.warnings, *selected.warnings, *_remarks(measurements, estimates, selected))
    inputs = measurements.inputs
    values = [estimate.values if estimate.points is None else estimate.points for estimate in estimates]
    values += [estimate.velocity for estimate in estimates if roles.velocities]
    values += [np.concatenate(parts) for parts in inputs]
    targets = [
        _target(name, roles.left_hand_side(name), estimate, selected.searched)
        for name, estimate in zip(roles.states, estimates, strict=True)
    ]
    sought = [target for target in targets if target.variable in equations]
    groups = measurements.group_of_row
    recording = build_recording(measurements, weights, estimates, inputs, selected, symbols)
    warnings = (*warnings, *_coarse_inputs(recording))
    whole = Dataset(tuple(symbols.values()), np.array(values), tuple(sought), dict(symbols), warnings, groups)
    return Preparation(
        _take_rows(whole, selected.searched),
        recording,
        _take_rows(whole, selected.held_out) if selected.held_out else None,
    )


def _coarse_inputs(recording: Recording) -> list[str]:
    """Return a sentence where inputs are less certain between rows than states are at them."""
    error, noise = recording.input_error, max(part.relative_noise for part in recording.smoothing)
    if error <= max(noise, SETTINGS.selection.least_noise):
        return []
    of_inputs = f"Between rows, inputs ({', '.join(recording.inputs)}) are uncertain by {100.0 * error:.2g} %"
    more = "equations that differ by less are not told apart; sample inputs more often"
    return [f"{of_inputs} of their standard deviation, more than the noise of the states: {more}."]


def _take_rows(dataset: Dataset, rows: list[int]) -> Dataset:
    targets = [replace(target, values=np.ascontiguousarray(target.values[rows])) for target in dataset.targets]
    groups = None if dataset.groups is None else np.ascontiguousarray(dataset.groups[rows])
    inputs = np.ascontiguousarray(dataset.inputs[:, rows])
    return replace(dataset, inputs=inputs, targets=tuple(targets), groups=groups)


def _target(name: str, lhs: str, estimate: StateEstimate, rows: list[int]) -> Target:
    """Return the target over all rows, with the uncertainty and the standard deviation of those selected.

    A derivative without noise that differs from row to row by no more than its uncertainty is constant as far as can be
    told, and is judged by its size: by so small a deviation any equation would seem uncertain, and no search would end.
    """
    values = np.ascontiguousarray(estimate.derivative[rows])
    scale = derivative_standard_deviation(name, values)
    uncertainty, _ = moments(np.ascontiguousarray(estimate.uncertainty[rows] / scale))
    if not math.isfinite(uncertainty):
        raise DataError(f"the uncertainty of the derivative of '{name}' cannot be told; sample more often")
    mean, deviation = moments(values)
    if not estimate.target_noise and uncertainty >= 1.0 and uncertainty * scale < CLEAN_UNCERTAINTY * abs(mean):
        uncertainty, scale = uncertainty * scale / abs(mean), abs(mean)
    if deviation < scale:  # constant but for rounding, of which a comparison of two orders sees only a part
        uncertainty = max(uncertainty, deviation / scale)
    return Target(name, lhs, estimate.derivative, uncertainty, scale, estimate.target_noise)


def _remarks(measurements: Measurements, estimates: Sequence[StateEstimate], selected: SelectedRows) -> list[str]:
    """Return sentences about what smoothing met; raises DataError when too few rows are left."""
    states = measurements.roles.states
    if len(selected.searched) < SETTINGS.checks.min_rows:
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
        remarks.append(f"Some measurements of {tailed} look like outliers; --robust takes their weight away.")
    if any(measurements.held_out) and not selected.held_out:
        remarks.append("No row that was held out can be differentiated well; equations are not judged by them.")
    return remarks
