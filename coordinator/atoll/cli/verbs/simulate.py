"""``coordinator simulate``: what the model of a saved result does from an initial state, as CSV or JSON."""

import argparse
import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from atoll.cli.exit_codes import DONE
from atoll.model.model import ROWS, Model
from atoll.model.simulation import MOST_NUMBERS, EarlyEndWarning
from atoll.terminal.output import as_json, note, say
from atoll_coordinator.data.roles.options import TRAJECTORY_NAME
from atoll_core.config import DataConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import UsageError

_SLACK: Final = 1e-9
"""Share of a step by which rounding may shift the last time."""


def simulate(options: argparse.Namespace) -> int:
    """Simulate the model of ``options.result``, or draw paths; how it ends is said on stderr. Return the exit code."""
    model = load(options.result, options.group)
    if model.is_regression:
        raise UsageError("the model is a regression without time, so there is nothing to simulate; see its result")
    given = Given(model, options.initial)
    times = times_of(model, given, options)
    inputs = {**(given.inputs(times) or {}), **held_inputs(model, options.hold)}
    paths, seed = (_whole(getattr(options, name), f"--{name}") for name in ("paths", "seed"))
    if paths is None and (options.each_path or seed is not None):
        raise UsageError(
            f"{'--each-path' if options.each_path else '--seed'} belongs to --paths; say how many there are"
        )
    if paths is None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", EarlyEndWarning)  # said in a line of its own
            found = model.simulate(given.state, times, inputs)
        _deliver(as_json(found.as_dict()) if options.json else found.to_csv(), options.output)
        if model.result.get("process") is not None:
            note("coordinator: the drift was simulated, without the noise of the process; --paths draws paths with it")
        if found.status != "finished":
            note(f"coordinator: the simulation ended early: {found.message}")
        return DONE
    ensemble = model.simulate(given.state, times, inputs, paths=paths, seed=seed or 0)
    each = options.each_path
    _deliver(
        as_json(ensemble.as_dict(has_paths=each)) if options.json else ensemble.to_csv(has_paths=each), options.output
    )
    if len(ensemble.finite) < paths:
        note(f"coordinator: {ensemble.message}")
    return DONE


def _deliver(text: str, output: str | None) -> None:
    if output is None:
        say(text)
    else:
        write(Path(output), text)


def _whole(text: str | None, option: str) -> int | None:
    """Return the whole number that is given to an option; raises UsageError."""
    if text is None:
        return None
    if not text.isdecimal():
        raise UsageError(f"{option} must be a whole number, but {text!r} was given")
    return int(text)


def load(name: str, group: str | None = None) -> Model:
    """Return the model of a result by its path or its folder, that of one `group` if named; raises UsageError."""
    model = Model.load(name)
    return model if group is None else model.of_group(group)


def held_inputs(model: Model, texts: Sequence[str]) -> dict[str, float]:
    """Return the inputs that ``--hold`` gives, by name; raises UsageError."""
    held = {name: finite_number(text, f"--hold {name}") for name, text in assignments(texts, "--hold", "u=1")}
    symbols = model.result["symbols"]
    unknown = next((name for name in held if symbols.get(name, name) not in model.inputs), None)
    if unknown is not None:
        raise UsageError(f"--hold names {unknown!r}; the inputs are {', '.join(model.inputs) or 'none'}")
    return {symbols.get(name, name): value for name, value in held.items()}


def assignments(texts: Sequence[str], option: str, example: str) -> list[tuple[str, str]]:
    """Split ``x=0:3`` into name and value; several may stand in one text, separated by commas; raises UsageError."""
    found: dict[str, str] = {}
    for text in (part for each in texts for part in each.split(",")):
        name, separator, value = (part.strip() for part in text.partition("="))
        if not separator or not name or not value:
            raise UsageError(f"{option} wants {example}, but got {text!r}")
        if name in found:
            raise UsageError(f"{option} names '{name}' twice; give one")
        found[name] = value
    return list(found.items())


