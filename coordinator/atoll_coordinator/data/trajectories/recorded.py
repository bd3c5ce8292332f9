"""The recording of a job, put together from what was measured and how it was smoothed. Pure."""

from collections.abc import Mapping, Sequence

import numpy as np

from atoll.data.dataset import FloatArray
from atoll_coordinator.data.differentiation.derivatives import Estimate
from atoll_coordinator.data.differentiation.inputs import input_slopes
from atoll_coordinator.data.reading.measured import Measured
from atoll_coordinator.data.recording import Method, Recording, Smoothing, Trajectory
from atoll_coordinator.data.row_selection.excluded_rows import doubts_of
from atoll_coordinator.data.row_selection.rows import Kept


def recorded(
    its: Measured,
    velocities: Sequence[str],
    inputs: Sequence[Sequence[FloatArray]],
    symbols: Mapping[str, str],
    estimates: Sequence[Estimate],
    kept: Kept,
) -> Recording:
    """Return the recording of measured states.

    Args:
        its: with trajectories.
        velocities: column names of the velocities that are variables.
        inputs: for each input, its values along each trajectory.
        symbols: by column name, the name in expressions.
        estimates: one for each state.
        kept: which rows the search sees, and for which state's sake it does not see others.
    """
    assert its.trajectories is not None
    slopes = [input_slopes(its.trajectories.times, parts) for parts in inputs]
    if its.roles.time in its.roles.inputs:
        slopes[its.roles.inputs.index(its.roles.time)] = [np.ones(len(times)) for times in its.trajectories.times]
    return Recording(
        its.roles.states,
        tuple(symbols[name] for name in its.roles.states),
        tuple(symbols[name] for name in velocities),
        its.roles.inputs,
        tuple(symbols[name] for name in its.roles.inputs),
        its.config.order,
        its.trajectories.offset,
        tuple(_smoothing(its, *each) for each in zip(its.roles.states, estimates, kept.doubted, strict=True)),
        tuple(_trajectory(its, run, inputs, slopes, estimates) for run in range(len(its.trajectories.runs))),
        its.config.offsets,
    )


def _smoothing(of: Measured, state: str, its: Estimate, doubted: frozenset[int]) -> Smoothing:
    assert of.trajectories is not None
    doubts = doubts_of(of.trajectories.times, its, doubted, frozenset(of.indices(held_out=False)))
    if its.choice is None:
        return Smoothing(
            state, "interpolation", its.error, its.relative, uncertain_rows=len(doubted), excluded_rows=doubts
        )
    method: Method = "loess" if its.outliers is None else "robust loess"
    span, degree = its.choice.rows, its.choice.degree
    return Smoothing(state, method, its.error, its.relative, span, degree, len(doubted), its.outliers or 0, doubts)


def _trajectory(
    its: Measured,
    run: int,
    inputs: Sequence[Sequence[FloatArray]],
    slopes: Sequence[Sequence[FloatArray]],
    estimates: Sequence[Estimate],
) -> Trajectory:
    assert its.trajectories is not None
    first, last = its.trajectories.runs[run]
    rows = last - first
    return Trajectory(
        its.trajectories.names[run],
        its.trajectories.times[run],
        _stacked([its.states[name][run] for name in its.roles.states], rows),
        _stacked([each.values[first:last] for each in estimates], rows),
        _stacked([each.velocity[first:last] for each in estimates], rows),
        _stacked([parts[run] for parts in inputs], rows),
        _stacked([parts[run] for parts in slopes], rows),
        its.held_out[run],
        _trust(estimates, first, last),
        None if its.weights is None else np.ascontiguousarray(its.weights[first:last]),
    )


def _trust(estimates: Sequence[Estimate], first: int, last: int) -> FloatArray | None:
    if all(each.trust is None for each in estimates):
        return None
    whole = np.ones(last - first)
    return _stacked([whole if each.trust is None else each.trust[first:last] for each in estimates], last - first)


def _stacked(parts: Sequence[FloatArray], rows: int) -> FloatArray:
    """Return `parts` as the rows of one array, which has no rows where there are no parts."""
    return np.ascontiguousarray(np.array(parts, dtype=np.float64).reshape(len(parts), rows))
