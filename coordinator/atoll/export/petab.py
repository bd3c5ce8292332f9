"""PEtab 1: a folder of SBML, measurements, noise and bounds, for pyPESTO, AMICI, Data2Dynamics and COPASI.

Each trajectory is a condition with an initial state of its own, which is estimated, as are the constants. Simulations
of PEtab begin at time 0: times are counted from the beginning of their trajectory.
"""

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from atoll.export import sbml
from atoll.export.description import Description, State, describe
from atoll.export.formats import require_holds
from atoll.export.language import Wording
from atoll.model.arguments import Columns, inputs_of, rows_of
from atoll.model.beginnings import measured_beginning, values_of_curve
from atoll.model.parameters import Parameter
from atoll_coordinator.result.findings import Errors, Noise
from atoll_coordinator.result.listed_trajectories import Recorded, Simulated
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError

if TYPE_CHECKING:
    from atoll.model.model import Model

_REACH: Final = 10.0
"""Standard errors on either side of a constant that its bounds leave; where none is known, multiples of its size."""
_PROBLEM: Final = """\
format_version: 1
parameter_file: parameters.tsv
problems:
  - sbml_files: [model.xml]
    condition_files: [conditions.tsv]
    observable_files: [observables.tsv]
    measurement_files: [measurements.tsv]
"""

_CONDITIONS: Final = ("conditionId", "conditionName")
_OBSERVABLES: Final = (
    "observableId", "observableFormula", "observableTransformation", "noiseFormula", "noiseDistribution",
)  # fmt: skip
_MEASUREMENTS: Final = ("observableId", "simulationConditionId", "measurement", "time")
_PARAMETERS: Final = (
    "parameterId", "parameterName", "parameterScale", "lowerBound", "upperBound", "nominalValue", "estimate",
)  # fmt: skip

Row = tuple[str | float, ...]


def export_petab(model: "Model", folder: str | Path, data: Sequence[Columns] | None = None) -> None:
    """Write a PEtab problem into a folder; see `atoll.Model.to_petab`."""
    start, times = (None, None) if data is None else _beginning(model, data)
    columns = model.result.columns_by_symbol
    placeholders = {name: 0.0 for name in model.inputs if columns[name] != model.time}
    description = describe(model, start, times, placeholders)
    require_holds(description, sbml.LANGUAGE)
    document = sbml.write(description, has_start_parameters=True)
    trajectories = _recorded(model) if data is None else _given(model, data)
    if not trajectories:
        raise UsageError(
            "the result holds no measurements of trajectories", python="give them as data", command="give --data FILE"
        )
    tables = _Tables(model, description, trajectories)
    files = {
        "conditions.tsv": _text((*_CONDITIONS, *tables.given), tables.conditions()),
        "observables.tsv": _text(_OBSERVABLES, tables.observables()),
        "measurements.tsv": _text(_MEASUREMENTS, tables.measurements()),
        "parameters.tsv": _text(_PARAMETERS, tables.parameters()),
    }
    save({"problem.yaml": _PROBLEM, "model.xml": document, **files}, folder)


def save(files: Mapping[str, str], folder: str | Path) -> None:
    """Write files into a folder, which is made; raises UsageError."""
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            (Path(folder) / name).write_text(text, "utf-8")
    except OSError as error:
        raise UsageError(f"{folder} cannot be written ({error.strerror}); name another folder") from error


# ------------------------------------------------------------------------------------------------------ measurements


@dataclass(frozen=True, eq=False)
class Trajectory:
    """What was measured along one: `times` (N,), `values` (N,) by state, NaN where missing; `start` (D,) fitted.

    `inputs` are the values (N,) of inputs, by name.
    """

    name: str
    times: FloatArray
    values: Mapping[str, FloatArray]
    start: tuple[float, ...]
    inputs: Mapping[str, FloatArray]


def _recorded(model: "Model") -> list[Trajectory]:
    """Return the measurements that a result holds, without held-out trajectories, from their fitted initial states.

    A trajectory without a fitted one begins at its first row that has every state.
    """
    starts = {part.name: part.start for part in model.result.simulated if part.start}
    parts = model.result.recorded or model.result.simulated
    trajectories = (_trajectory(model, part, starts.get(part.name)) for part in parts if not part.held_out)
    return [trajectory for trajectory in trajectories if trajectory is not None]


def _trajectory(
    model: "Model", part: Recorded | Simulated, fitted: Mapping[str, float | None] | None
) -> Trajectory | None:
    """Return the measured rows of a trajectory from its initial state on; None where it has none."""
    if not part.measured:
        return None
    times, start, first = values_of_curve(part.times), fitted, 0
    if start is None:
        beginning = measured_beginning(model, part)
        if beginning is None:
            return None
        start, first = beginning.start, int(np.searchsorted(times, beginning.times[0]))
    symbols = model.result.symbols
    recorded = part.inputs if isinstance(part, Recorded) else {}
    values, inputs = (
        {symbols[name]: values_of_curve(curve)[first:] for name, curve in curves.items()}
        for curves in (part.measured, recorded)
    )
    named = {symbols[name]: np.nan if value is None else value for name, value in start.items()}
    return Trajectory(part.name, times[first:], values, tuple(named[name] for name in model.states), inputs)


def _given(model: "Model", data: Sequence[Columns]) -> list[Trajectory]:
    """Return measurements that are given, each with the initial state of its first row."""
    trajectories = []
    for number, part in enumerate(data, start=1):
        times, values, start = rows_of(model, part)
        first = tuple(start[name] for name in model.states)
        trajectories.append(Trajectory(str(number), times, values, first, inputs_of(model, part)))
    return trajectories


