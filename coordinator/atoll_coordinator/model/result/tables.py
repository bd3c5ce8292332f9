"""The parts of a result about the data: source, columns, noise, smoothed trajectories, and rows of a regression."""

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from atoll_coordinator.data import recording as recordings
from atoll_coordinator.data.recording import ExcludedRow, Preparation, Recording, Trajectory
from atoll_coordinator.model.thinning import curve, curves, spread_places
from atoll_coordinator.result.findings import (
    Data,
    Errors,
    ExcludedRows,
    LargestResidual,
    Noise,
    Quantisation,
    Regression,
    System,
)
from atoll_coordinator.result.listed_trajectories import Recorded, Smoothed, Smoothing
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program

MOST_ROWS: Final = 2_000
"""Most listed rows of each state, for all trajectories together; they are evenly spread. It is also the limit for
listed excluded rows."""
MOST_NUMBERS: Final = 100_000
"""Most listed numbers in all, about 1 MB as text."""
MOST_REGRESSION_ROWS: Final = 1_000
LEAST_ROWS: Final = 8
"""Fewest listed measured rows of each trajectory."""
DIGITS: Final = 12
"""Significant digits of measured values: relative errors below 1e-11 do not matter."""


# ---------------------------------------------------------------------------------------------------- measured rows


def describe_data(preparation: Preparation, *, has_trajectories: bool = True) -> Data | None:
    """Describe the table: its digest, files, number of rows and how it was read, and the measured rows of each
    trajectory.

    The result is None if the source is not known. `trajectories` is null if states were not measured in time, or if
    trajectories were not requested.
    """
    source, recording = preparation.source, preparation.recording
    if source is None:
        return None
    trajectories = None
    if recording is not None and has_trajectories:
        rows = sum(len(part.times) for part in recording.trajectories)
        most = min(MOST_ROWS, MOST_NUMBERS // (1 + len(recording.states) + 2 * len(recording.inputs)))
        share = min(1.0, most / max(rows, 1))
        trajectories = tuple(_thin_trajectory(recording, part, share) for part in recording.trajectories)
    return Data(
        digest=source.digest, files=source.files, rows=source.rows, read_as=source.read_as, trajectories=trajectories
    )


def _thin_trajectory(recording: Recording, part: Trajectory, share: float) -> Recorded:
    """Return a `share` of the measured rows of one trajectory; weights are null if all are 1."""
    count = len(part.times)
    rows = spread_places(count, max(LEAST_ROWS, int(share * count)))
    if len(rows) < count:
        # Include the rows at which a held input changes. Without these rows, the previous value would seem to last too
        # long.
        held = part.inputs[np.isnan(part.input_slopes).any(axis=1)]
        switches = (np.flatnonzero((held[:, 1:] != held[:, :-1]).any(axis=0)) + 1).tolist()
        rows = sorted({*rows, *switches[:MOST_ROWS]})

    robust = part.robustness_weights
    return Recorded(
        name=part.name,
        held_out=part.held_out,
        rows=count,
        times=curve(part.times[rows] + recording.offset, DIGITS),
        measured=curves(recording.states, part.measured[:, rows], DIGITS),
        inputs=curves(recording.inputs, part.inputs[:, rows], DIGITS),
        input_slopes=curves(recording.inputs, part.input_slopes[:, rows], DIGITS),
        weights=None if part.weights is None else curve(part.weights[rows], DIGITS),
        robustness_weights=None if robust is None else curves(recording.states, robust[:, rows], DIGITS),
    )


def describe_system(preparation: Preparation) -> System | None:
    """Return the roles of the columns, their units, and the range of each variable in the rows that count.

    The keys of all parts are column names; angles are in radians. None if the source is not known.
    """
    source, recording = preparation.source, preparation.recording
    if source is None:
        return None
    dataset = preparation.counted or preparation.dataset
    dynamics = "process" if preparation.process is not None else "dynamics"
    return System(
        kind="regression" if source.target is not None else dynamics,
        order=source.order,
        time=source.time,
        states=source.states,
        velocities=source.velocities,
        inputs=source.inputs,
        input_kinds={} if recording is None else dict(zip(recording.inputs, recording.input_kinds, strict=False)),
        target=source.target,
        units=dict(source.units),
        ranges={
            name: (float(values.min()), float(values.max()))
            for name, values in zip(dataset.symbols, dataset.inputs, strict=True)
        },
    )


def describe_regression(preparation: Preparation, program: Program | None) -> Regression | None:
    """Return some of the rows with the fitted values of `program`. None if there is no target or no equation."""
    if preparation.source is None or preparation.source.target is None or program is None:
        return None
    dataset = preparation.dataset
    problem = (preparation.counted or dataset).problem(dataset.variables[0])
    rows = spread_places(len(problem.target.values), MOST_REGRESSION_ROWS)
    return Regression(
        rows=len(problem.target.values),
        listed=len(rows),
        variables=curves(dataset.symbols, problem.inputs[:, rows]),
        measured=curve(problem.target.values[rows]),
        fitted=curve(values_of(program, problem.inputs)[rows]),
    )


# --------------------------------------------------------------------------------------------- noise and smoothing


def describe_noise(recording: Recording | None, errors: Mapping[str, Errors]) -> dict[str, Noise]:
    """Return the estimated measurement errors of each state; empty if no state was measured in time.

    `errors` are estimates from the residuals of the shown model, by state.
    """
    if recording is None:
        return {}
    return {
        known.state: _describe_noise_of_state(recording, index, known, errors.get(known.state))
        for index, known in enumerate(recording.smoothing)
    }


def _describe_noise_of_state(
    recording: Recording, index: int, known: recordings.StateSmoothing, errors: Errors | None
) -> Noise:
    longest = max((len(part.times) for part in recording.trajectories), default=None)
    rms, largest = _measure_residuals(recording, index)
    step = known.quantisation
    return Noise(
        sd=known.noise,
        relative=known.relative_noise,
        method=known.method,
        span=known.span if known.span is None or longest is None else min(known.span, longest),
        degree=known.degree,
        quantisation=None if step is None else Quantisation(kind=step.kind, step=step.step, error=step.error),
        residual_rms=rms,
        largest_residual=largest,
        doubtful_rows=known.uncertain_rows,
        outliers=known.outliers,
        doubtful=_list_excluded_rows(recording, known.excluded_rows),
        errors=errors,
    )


def _measure_residuals(recording: Recording, index: int) -> tuple[float | None, LargestResidual | None]:
    """Return the root mean square of the differences between measured and smoothed values of one state, and the largest
    difference."""
    residuals = [
        (residual, part.name, time)
        for part in recording.trajectories
        if not part.held_out
        for residual, time in zip(
            (part.measured[index] - part.smoothed[index]).tolist(), part.times.tolist(), strict=True
        )
        if math.isfinite(residual)
    ]
    value, name, time = max(residuals, key=lambda residual: abs(residual[0]), default=(0.0, "", 0.0))
    squares = sum(residual * residual for residual, *_ in residuals)
    rms = math.sqrt(squares / len(residuals)) if residuals else None
    if not value:
        return rms, None
    return rms, LargestResidual(value=value, trajectory=name, time=_round_time(time + recording.offset))


def _round_time(time: float) -> float:
    return float(f"{time:.12g}")


def _list_excluded_rows(recording: Recording, rows: Sequence[ExcludedRow]) -> tuple[ExcludedRows, ...]:
    """Return the times of excluded rows by trajectory and reason, in the order of the rows."""
    lists: dict[tuple[int, str], list[float]] = {}
    for row in rows[:MOST_ROWS]:
        time = float(recording.trajectories[row.trajectory].times[row.row])
        lists.setdefault((row.trajectory, row.reason), []).append(_round_time(time + recording.offset))
    return tuple(
        ExcludedRows(trajectory=recording.trajectories[number].name, reason=reason, times=tuple(times))
        for (number, reason), times in lists.items()
    )


def describe_smoothing(recording: Recording | None) -> Smoothing | None:
    """Return smoothed and measured values of the states that were smoothed; None if no state was smoothed.

    `rows` is the number of all rows. `listed` is the number of listed rows: all rows, or evenly spread rows of each
    trajectory.
    """
    if recording is None:
        return None
    chosen = [index for index, known in enumerate(recording.smoothing) if known.method != "interpolation"]
    if not chosen:
        return None
    counts = [len(part.times) for part in recording.trajectories]
    rows, most = sum(counts), min(MOST_ROWS, MOST_NUMBERS // (1 + 3 * len(chosen)))
    lists = [spread_places(count, max(2, count * most // rows) if rows > most else count) for count in counts]

    names = [recording.states[index] for index in chosen]
    return Smoothing(
        rows=rows,
        listed=sum(map(len, lists)),
        trajectories=tuple(
            Smoothed(
                name=part.name,
                held_out=part.held_out,
                times=curve(part.times[listed] + recording.offset, digits=12),
                measured=curves(names, part.measured[np.ix_(chosen, listed)]),
                smoothed=curves(names, part.smoothed[np.ix_(chosen, listed)]),
                residuals=curves(names, (part.measured - part.smoothed)[np.ix_(chosen, listed)]),
            )
            for part, listed in zip(recording.trajectories, lists, strict=True)
        ),
    )
