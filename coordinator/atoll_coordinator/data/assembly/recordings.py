"""The recording of a job, put together from what was measured and how it was smoothed. Pure."""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from atoll_coordinator.data.differentiation.derivatives import StateEstimate
from atoll_coordinator.data.differentiation.inputs import (
    choose_input_kind,
    estimate_input_slopes,
    relative_curve_error,
)
from atoll_coordinator.data.recording import ExcludedRow, InputKind, Method, Recording, Smoothing, Trajectory
from atoll_coordinator.data.row_selection.selected_rows import SelectedRows
from atoll_coordinator.data.trajectories.measurements import Measurements
from atoll_core.data.dataset import FloatArray


def build_recording(
    measurements: Measurements,
    weights: FloatArray | None,
    estimates: Sequence[StateEstimate],
    inputs: Sequence[Sequence[FloatArray]],
    selected: SelectedRows,
    symbols: Mapping[str, str],
) -> Recording:
    """Return the recording of states measured in time.

    Args:
        measurements: with trajectories.
        weights: of the rows, 1 on average; None: all are 1.
        estimates: one for each state.
        inputs: for each input, its values along each trajectory.
        selected: which rows the search sees, and because of which state it does not see others.
        symbols: by column name, the name in expressions.
    """
    roles, whole = measurements.roles, measurements.trajectories
    assert whole is not None
    kinds = _input_kinds(measurements, inputs)
    smoothing = map(_describe_smoothing, roles.states, estimates, map(len, selected.uncertain), selected.excluded)
    return Recording(
        roles.states,
        tuple(symbols[name] for name in roles.states),
        tuple(symbols[name] for name in roles.velocities),
        roles.inputs,
        tuple(symbols[name] for name in roles.inputs),
        roles.order,
        whole.offset,
        tuple(smoothing),
        _trajectories(measurements, weights, estimates, inputs, kinds),
        roles.offsets,
        measurements.group_names,
        measurements.rows_of_mean,
        kinds,
        max(map(partial(relative_curve_error, whole.times), inputs, kinds), default=0.0),
    )


def _input_kinds(measurements: Measurements, inputs: Sequence[Sequence[FloatArray]]) -> tuple[InputKind, ...]:
    """Return how each input goes from row to row: the time is smooth, others as options say, else as fits better."""
    roles, whole = measurements.roles, measurements.trajectories
    assert whole is not None
    known: dict[str, InputKind] = dict.fromkeys(roles.held, "held")
    if roles.time is not None:
        known[roles.time] = "smooth"
    pairs = zip(roles.inputs, inputs, strict=True)
    return tuple(known.get(name) or choose_input_kind(whole.times, along) for name, along in pairs)


def _trajectories(
    measurements: Measurements,
    weights: FloatArray | None,
    estimates: Sequence[StateEstimate],
    inputs: Sequence[Sequence[FloatArray]],
    kinds: Sequence[InputKind],
) -> tuple[Trajectory, ...]:
    """Return the trajectories of a recording, inputs being of these `kinds`; others are those of `build_recording`."""
    roles, whole, ranges = measurements.roles, measurements.trajectories, measurements.ranges
    assert whole is not None

    def parts(columns: Sequence[FloatArray]) -> list[FloatArray]:
        """Return columns (R,) of all rows as the rows of one array, for each trajectory, in C order."""
        stacked = np.array(columns, dtype=np.float64).reshape(len(columns), measurements.row_count)
        return [np.ascontiguousarray(stacked[:, slice(*place)]) for place in ranges]

    slopes = [estimate_input_slopes(whole.times, along, kind) for along, kind in zip(inputs, kinds, strict=True)]
    if roles.time in roles.inputs:
        slopes[roles.inputs.index(roles.time)] = [np.ones(len(times)) for times in whole.times]
    is_known = np.array([estimate.is_known for estimate in estimates])
    robustness_weights = [estimate.robustness_weights for estimate in estimates]
    is_between = any(estimate.points is not None for estimate in estimates)
    ones = np.ones(measurements.row_count)
    nothing = [None] * len(ranges)
    columns = zip(
        whole.names,
        whole.times,
        parts([np.concatenate(along) for along in whole.states.values()]),
        parts([estimate.values for estimate in estimates]),
        parts([estimate.velocity for estimate in estimates]),
        parts([np.concatenate(along) for along in inputs]),
        parts([np.concatenate(along) for along in slopes]),
        measurements.held_out,
        nothing
        if all(weights_of is None for weights_of in robustness_weights)
        else parts([ones if weights_of is None else weights_of for weights_of in robustness_weights]),
        nothing if weights is None else [np.ascontiguousarray(weights[slice(*place)]) for place in ranges],
        nothing if is_known.all() else [np.ascontiguousarray(is_known[:, slice(*place)]) for place in ranges],
        nothing if is_between else parts([estimate.derivative for estimate in estimates]),
        nothing if is_between else parts([estimate.total_uncertainty for estimate in estimates]),
        measurements.groups or [""] * len(ranges),
        strict=True,
    )
    return tuple(Trajectory(*column) for column in columns)


def _describe_smoothing(
    state: str, estimate: StateEstimate, uncertain: int, excluded: tuple[ExcludedRow, ...]
) -> Smoothing:
    smoother = estimate.smoother
    method: Method = "loess" if estimate.outliers is None else "robust loess"
    return Smoothing(
        state,
        "interpolation" if smoother is None else method,
        estimate.noise,
        estimate.relative_noise,
        None if smoother is None else smoother.rows,
        None if smoother is None else smoother.degree,
        uncertain,
        estimate.outliers or 0,
        excluded,
        estimate.narrower_noise,
        estimate.narrower_span,
        estimate.quantisation,
    )