def _beginning(model: "Model", data: Sequence[Columns]) -> tuple[dict[str, float], FloatArray]:
    """Return the initial state and the times of the first trajectory of measurements that are given."""
    if not data:
        raise UsageError("no trajectory of measurements was given; give at least one")
    times, _, start = rows_of(model, data[0])
    return start, times


# ------------------------------------------------------------------------------------------------------------- noise


@dataclass(frozen=True)
class _Noise:
    """The errors of a state: standard deviation `sd`; `proportional` is the share of the variance that grows with the
    square of the state, `size` its root mean square.
    """

    sd: float
    proportional: float
    size: float

    @classmethod
    def of(cls, model: "Model", state: State, values: FloatArray) -> "_Noise":
        """Return those of the measured values of a state."""
        noise = model.result.noise.get(state.column) or Noise()
        errors = noise.errors or Errors()
        size = float(np.sqrt(np.nanmean(values**2))) or 1.0
        rounding = float(np.spacing(size))
        sd = next((sd for sd in (errors.sd, noise.sd) if sd and sd > rounding), rounding)
        return cls(sd, errors.proportional or 0.0, size)

    def formula(self, state: str) -> str:
        """Return the standard deviation as a formula of the model."""
        if not self.proportional:
            return f"sd_{state}"
        return f"sd_{state} * sqrt({1.0 - self.proportional!r} + {self.proportional!r} * ({state} / {self.size!r})^2)"


# ------------------------------------------------------------------------------------------------------------ tables


class _Tables:
    """The tables of a problem, row by row."""

    def __init__(self, model: "Model", description: Description, trajectories: Sequence[Trajectory]) -> None:
        self._description = description
        self._words = Wording(description, sbml.LANGUAGE)
        self._trajectories = trajectories
        self._measured = {
            state: np.concatenate([part.values[state.name] for part in trajectories if state.name in part.values])
            for state in description.states
            if any(state.name in part.values for part in trajectories)
        }
        self._noise = {state: _Noise.of(model, state, values) for state, values in self._measured.items()}

    @property
    def given(self) -> list[str]:
        """What conditions give the model: initial states, inputs, the time at which it begins."""
        starts = [sbml.start_name(self._words, state) for state in self._description.states]
        inputs = [self._words[held] for held in self._description.held]
        return [*starts, *inputs, *(["begin_time"] if self._description.depends_on_time else [])]

    def conditions(self) -> Iterator[Row]:
        """Yield the initial state and the inputs of each trajectory."""
        for number, part in enumerate(self._trajectories, start=1):
            starts = [f"{sbml.start_name(self._words, state)}_{number}" for state in self._description.states]
            inputs = [_constant_input(part, held.name) for held in self._description.held]
            begin = [float(part.times[0])] if self._description.depends_on_time else []
            yield f"trajectory_{number}", part.name, *starts, *inputs, *begin

    def observables(self) -> Iterator[Row]:
        """Yield the measured states with their errors."""
        for state, noise in self._noise.items():
            name = self._words[state]
            yield f"observable_{name}", name, "lin", noise.formula(name), "normal"

    def measurements(self) -> Iterator[Row]:
        """Yield the measured values, those that are missing left out."""
        for number, part in enumerate(self._trajectories, start=1):
            times = (part.times - part.times[0]).tolist()
            for state in self._measured:
                values = part.values[state.name].tolist() if state.name in part.values else ()
                for time, value in zip(times, values, strict=False):
                    if math.isfinite(value):
                        yield f"observable_{self._words[state]}", f"trajectory_{number}", value, time

    def parameters(self) -> Iterator[Row]:
        """Yield what is estimated: constants, initial states, standard deviations of errors."""
        for constant in self._description.constants:
            low, high = _bounds(constant)
            yield self._words[constant], f"constant {constant.name}", "lin", low, high, constant.value, 1
        for number, part in enumerate(self._trajectories, start=1):
            for state, value in zip(self._description.states, part.start, strict=True):
                name = f"{sbml.start_name(self._words, state)}_{number}"
                reach = self._width(state)
                title = f"{state.column} at the beginning of {part.name}"
                yield name, title, "lin", value - reach, value + reach, value, 1
        for state, noise in self._noise.items():
            name, title = f"sd_{self._words[state]}", f"errors of {state.name}"
            yield name, title, "log10", noise.sd / _REACH, noise.sd * _REACH, noise.sd, 1

    def _width(self, state: State) -> float:
        """Return how far a state has moved in all; of one that was not measured, how fast those that were have."""
        values = self._measured.get(state)
        if values is None:
            parts = [(part.times, curve) for part in self._trajectories for curve in part.values.values()]
            values = np.concatenate([np.gradient(curve, times) for times, curve in parts])
        return float(np.nanmax(values) - np.nanmin(values)) or 1.0


def _constant_input(part: Trajectory, name: str) -> float:
    """Return the value of an input along a trajectory; raises UsageError where it is not one."""
    values = np.unique(part.inputs.get(name, ()))
    if len(values) != 1 or not np.isfinite(values[0]):
        fault = "is not known" if not len(values) else "changes"
        raise UsageError(
            f"the input '{name}' {fault} along trajectory {part.name}; PEtab holds inputs that stay the same"
        )
    return float(values[0])


def _bounds(constant: Parameter) -> tuple[float, float]:
    """Return the bounds that were set for a constant, and on open sides those of its standard error."""
    reach = _REACH * (constant.stderr or abs(constant.value) or 1.0)
    low, high = constant.bounds or (None, None)
    return constant.value - reach if low is None else low, constant.value + reach if high is None else high


def _text(header: Sequence[str], rows: Iterator[Row]) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, delimiter="\t", lineterminator="\n")
    writer.writerow(header)
    writer.writerows([repr(value) if isinstance(value, float) else value for value in row] for row in rows)
    return stream.getvalue()
