"""Where a simulation of a model starts, how far it goes, and what drives it, as a data file or bounds of time say."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from atoll.model.arguments import read_columns, rows_of
from atoll.model.beginnings import ROWS, beginning_of
from atoll.model.model import Model
from atoll.model.simulation import MOST_NUMBERS
from atoll_coordinator.data.differentiation.inputs import InputCurve
from atoll_coordinator.data.roles.columns import TRAJECTORY_NAME
from atoll_core.config import DataConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import Field, UsageError

_SLACK: Final = 1e-9
"""Share of a step by which rounding may shift the last time."""


@dataclass(frozen=True)
class Start:
    """An initial state by symbol, and of a file also times (N,) and inputs by symbol; None: as measured."""

    state: Mapping[str, float] | None = None
    times: FloatArray | None = None
    inputs: Mapping[str, InputCurve] = field(default_factory=dict)


def start_of_file(model: Model, path: Path) -> Start:
    """Return the first row, the times and the inputs of the first trajectory of a data file.

    Raises:
        DataError: it cannot be read.
        UsageError: it has no column for a state.
    """
    from atoll_coordinator.data.reading.files import read_table

    config, symbols = model.result.data_settings, model.result.symbols
    table = read_table(
        [path], DataConfig.model_validate({"time": config.get("time")}), model.result.units
    )  # dates in the model's unit
    rows = _rows_of_first(table, str(config.get("trajectory") or TRAJECTORY_NAME))
    columns = {name: table.column(name)[:rows] for name in table.names}
    columns = {name: np.asarray(values) for name, values in read_columns(model, columns).items()}
    times = columns.get(model.time)
    driving = [name for name in columns if symbols.get(name) in model.inputs and name != model.time]
    inputs = {} if times is None else {symbols[name]: _curve(model, name, times, columns[name]) for name in driving}
    return Start(_state_of(model, columns, path), times, inputs)


def _curve(model: Model, name: str, times: FloatArray, values: FloatArray) -> InputCurve:
    """Return an input of a file between its rows, as the fit has taken it; rows without a value are passed over."""
    known = np.isfinite(values)
    if not known.any():
        raise UsageError(f"the input {name!r} has no number in the file of the initial state; give one")
    return InputCurve.through(times[known], values[known], model.input_kind(name))


def times_of(model: Model, start: Start, end: float | None, step: float | None) -> FloatArray:
    """Return the times (N,) of a simulation: up to `end` by `step`, where they are given; raises UsageError."""
    known = start.times if start.times is not None else beginning_of(model).times
    if end is None and step is None and len(known):
        return known
    if end is None and not len(known):
        raise UsageError("nothing tells how long to simulate; give %s", Field("until"))
    first = float(known[0]) if len(known) else 0.0
    last = float(known[-1]) if end is None else end
    if last <= first:
        raise UsageError(
            "%s must be after the first time, %s, but %s was given", Field("until"), f"{first:g}", f"{last:g}"
        )
    if step is None:
        return np.linspace(first, last, ROWS)
    if step <= 0.0 or (last - first) / step > MOST_NUMBERS:
        limits = f"above 0 and give at most {MOST_NUMBERS} times"
        raise UsageError("%s must be %s, but %s was given", Field("step"), limits, f"{step:g}")
    return np.asarray(first + step * np.arange(math.floor((last - first) / step + _SLACK) + 1), dtype=np.float64)


def _rows_of_first(table: Table, trajectory: str) -> int:
    """Return the number of rows of the first trajectory."""
    end = (*table.starts, table.rows)[1]
    if trajectory not in table.names:
        return end
    numbers = table.column(trajectory)[:end]
    return int(np.append(np.flatnonzero(numbers != numbers[0]), end)[0])


def _state_of(model: Model, columns: Mapping[str, FloatArray], path: Path) -> dict[str, float]:
    """Return the state of the first row; velocities that are not there are estimated."""
    symbols = model.result.symbols
    row = {symbols.get(name, name): float(values[0]) for name, values in columns.items() if len(values)}
    lacking = [state for state in model.states if state not in row]
    if lacking and model.time in columns:
        names = model.result.columns_by_symbol
        part = {names.get(symbols.get(name, name), name): values for name, values in columns.items()}
        return rows_of(model, part)[2]
    if lacking:
        raise UsageError(f"{path} has no column for {', '.join(lacking)}; an initial state names every state")
    return {state: row[state] for state in model.states}
