"""PEtab 1: a folder of SBML, measurements, noise and bounds, for pyPESTO, AMICI, Data2Dynamics and COPASI.

Each trajectory is a condition with its own initial state, which is estimated together with the constants. Simulations
in PEtab begin at time 0, so times are counted from the first row of their trajectory.
"""

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from atoll.export.description import Description, ExportedColumn, ExportedState, describe
from atoll.export.formats import require_support
from atoll.export.language import Wording
from atoll.export.sbml import SBML, start_name
from atoll.model.arguments import Columns, column, has, measured_conditions, read_columns, rows_of, values_of_curve
from atoll.model.core import ModelCore, config_of
from atoll.model.equations import Parameter
from atoll_coordinator.model.template.hidden_states import initial_values
from atoll_coordinator.result.findings import Errors, Noise
from atoll_coordinator.result.listed_trajectories import Recorded
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError

_REACH: Final = 10.0
"""Distance of the bounds from a constant, in standard errors, or in multiples of its size if no error is known."""
_PROBLEM: Final = """\
format_version: 1
parameter_file: parameters.tsv
problems:
  - sbml_files: [model.xml]
    condition_files: [conditions.tsv]
    observable_files: [observables.tsv]
    measurement_files: [measurements.tsv]
"""

_Row = tuple[str | float, ...]


def export_petab(model: ModelCore, folder: str | Path, data: Sequence[Columns] | None = None) -> None:
    """Write a PEtab problem into a folder; see `atoll.Model.to_petab`."""
    trajectories = [] if data is None else _read_trajectories(model, data)
    start, times = (trajectories[0].start, trajectories[0].times) if trajectories else (None, None)
    columns = model.result.columns_by_symbol
    placeholders = {name: 0.0 for name in model.inputs if columns[name] != model.time}
    description = describe(model, start, times, placeholders)
    require_support(description, SBML)
    document = SBML.write(description, has_start_parameters=True)
    trajectories = trajectories or _recorded_trajectories(model)
    if not trajectories:
        raise UsageError(
            "the result has no measurements of trajectories", python="give them as data", command="give --data FILE"
        )
    tables = _Tables(model, description, trajectories)
    files = {"problem.yaml": _PROBLEM, "model.xml": document}
    for name in ("conditions", "observables", "measurements", "parameters"):
        stream = io.StringIO()
        csv.writer(stream, delimiter="\t", lineterminator="\n").writerows(getattr(tables, name)())
        files[f"{name}.tsv"] = stream.getvalue()
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            (Path(folder) / name).write_text(text, "utf-8")
    except OSError as error:
        raise UsageError(f"{folder} cannot be written ({error.strerror}); name another folder") from error


@dataclass(frozen=True, eq=False)
class PetabTrajectory:
    """Measurements along a trajectory: `times` (N,), `values` (N,) by state, `inputs` (N,) by name.

    Missing values are NaN. `start` (D,) is the initial state from which the estimation begins.
    """

    name: str
    times: FloatArray
    values: Mapping[str, FloatArray]
    start: tuple[float, ...]
    inputs: Mapping[str, FloatArray]


def _recorded_trajectories(model: ModelCore) -> list[PetabTrajectory]:
    """Return the measurements in a result, without held-out trajectories, with their fitted initial states.

    A trajectory without a fitted initial state begins at its first row with all states. It is left out if it has no
    such row.
    """
    symbols = model.result.symbols
    starts: Mapping[str, Mapping[str, float | None]]
    starts = {part.name: part.start for part in model.result.simulated if part.start}
    trajectories = []
    for part in model.result.recorded or model.result.simulated:
        if part.held_out or not part.measured:
            continue
        times, start, first = values_of_curve(part.times), starts.get(part.name), 0
        if start is None:
            conditions = measured_conditions(model, part)
            if conditions is None:
                continue
            start, first = conditions.start, int(np.searchsorted(times, conditions.times[0]))
        recorded = part.inputs if isinstance(part, Recorded) else {}
        values, inputs = (
            {
                symbols.get(name, name): values_of_curve(curve)[first:]
                for name, curve in curves.items()
                if name not in model.result.unmeasured
            }
            for curves in (part.measured, recorded)
        )
        named = {symbols[name]: np.nan if value is None else value for name, value in start.items()}
        begin = tuple(named[name] for name in model.states)
        trajectories.append(PetabTrajectory(part.name, times[first:], values, begin, inputs))
    return trajectories


def _read_trajectories(model: ModelCore, data: Sequence[Columns]) -> list[PetabTrajectory]:
    """Return the measurements in `data`; the initial state of a trajectory is its first row."""
    if not data:
        raise UsageError("no trajectory of measurements was given; give at least one")
    columns, trajectories = model.result.columns_by_symbol, []
    for number, part in enumerate((read_columns(model, part) for part in data), start=1):
        times, values, start = rows_of(model, part)
        values |= {name: column(part, name) for name in model.observed_columns if has(part, name)}
        first = tuple(start[name] for name in model.states)
        inputs = {name: column(part, columns[name]) for name in model.inputs if has(part, columns[name])}
        trajectories.append(PetabTrajectory(str(number), times, values, first, inputs))
    return trajectories


