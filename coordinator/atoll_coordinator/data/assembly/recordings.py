"""The recording of a job, put together from what was measured and how it was smoothed. Pure."""

from collections.abc import Mapping, Sequence

import numpy as np

from atoll.data.dataset import FloatArray
from atoll_coordinator.data.differentiation.derivatives import StateEstimate
from atoll_coordinator.data.differentiation.inputs import estimate_input_slopes
from atoll_coordinator.data.recording import Method, Recording, Smoothing, Trajectory
from atoll_coordinator.data.row_selection.rows import SelectedRows
from atoll_coordinator.data.trajectories.measurements import Measurements


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
    smoothing = []
    for place, (state, estimate) in enumerate(zip(roles.states, estimates, strict=True)):
        method: Method = "interpolation"
        if estimate.smoother is not None:
            method = "loess" if estimate.outliers is None else "robust loess"
        smoothing.append(
            Smoothing(
                state,
                method,
                estimate.noise,
                estimate.relative_noise,
                None if estimate.smoother is None else estimate.smoother.rows,
                None if estimate.smoother is None else estimate.smoother.degree,
                len(selected.uncertain[place]),
                estimate.outliers or 0,
                selected.excluded[place],
            )
        )
    slopes = [estimate_input_slopes(whole.times, parts) for parts in inputs]
    if roles.time in roles.inputs:
        slopes[roles.inputs.index(roles.time)] = [np.ones(len(times)) for times in whole.times]
    return Recording(
        roles.states,
        tuple(symbols[name] for name in roles.states),
        tuple(symbols[name] for name in roles.velocities),
        roles.inputs,
        tuple(symbols[name] for name in roles.inputs),
        roles.order,
        whole.offset,
        tuple(smoothing),
        _trajectories(measurements, weights, estimates, inputs, slopes),
        roles.offsets,
    )


def _trajectories(
    measurements: Measurements,
    weights: FloatArray | None,
    estimates: Sequence[StateEstimate],
    inputs: Sequence[Sequence[FloatArray]],
    slopes: Sequence[Sequence[FloatArray]],
) -> tuple[Trajectory, ...]:
    whole = measurements.trajectories
    assert whole is not None
    return tuple(
        Trajectory(
            whole.names[number],
            whole.times[number],
            _stacked([parts[number] for parts in whole.states.values()], last - first),
            _stacked([estimate.values[first:last] for estimate in estimates], last - first),
            _stacked([estimate.velocity[first:last] for estimate in estimates], last - first),
            _stacked([parts[number] for parts in inputs], last - first),
            _stacked([parts[number] for parts in slopes], last - first),
            measurements.held_out[number],
            _robustness_weights(estimates, first, last),
            None if weights is None else np.ascontiguousarray(weights[first:last]),
        )
        for number, (first, last) in enumerate(measurements.ranges)
    )


def _robustness_weights(estimates: Sequence[StateEstimate], first: int, last: int) -> FloatArray | None:
    """Return the robustness weights of all states in a range of rows; None when smoothing was not robust."""
    if all(estimate.robustness_weights is None for estimate in estimates):
        return None
    whole = np.ones(last)
    weights = [whole if each.robustness_weights is None else each.robustness_weights for each in estimates]
    return _stacked([each[first:last] for each in weights], last - first)


def _stacked(parts: Sequence[FloatArray], rows: int) -> FloatArray:
    """Return `parts` as the rows of one array, which has no rows where there are no parts."""
    return np.ascontiguousarray(np.array(parts, dtype=np.float64).reshape(len(parts), rows))
