"""The trajectories that a model was fitted to, laid out for fits again: those of a result, or of data files."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, get_args

import numpy as np

from atoll.model.groups import differing_groups
from atoll_coordinator.data.recording import Method, Recording, Smoothing, Trajectory
from atoll_coordinator.data.trajectories.measurements import format_number
from atoll_coordinator.model.shooting.measurements import Measurements, measurements_of
from atoll_coordinator.result.base import Curve
from atoll_coordinator.result.findings import Errors, Noise
from atoll_coordinator.result.listed_trajectories import Recorded, Smoothed
from atoll_coordinator.result.result import Result
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import UsageError

_FEWEST_ROWS: Final = 5
_OTHER_KINDS: Final = {"regression": "a regression without time", "process": "a stochastic process"}


@dataclass(frozen=True, eq=False)
class Measured:
    """Measured trajectories: the `measurements` for fits of the equations of a result, of the `modelled` states.

    `rows` counts all rows that were measured, those of `measurements` being some of them, spread evenly; `independent`
    (O,) are the rows of each state that decide, as errors may go together; `source` says in words where the data come
    from.
    """

    recording: Recording
    measurements: Measurements
    modelled: Sequence[int]
    rows: int
    independent: FloatArray
    source: str

    @property
    def share(self) -> FloatArray:
        """Independent rows (O,) over the rows that a fit counts."""
        return np.asarray(self.independent / np.maximum(self.measurements.weights.sum(axis=1), 1.0))

    @property
    def longest(self) -> int:
        """The most rows that are simulated at a stretch."""
        return int(np.diff(self.measurements.bounds, axis=1).max())

    def shortened(self, piece: int) -> "Measured":
        """Return the same with at most so many rows simulated at a stretch."""
        return replace(self, measurements=measurements_of(self.recording, self.modelled, piece=piece))


def measured_of(result: Result, table: Table | None = None) -> Measured:
    """Return the measurements behind the model of a result, or those of a table, read as the job did.

    Raises:
        UsageError: the states of the result were not measured in time, or it does not have the measurements.
        DataError: the data cannot be used as they are.
    """
    kind = result.columns.kind
    if kind != "dynamics":
        what = _OTHER_KINDS.get(str(kind), "an unknown kind")
        raise UsageError(f"the result is of {what}; only models of measured trajectories can be profiled")
    recording = _stored(result) if table is None else _prepared(result, table)
    rows = kept = sum(len(trajectory.times) for trajectory in recording.trajectories if not trajectory.held_out)
    source = "the data that were given"
    if table is None:
        searched = [part for part in result.recorded if not part.held_out]
        rows = sum(part.rows or len(part.times) for part in searched)
        of = f"{kept} of {rows} rows" if kept < rows else f"{rows} rows"
        source = f"{len(searched)} {'trajectories' if len(searched) > 1 else 'trajectory'} of the result, {of}"
    groups = {trajectory.group for trajectory in recording.trajectories}
    if differing_groups(result) and (table is None or len(groups) > 1):
        raise UsageError(
            "constants of the model differ between groups of trajectories, which cannot be fitted again together",
            python="give the data of one group as data",
            command="give the data of one group with --data",
        )
    names = [str(equation.variable) for equation in result.equations]
    modelled = [recording.states.index(name) for name in names]
    errors = [result.noise.get(name, Noise()).errors or Errors() for name in names]
    share = kept / max(rows, 1)
    pieces = [known.piece for known in errors if known.piece]
    piece = max(_FEWEST_ROWS, int(min(pieces) * share)) if pieces else SETTINGS.shooting.piece
    measurements = measurements_of(recording, modelled, piece=piece)
    independent = measurements.weights.sum(axis=1)
    if table is None:  # rows that were left out of the stored ones count as much as those that are there
        independent = independent / max(share, 1e-300)
    fitted = sum(part.rows or 0 for part in result.recorded if not part.held_out)
    ratios = [min(1.0, (known.independent_rows or fitted) / fitted) if fitted else 1.0 for known in errors]
    independent = independent * np.array(ratios)
    return Measured(recording, measurements, modelled, rows, independent, source)


def _stored(result: Result) -> Recording:
    """Return what a result has of its measurements."""
    trajectories = result.recorded
    if not trajectories:
        raise UsageError(
            "the result has no measurements", python="give them as data", command="give the data file with --data"
        )
    columns, symbols = result.columns, result.symbols
    states, inputs = columns.states, columns.inputs
    smoothing = []
    for name in states:
        noise = result.noise.get(name, Noise())
        method: Method = next((method for method in get_args(Method) if method == noise.method), "interpolation")
        smoothing.append(Smoothing(name, method, noise.sd or 0.0, noise.relative or 0.0))
    smoothed = {part.name: part for part in result.smoothed}
    parts = [_trajectory(part, smoothed.get(part.name), states, inputs) for part in trajectories]
    return Recording(
        states,
        tuple(symbols[name] for name in states),
        tuple(symbols[name] for name in columns.velocities),
        inputs,
        tuple(symbols[name] for name in inputs),
        2 if columns.order == 2 else 1,
        0.0,
        tuple(smoothing),
        tuple(parts),
        tuple(config_of(result).data.offsets),
    )


def _trajectory(
    recorded: Recorded, smoothed: Smoothed | None, states: Sequence[str], inputs: Sequence[str]
) -> Trajectory:
    times = np.array(recorded.times, dtype=np.float64)
    measured = _stacked([recorded.measured[name] for name in states], len(times))
    curves = [_curve(times, row, name, smoothed) for name, row in zip(states, measured, strict=True)]
    positions = _stacked(curves, len(times))
    robust, weights = recorded.robustness_weights, recorded.weights
    return Trajectory(
        recorded.name,
        times,
        measured,
        positions,
        np.gradient(positions, times, axis=1) if len(times) > 1 else np.zeros_like(positions),
        _stacked([recorded.inputs[name] for name in inputs], len(times)),
        _stacked([(recorded.input_slopes or {})[name] for name in inputs], len(times)),
        recorded.held_out,
        None if robust is None else _stacked([robust[name] for name in states], len(times)),
        None if weights is None else np.array(weights, dtype=np.float64),
    )


def _curve(times: FloatArray, measured: FloatArray, name: str, smoothed: Smoothed | None) -> FloatArray:
    """Return the smoothed state at these times; of a state that was interpolated what was measured."""
    if smoothed is not None and name in smoothed.smoothed:
        known, values = np.array(smoothed.times), np.array(smoothed.smoothed[name], dtype=np.float64)
    else:
        known, values = times, measured
    is_known = np.isfinite(values)
    return np.interp(times, known[is_known], values[is_known]) if is_known.any() else np.zeros(len(times))


def _stacked(rows: Sequence[FloatArray | Curve], count: int) -> FloatArray:
    return np.ascontiguousarray(np.array(rows, dtype=np.float64).reshape(len(rows), count))


def starts_of(result: Result, measured: Measured) -> FloatArray | None:
    """Return the initial states (G, D) that a result has fitted to its trajectories; None where they are others."""
    known = {part.name: part.start for part in result.simulated}
    measurements, columns = measured.measurements, result.columns_by_symbol
    rows = [known.get(measurements.names[owner]) for owner in measurements.owners.tolist()]
    names = [columns[name] for name in measurements.variables[: len(measurements.scales)]]
    is_whole = len(set(measurements.owners.tolist())) == len(rows)
    if not is_whole or not all(row and all(name in row for name in names) for row in rows):
        return None
    starts = np.array([[row[name] for name in names] for row in rows if row], dtype=np.float64)
    return starts if np.isfinite(starts).all() else None


def config_of(result: Result) -> JobConfig:
    """Return the configuration of the job that a result is of."""
    return JobConfig.model_validate({"preset": result.preset or "default", **result.config})


def _prepared(result: Result, table: Table) -> Recording:
    """Return the recording of another table, read and smoothed as the job did; of one group where the result is."""
    from atoll_coordinator.data.prepare import prepare

    config, group = config_of(result), result.group
    column = config.data.group
    if group is not None:
        table = table if column is None else _rows_of_group(table, column, group, config.data.trajectory)
        settings = config.data.model_copy(update={"group": None, "per_trajectory": False})
        config = config.model_copy(update={"data": settings})
    recording = prepare(table, config).recording
    if recording is None or set(recording.states) != set(result.columns.states):
        raise UsageError(f"the data do not have the states {', '.join(result.columns.states)} measured in time")
    return recording if group is None or column is not None else _trajectory_of_group(recording, group)


def _rows_of_group(table: Table, column: str, group: str, trajectory: str | None) -> Table:
    """Return the rows of one group, without the `column` of groups unless it tells trajectories apart as well."""
    if column not in table.names:
        raise UsageError(f"the data have no column {column!r}, which says what is of group {group!r}; add it")
    values = table.column(column)
    names = {value: table.label(column, value) or format_number(value) for value in dict.fromkeys(values.tolist())}
    rows = np.flatnonzero([names[value] == group for value in values.tolist()])
    if not len(rows):
        raise _lacking(group, list(names.values()))
    begins = np.diff(rows, prepend=-2) > 1
    begins |= np.isin(rows, table.starts)
    kept = [place for place, name in enumerate(table.names) if name != column or name == trajectory]
    return replace(
        table,
        names=tuple(table.names[place] for place in kept),
        units=tuple(table.units[place] for place in kept),
        columns=np.ascontiguousarray(table.columns[kept][:, rows]),
        starts=tuple(np.flatnonzero(begins).tolist()),
        file_of_row=table.file_of_row[rows],
        line_of_row=table.line_of_row[rows],
    )


def _trajectory_of_group(recording: Recording, group: str) -> Recording:
    """Return the trajectory that is the group; a single one is taken for it."""
    names = [trajectory.name for trajectory in recording.trajectories]
    if len(names) == 1:
        return recording
    if group not in names:
        raise _lacking(group, names)
    return replace(recording, trajectories=(recording.trajectories[names.index(group)],))


def _lacking(group: str, names: Sequence[str]) -> UsageError:
    return UsageError(f"the data have nothing of group {group!r}, only of {', '.join(names)}; give data of that group")
