"""The recording of a job, put together from what was measured and how it was smoothed. Pure."""

from collections.abc import Mapping, Sequence

import numpy as np

from atoll_coordinator.data.differentiation.derivatives import StateEstimate
from atoll_coordinator.data.differentiation.inputs import estimate_input_slopes
from atoll_coordinator.data.recording import ExcludedRow, Method, Recording, Smoothing, Trajectory
from atoll_coordinator.data.row_selection.selected_rows import SelectedRows
from atoll_coordinator.data.trajectories.measurements import Measurements
from atoll_coordinator.data.trajectories.trajectories import Range
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
    roles, whole, rows = measurements.roles, measurements.trajectories, measurements.row_count
    assert whole is not None
    slopes = [estimate_input_slopes(whole.times, parts) for parts in inputs]
    if roles.time in roles.inputs:
        slopes[roles.inputs.index(roles.time)] = [np.ones(len(times)) for times in whole.times]
    measured = _stack([np.concatenate(parts) for parts in whole.states.values()], rows)
    smoothed = _stack([estimate.values for estimate in estimates], rows)
    velocities = _stack([estimate.velocity for estimate in estimates], rows)
    rates = _stack([estimate.derivative for estimate in estimates], rows)
    rate_errors = _stack([estimate.total_uncertainty for estimate in estimates], rows)
    input_values = _stack([np.concatenate(parts) for parts in inputs], rows)
    input_slopes = _stack([np.concatenate(parts) for parts in slopes], rows)
    robustness_weights = None
    if any(estimate.robustness_weights is not None for estimate in estimates):
        ones = np.ones(rows)
        by_state = [estimate.robustness_weights for estimate in estimates]
        robustness_weights = _stack([ones if of_state is None else of_state for of_state in by_state], rows)
    is_known = np.array([estimate.is_known for estimate in estimates])
    trajectories = [
        Trajectory(
            name,
            times,
            _part(measured, place),
            _part(smoothed, place),
            _part(velocities, place),
            _part(input_values, place),
            _part(input_slopes, place),
            held_out,
            None if robustness_weights is None else _part(robustness_weights, place),
            None if weights is None else _part(weights, place),
            None if is_known.all() else np.ascontiguousarray(is_known[:, slice(*place)]),
            _part(rates, place),
            _part(rate_errors, place),
            group,
        )
        for name, times, place, held_out, group in zip(
            whole.names,
            whole.times,
            measurements.ranges,
            measurements.held_out,
            measurements.groups or [""] * len(whole.names),
            strict=True,
        )
    ]
    smoothing = [
        _describe_smoothing(state, estimate, len(uncertain), excluded)
        for state, estimate, uncertain, excluded in zip(
            roles.states, estimates, selected.uncertain, selected.excluded, strict=True
        )
    ]
    return Recording(
        roles.states,
        tuple(symbols[name] for name in roles.states),
        tuple(symbols[name] for name in roles.velocities),
        roles.inputs,
        tuple(symbols[name] for name in roles.inputs),
        roles.order,
        whole.offset,
        tuple(smoothing),
        tuple(trajectories),
        roles.offsets,
        measurements.group_names,
    )


def _describe_smoothing(
    state: str, estimate: StateEstimate, uncertain: int, excluded: tuple[ExcludedRow, ...]
) -> Smoothing:
    noise, relative, smoother = estimate.noise, estimate.relative_noise, estimate.smoother
    if smoother is None:
        return Smoothing(
            state, "interpolation", noise, relative, uncertain_rows=uncertain, excluded_rows=excluded,
            quantisation=estimate.quantisation,
        )  # fmt: skip
    method: Method = "loess" if estimate.outliers is None else "robust loess"
    outliers = estimate.outliers or 0
    return Smoothing(
        state, method, noise, relative, smoother.rows, smoother.degree, uncertain, outliers, excluded,
        estimate.narrower_noise, estimate.narrower_span, estimate.quantisation,
    )  # fmt: skip


def _stack(parts: Sequence[FloatArray], rows: int) -> FloatArray:
    """Return `parts` as the rows of one array, which has no rows where there are no parts."""
    return np.array(parts, dtype=np.float64).reshape(len(parts), rows)


def _part(values: FloatArray, place: Range) -> FloatArray:
    """Return a trajectory's range of the last axis, in C order."""
    return np.ascontiguousarray(values[..., slice(*place)])