class Given:
    """The initial state, and what a file adds: times and inputs, all of its first trajectory."""

    def __init__(self, model: Model, text: str | None) -> None:
        self._model = model
        self._table: Table | None = None
        config = model.provenance["config"] or {}
        self._trajectory = (config.get("data") or {}).get("trajectory") or TRAJECTORY_NAME
        self.state: Mapping[str, float] | None = None
        if text is None:
            return
        if Path(text).is_file():
            self._table = _read(Path(text), model)
            self.state = self._first_row(self._table, text)
        elif "=" in text:
            self.state = dict(_assignment(part) for part in text.split(","))
        else:
            raise UsageError(f"--initial wants numbers such as x=1,y=3 or a data file, and {text!r} is neither")

    @property
    def times(self) -> FloatArray | None:
        """The times of the file; None where it has none."""
        return (
            None if self._table is None or self._model.time not in self._table.names else self._column(self._model.time)
        )

    def inputs(self, times: FloatArray) -> dict[str, Any] | None:
        """Return the file's inputs, interpolated at these times."""
        at = self.times
        if self._table is None or at is None:
            return None
        named = self._model.result["symbols"]
        columns = [
            name for name in self._table.names if named.get(name) in self._model.inputs and name != self._model.time
        ]
        return {named[name]: np.interp(times, at, self._column(name)) for name in columns} or None

    def _column(self, name: str) -> FloatArray:
        assert self._table is not None
        return self._table.column(name)[: self._rows]

    @property
    def _rows(self) -> int:
        """The number of rows of the first trajectory."""
        assert self._table is not None
        end = (*self._table.starts, self._table.rows)[1]
        if self._trajectory in self._table.names:
            numbers = self._table.column(self._trajectory)[:end]
            end = int(np.append(np.flatnonzero(numbers != numbers[0]), end)[0])
        return end

    def _first_row(self, table: Table, name: str) -> dict[str, float]:
        symbols = self._model.result["symbols"]
        found = {symbols.get(each, each): float(table.column(each)[0]) for each in table.names if table.rows}
        lacking = [state for state in self._model.states if state not in found]
        if lacking and self._model.time in table.names:
            columns = {symbol: column for column, symbol in symbols.items()}
            part = {columns.get(symbols.get(each, each), each): self._column(each) for each in table.names}
            return self._model.rows_of(part)[2]
        if lacking:
            raise UsageError(f"{name} has no column for {', '.join(lacking)}; an initial state names every state")
        return {state: found[state] for state in self._model.states}


def _read(path: Path, model: Model) -> Table:
    """Read a data file; dates are counted in the model's unit of time."""
    from atoll_coordinator.data.reading.files import read_table

    units = (model.result.get("system") or {}).get("units") or {}
    return read_table([path], DataConfig(time=_named_time(model)), units)


def _named_time(model: Model) -> str | None:
    """Return the time column that the model's data were read with, where it was named."""
    config = model.provenance["config"] or {}
    return (config.get("data") or {}).get("time")


def _assignment(text: str) -> tuple[str, float]:
    name, separator, number = text.partition("=")
    if not separator or not name.strip():
        raise UsageError(f"--initial wants NAME=NUMBER, separated by commas, but got {text!r}")
    return name.strip(), finite_number(number, f"--initial {name.strip()}")


def finite_number(text: str, option: str) -> float:
    """Return the number that is given to an option; raises UsageError."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{option} must be a finite number, but {text!r} was given")
    return value


def times_of(model: Model, given: Given, options: argparse.Namespace) -> FloatArray:
    """Return the times of the simulation; raises UsageError where nothing tells them."""
    known = given.times if given.times is not None else np.array(model.beginning.get("times") or ())
    if options.until is None and options.step is None and len(known):
        return known
    begin = float(known[0]) if len(known) else 0.0
    if options.until is None and not len(known):
        raise UsageError("nothing tells how long to simulate; give --until")
    end = float(known[-1]) if options.until is None else finite_number(options.until, "--until")
    if end <= begin:
        raise UsageError(f"--until must be after the first time, {begin:g}, but {end:g} was given")
    if options.step is None:
        return np.linspace(begin, end, ROWS)
    step = finite_number(options.step, "--step")
    if step <= 0.0 or (end - begin) / step > MOST_NUMBERS:
        raise UsageError(f"--step must be above 0 and give at most {MOST_NUMBERS} times, but {step:g} was given")
    return np.asarray(begin + step * np.arange(math.floor((end - begin) / step + _SLACK) + 1), dtype=np.float64)


def write(path: Path, text: str) -> None:
    """Write `text` to a file, with a newline at its end; raises UsageError."""
    try:
        path.write_text(text if text.endswith("\n") else text + "\n", "utf-8")
    except OSError as error:
        raise UsageError(f"{path} cannot be written ({error.strerror}); name another file with -o") from error
