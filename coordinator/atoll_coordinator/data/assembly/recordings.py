"""The recording of a job, put together from what was measured and how it was smoothed. Pure."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

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
    columns = _Columns(
        _stack([np.concatenate(parts) for parts in whole.states.values()], rows),
        _stack([np.concatenate(parts) for parts in inputs], rows),
        _stack([np.concatenate(parts) for parts in _input_slopes(measurements, inputs)], rows),
        weights,
        estimates,
    )
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
        tuple(_trajectories(measurements, columns)),
        roles.offsets,
        measurements.group_names,
    )


def _input_slopes(measurements: Measurements, inputs: Sequence[Sequence[FloatArray]]) -> list[list[FloatArray]]:
    """Return the derivative of each input along each trajectory."""
    roles, whole = measurements.roles, measurements.trajectories
    assert whole is not None
    slopes = [estimate_input_slopes(whole.times, parts) for parts in inputs]
    if roles.time in roles.inputs:
        slopes[roles.inputs.index(roles.time)] = [np.ones(len(times)) for times in whole.times]
    return slopes


@dataclass(frozen=True, eq=False)
class _Columns:
    """What is known of all rows: `measured` (S, R), `inputs` and `input_slopes` (U, R), `weights` (R,), estimates."""

    measured: FloatArray
    inputs: FloatArray
    input_slopes: FloatArray
    weights: FloatArray | None
    estimates: Sequence[StateEstimate]

    def robustness_weights(self) -> FloatArray | None:
        """Return those of all states (S, R), 1 where a state has none; None where no state has any."""
        by_state = [estimate.robustness_weights for estimate in self.estimates]
        if all(of_state is None for of_state in by_state):
            return None
        rows = self.measured.shape[1]
        return _stack([np.ones(rows) if of_state is None else of_state for of_state in by_state], rows)


def _trajectories(measurements: Measurements, columns: _Columns) -> Iterator[Trajectory]:
    """Yield each trajectory with its range of all columns."""
    whole, rows, estimates = measurements.trajectories, measurements.row_count, columns.estimates
    assert whole is not None
    smoothed = _stack([estimate.values for estimate in estimates], rows)
    velocities = _stack([estimate.velocity for estimate in estimates], rows)
    rates = _stack([estimate.derivative for estimate in estimates], rows)
    rate_errors = _stack([estimate.total_uncertainty for estimate in estimates], rows)
    is_known = np.array([estimate.is_known for estimate in estimates])
    robustness_weights = columns.robustness_weights()
    groups = measurements.groups or [""] * len(whole.names)
    for name, times, place, held_out, group in zip(
        whole.names, whole.times, measurements.ranges, measurements.held_out, groups, strict=True
    ):
        yield Trajectory(
            name,
            times,
            _part(columns.measured, place),
            _part(smoothed, place),
            _part(velocities, place),
            _part(columns.inputs, place),
            _part(columns.input_slopes, place),
            held_out,
            None if robustness_weights is None else _part(robustness_weights, place),
            None if columns.weights is None else _part(columns.weights, place),
            None if is_known.all() else np.ascontiguousarray(is_known[:, slice(*place)]),
            _part(rates, place),
            _part(rate_errors, place),
            group,
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
