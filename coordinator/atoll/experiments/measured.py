"""The trajectories that a model was fitted to, laid out for fits again: those of a result, or of data files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from atoll.model.parameters import differing_groups
from atoll_coordinator.data.recording import Recording, Smoothing, Trajectory
from atoll_coordinator.data.trajectories.trajectories import format_number
from atoll_coordinator.model.shooting.measurements import Measurements, measurements_of
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import UsageError

_FEWEST_ROWS: Final = 5


@dataclass(frozen=True, eq=False)
class Measured:
    """Measured trajectories: the `measurements` for fits of the equations of a result.

    `rows` counts all rows that were measured, those of `measurements` being some of them, spread evenly; `independent`
    (O,) are the rows of each state that decide, as errors may go together; `order` is that of the equations, `source`
    says in words where the data come from.
    """

    recording: Recording
    measurements: Measurements
    rows: int
    independent: FloatArray
    order: int
    source: str

    @property
    def share(self) -> FloatArray:
        """Independent rows (O,) over the rows that a fit counts."""
        return np.asarray(self.independent / np.maximum(self.measurements.weights.sum(axis=1), 1.0))

    def shortened(self, piece: int) -> "Measured":
        """Return the same with at most so many rows simulated at a stretch."""
        modelled = [self.recording.states.index(name) for name in _modelled(self.measurements, self.recording)]
        shorter = measurements_of(self.recording, modelled, piece=piece)
        return Measured(self.recording, shorter, self.rows, self.independent, self.order, self.source)


def _modelled(its: Measurements, recording: Recording) -> list[str]:
    symbols = its.variables[: len(its.observed)]
    return [recording.states[recording.state_symbols.index(symbol)] for symbol in symbols]


def measured_of(found: Mapping[str, Any], table: Table | None = None) -> Measured:
    """Return the measurements behind the model of a result (the content of result.json).

    Args:
        found: the result.
        table: measurements in the place of those that the result has; its columns are read as the job did.

    Raises:
        UsageError: the states of the result were not measured in time, or it does not have the measurements.
        DataError: the data cannot be used as they are.
    """
    kind = (found.get("system") or {}).get("kind")
    if kind != "dynamics":
        what = {"regression": "a regression without time", "process": "a stochastic process"}.get(str(kind))
        raise UsageError(
            f"the result is of {what or 'an unknown kind'}; only models of measured trajectories can be profiled"
        )
    if table is None:
        recording, rows, source = _stored(found)
    else:
        recording = _prepared(found, table)
        rows = sum(len(each.times) for each in recording.trajectories if not each.held_out)
        source = "the data that were given"
    if differing_groups(found) and (table is None or len({each.group for each in recording.trajectories}) > 1):
        raise UsageError(
            "constants of the model differ between groups of trajectories, which cannot be fitted again together",
            python="give the data of one group as data",
            command="give the data of one group with --data",
        )
    return _laid_out(found, recording, rows, source, is_stored=table is None)


def _laid_out(found: Mapping[str, Any], recording: Recording, rows: int, source: str, *, is_stored: bool) -> Measured:
    names = [str(each["variable"]) for each in found["equations"]]
    modelled = [recording.states.index(name) for name in names]
    errors = [((found.get("noise") or {}).get(name) or {}).get("errors") or {} for name in names]
    kept = sum(len(each.times) for each in recording.trajectories if not each.held_out)
    share = kept / max(rows, 1)
    pieces = [each["piece"] for each in errors if each.get("piece")]
    piece = max(_FEWEST_ROWS, int(min(pieces) * share)) if pieces else SETTINGS.shooting.piece
    measurements = measurements_of(recording, modelled, piece=piece)
    counts = measurements.weights.sum(axis=1)
    ratios = np.array([_ratio(each, found, name) for each, name in zip(errors, names, strict=True)])
    # rows that were left out of the stored ones count as much as those that are there
    full = counts / max(share, 1e-300) if is_stored else counts
    return Measured(recording, measurements, rows, full * ratios, recording.order, source)


def _ratio(errors: Mapping[str, Any], found: Mapping[str, Any], name: str) -> float:
    """Return the independent rows of a state over all that were fitted; 1 where it is not known."""
    independent, trajectories = errors.get("independent_rows"), (found.get("data") or {}).get("trajectories") or ()
    rows = sum(each["rows"] for each in trajectories if not each["held_out"])
    return float(min(1.0, independent / rows)) if independent and rows else 1.0


def _stored(found: Mapping[str, Any]) -> tuple[Recording, int, str]:
    """Return what a result has of its measurements, how many rows were measured, and where they come from."""
    trajectories = (found.get("data") or {}).get("trajectories")
    if not trajectories:
        raise UsageError(
            "the result has no measurements", python="give them as data", command="give the data file with --data"
        )
    system, symbols = found["system"], found["symbols"]
    states, inputs = tuple(system["states"]), tuple(system["inputs"])
    noise = found.get("noise") or {}
    smoothing = tuple(_smoothing(name, noise.get(name) or {}) for name in states)
    smoothed = {each["name"]: each for each in (found.get("smoothing") or {}).get("trajectories") or ()}
    parts = [_trajectory(each, smoothed.get(each["name"]), states, inputs) for each in trajectories]
    config = (found.get("config") or {}).get("data") or {}
    recording = Recording(
        states,
        tuple(symbols[name] for name in states),
        tuple(symbols[name] for name in system["velocities"]),
        inputs,
        tuple(symbols[name] for name in inputs),
        2 if system["order"] == 2 else 1,
        0.0,
        smoothing,
        tuple(parts),
        tuple(config.get("offsets") or ()),
    )
    searched = [each for each in trajectories if not each["held_out"]]
    rows, kept = sum(each["rows"] for each in searched), sum(len(each["times"]) for each in searched)
    source = f"{len(searched)} trajectories" if len(searched) > 1 else "1 trajectory"
    of = f"{kept} of {rows} rows" if kept < rows else f"{rows} rows"
    return recording, rows, f"{source} of the result, {of}"


def _smoothing(name: str, its: Mapping[str, Any]) -> Smoothing:
    return Smoothing(name, its.get("method") or "interpolation", its.get("sd") or 0.0, its.get("relative") or 0.0)


def _trajectory(
    its: Mapping[str, Any], smoothed: Mapping[str, Any] | None, states: Sequence[str], inputs: Sequence[str]
) -> Trajectory:
    times = np.array(its["times"], dtype=np.float64)
    measured = _stacked([its["measured"][name] for name in states], len(times))
    curves = [_curve(times, row, name, smoothed) for name, row in zip(states, measured, strict=True)]
    positions = _stacked(curves, len(times))
    robust, weights = its.get("robustness_weights"), its.get("weights")
    return Trajectory(
        str(its["name"]),
        times,
        measured,
        positions,
        _slopes(positions, times),
        _stacked([its["inputs"][name] for name in inputs], len(times)),
        _stacked([its["input_slopes"][name] for name in inputs], len(times)),
        bool(its["held_out"]),
        None if robust is None else _stacked([robust[name] for name in states], len(times)),
        None if weights is None else np.array(weights, dtype=np.float64),
    )


def _slopes(values: FloatArray, times: FloatArray) -> FloatArray:
    return np.ascontiguousarray(np.gradient(values, times, axis=1)) if len(times) > 1 else np.zeros_like(values)


def _curve(times: FloatArray, measured: FloatArray, name: str, smoothed: Mapping[str, Any] | None) -> FloatArray:
    """Return the smoothed state at these times; of a state that was interpolated what was measured."""
    if smoothed is not None and name in smoothed["smoothed"]:
        known, values = np.array(smoothed["times"]), np.array(smoothed["smoothed"][name], dtype=np.float64)
    else:
        known, values = times, measured
    is_known = np.isfinite(values)
    return np.interp(times, known[is_known], values[is_known]) if is_known.any() else np.zeros(len(times))


def _stacked(rows: Sequence[Any], count: int) -> FloatArray:
    return np.ascontiguousarray(np.array(rows, dtype=np.float64).reshape(len(rows), count))


def starts_of(found: Mapping[str, Any], measured: Measured) -> FloatArray | None:
    """Return the initial states (G, D) that a result has fitted to its trajectories; None where they are others."""
    known = {each["name"]: each.get("start") for each in (found.get("simulation") or {}).get("trajectories") or ()}
    its, symbols = measured.measurements, found["symbols"]
    columns = {symbol: column for column, symbol in symbols.items()}
    rows = [known.get(its.names[owner]) for owner in its.owners.tolist()]
    names = [columns[name] for name in its.variables[: len(its.scales)]]
    if len(set(its.owners.tolist())) < len(rows) or not all(row and all(name in row for name in names) for row in rows):
        return None
    starts = np.array([[row[name] for name in names] for row in rows if row], dtype=np.float64)
    return starts if np.isfinite(starts).all() else None


def config_of(found: Mapping[str, Any]) -> JobConfig:
    """Return the configuration of the job that a result is of."""
    return JobConfig.model_validate({"preset": found.get("preset") or "default", **(found.get("config") or {})})


def _prepared(found: Mapping[str, Any], table: Table) -> Recording:
    """Return the recording of another table, read and smoothed as the job did; of one group where the result is."""
    from atoll_coordinator.data.prepare import prepare

    config, group = config_of(found), found.get("group")
    column = config.data.group
    if group is not None:
        table = table if column is None else _rows_of_group(table, column, str(group), config.data.trajectory)
        its = config.data.model_copy(update={"group": None, "per_trajectory": False})
        config = config.model_copy(update={"data": its})
    recording = prepare(table, config).recording
    if recording is None or set(recording.states) != set(found["system"]["states"]):
        raise UsageError(f"the data do not have the states {', '.join(found['system']['states'])} measured in time")
    return recording if group is None or column is not None else _trajectory_of_group(recording, str(group))


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
    names = [each.name for each in recording.trajectories]
    if len(names) == 1:
        return recording
    if group not in names:
        raise _lacking(group, names)
    return replace(recording, trajectories=(recording.trajectories[names.index(group)],))


def _lacking(group: str, names: Sequence[str]) -> UsageError:
    return UsageError(f"the data have nothing of group {group!r}, only of {', '.join(names)}; give data of that group")