class _Tables:
    def __init__(self, model: ModelCore, description: Description, trajectories: Sequence[PetabTrajectory]) -> None:
        self._model, self._description = model, description
        self._words = Wording(description, SBML)
        self._trajectories = trajectories
        self._starts = [start_name(self._words, state) for state in description.states]
        self._initial = {name: (low, high) for name, low, high in initial_values(config_of(model.result))}
        measured: list[ExportedState | ExportedColumn] = [*description.states, *description.observed]
        self._measured = {
            state: np.concatenate([part.values[_key(state)] for part in trajectories if _key(state) in part.values])
            for state in measured
            if any(_key(state) in part.values for part in trajectories)
        }
        self._errors = {
            self._words[state]: _errors(model, state, self._words[state], values)
            for state, values in self._measured.items()
        }

    def conditions(self) -> Iterator[_Row]:
        """Yield for each trajectory the initial state, the inputs and, if the time is an input, the first time."""
        description = self._description
        inputs = [self._words[held] for held in description.held]
        clock = ["begin_time"] if description.depends_on_time else []
        yield "conditionId", "conditionName", *self._starts, *inputs, *clock
        for number, part in enumerate(self._trajectories, start=1):
            starts = [f"{name}_{number}" for name in self._starts]
            values = [_constant_input(part, held.name) for held in description.held]
            begin = [float(part.times[0]) for _ in clock]
            yield f"trajectory_{number}", part.name, *starts, *values, *begin

    def observables(self) -> Iterator[_Row]:
        """Yield the measured states with their errors."""
        yield "observableId", "observableFormula", "observableTransformation", "noiseFormula", "noiseDistribution"
        for name, (_, formula) in self._errors.items():
            yield f"observable_{name}", name, "lin", formula, "normal"

    def measurements(self) -> Iterator[_Row]:
        """Yield the measured values; missing values are left out."""
        yield "observableId", "simulationConditionId", "measurement", "time"
        for number, part in enumerate(self._trajectories, start=1):
            times = (part.times - part.times[0]).tolist()
            for state in self._measured:
                values = part.values[_key(state)].tolist() if _key(state) in part.values else ()
                for time, value in zip(times, values, strict=False):
                    if math.isfinite(value):
                        yield f"observable_{self._words[state]}", f"trajectory_{number}", value, time

    def parameters(self) -> Iterator[_Row]:
        """Yield the estimated numbers: constants, initial states, standard deviations of errors."""
        yield (
            *("parameterId", "parameterName", "parameterScale"),
            *("lowerBound", "upperBound", "nominalValue", "estimate"),
        )
        for constant in self._description.constants:
            low, high = _bounds(constant)
            yield self._words[constant], f"constant {constant.name}", "lin", low, high, constant.value, 1
        for number, part in enumerate(self._trajectories, start=1):
            for state, start, value in zip(self._description.states, self._starts, part.start, strict=True):
                reach = self._range(state)
                title = f"initial {state.column} of {part.name}"
                low, high = self._initial.get(state.column, (-math.inf, math.inf))
                is_given = low == high
                low = low if math.isfinite(low) and not is_given else value - reach
                high = high if math.isfinite(high) and not is_given else value + reach
                yield f"{start}_{number}", title, "lin", low, high, value, int(not is_given)
        for each in self._measured:
            name = self._words[each]
            sd, _ = self._errors[name]
            yield f"sd_{name}", f"errors of {_key(each)}", "log10", sd / _REACH, sd * _REACH, sd, 1

    def _range(self, state: ExportedState) -> float:
        """Return the range of a state in all trajectories; for a hidden state, the range of its simulations; for
        another unmeasured state, the range of all slopes."""
        values = self._measured.get(state)
        curves = [(part.values or {}).get(state.column) for part in self._model.result.simulated]
        if values is None and state.column in self._model.result.unmeasured and any(curves):
            values = np.concatenate([values_of_curve(curve) for curve in curves if curve])
        if values is None:
            parts = [(part.times, curve) for part in self._trajectories for curve in part.values.values()]
            values = np.concatenate([np.gradient(curve, times) for times, curve in parts])
        return float(np.nanmax(values) - np.nanmin(values)) or 1.0


def _key(state: ExportedState | ExportedColumn) -> str:
    """Return the name of a state or an observed column in the values of a trajectory."""
    return state.column if isinstance(state, ExportedColumn) else state.name


def _errors(
    model: ModelCore, state: ExportedState | ExportedColumn, name: str, values: FloatArray
) -> tuple[float, str]:
    """Return the standard deviation of the measurement errors of a state, and the noise formula of PEtab.

    A share of the variance may be proportional to the square of the state over the mean square of its measured values.
    """
    noise = model.result.noise.get(state.column) or Noise()
    errors = noise.errors or Errors()
    size = float(np.sqrt(np.nanmean(values**2))) or 1.0
    rounding = float(np.spacing(size))
    sd = next((sd for sd in (errors.sd, noise.sd) if sd and sd > rounding), rounding)
    share = errors.proportional or 0.0
    growth = f" * sqrt({1.0 - share!r} + {share!r} * ({name} / {size!r})^2)" if share else ""
    return sd, f"sd_{name}{growth}"


def _constant_input(part: PetabTrajectory, name: str) -> float:
    """Return the value of a constant input along a trajectory; raises UsageError if it is unknown or changes."""
    values = np.unique(part.inputs.get(name, ()))
    if len(values) != 1 or not np.isfinite(values[0]):
        fault = "is not known" if not len(values) else "changes"
        raise UsageError(f"the input '{name}' {fault} along trajectory {part.name}; PEtab needs constant inputs")
    return float(values[0])


def _bounds(constant: Parameter) -> tuple[float, float]:
    """Return the bounds of a constant: the user's bounds; an open side gets a multiple of its standard error."""
    reach = _REACH * (constant.stderr or abs(constant.value) or 1.0)
    low, high = constant.bounds or (None, None)
    return constant.value - reach if low is None else low, constant.value + reach if high is None else high
