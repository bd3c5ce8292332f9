"""PEtab 1: a folder of SBML, measurements, noise and bounds, for pyPESTO, AMICI, Data2Dynamics and COPASI.

Each trajectory is a condition with an initial state of its own, which is estimated, as are the constants. Simulations
of PEtab begin at time 0: times are counted from the beginning of their trajectory.
"""

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from atoll.export import sbml
from atoll.export.content import Content, Wording, content_of, inputs_beside_time, refuse_tables
from atoll.model.beginnings import measured_beginning, values_of_curve
from atoll.model.parameters import Parameter
from atoll.model.rows import inputs_of, rows_of
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

Row = dict[str, Any]


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


def write(model: "Model", content: Content, data: Sequence[Mapping[str, Any]] | None = None) -> dict[str, str]:
    """Return the files of a problem by name.

    Args:
        model: whose constants are estimated.
        content: of the same model.
        data: measured columns by name, for each trajectory; None: what the result holds, at most 200 rows of each.

    Raises:
        UsageError: the model has no time, is a process or has a table of an input; there are no measurements.
    """
    refuse_tables(content, "PEtab")
    document = sbml.write(content, sbml.Options(has_start_parameters=True))
    words = Wording(content, sbml.LANGUAGE)
    trajectories = _recorded(model) if data is None else _given(model, data)
    if not trajectories:
        raise UsageError(
            "the result holds no measurements of trajectories", python="give them as data", command="give --data FILE"
        )
    states = [each.name for each in content.states if any(each.name in its.values for its in trajectories)]
    noise = {name: _Noise.of(model, name, trajectories) for name in states}
    return {
        "problem.yaml": _PROBLEM,
        "model.xml": document,
        "conditions.tsv": _table(_conditions(content, words, trajectories)),
        "observables.tsv": _table(_observables(words, noise)),
        "measurements.tsv": _table(_measurements(words, states, trajectories)),
        "parameters.tsv": _table(_parameters(content, words, noise, trajectories)),
    }


def save(files: Mapping[str, str], folder: str | Path) -> None:
    """Write files into a folder, which is made; raises UsageError."""
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            (Path(folder) / name).write_text(text, "utf-8")
    except OSError as error:
        raise UsageError(f"{folder} cannot be written ({error.strerror}); name another folder") from error


# ------------------------------------------------------------------------------------------------------ measurements


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


def _given(model: "Model", data: Sequence[Mapping[str, Any]]) -> list[Trajectory]:
    """Return measurements that are given, each with the initial state of its first row."""
    trajectories = []
    for number, part in enumerate(data, start=1):
        times, values, start = rows_of(model, part)
        inputs = inputs_of(model, part)
        trajectories.append(Trajectory(str(number), times, values, tuple(start[name] for name in model.states), inputs))
    return trajectories


def beginning(model: "Model", data: Sequence[Mapping[str, Any]]) -> tuple[dict[str, float], FloatArray]:
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
    def of(cls, model: "Model", state: str, trajectories: Sequence[Trajectory]) -> "_Noise":
        noise = model.result.noise.get(model.result.columns_by_symbol.get(state, state)) or Noise()
        errors = noise.errors or Errors()
        values = np.concatenate([part.values[state] for part in trajectories if state in part.values])
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


def _conditions(content: Content, words: Wording, trajectories: Sequence[Trajectory]) -> Iterable[Row]:
    has_time = any(each.kind == "time" for each in content.inputs)
    for number, part in enumerate(trajectories, start=1):
        row: Row = {"conditionId": f"trajectory_{number}", "conditionName": part.name}
        for state in content.states:
            name = sbml.start_name(words, state.name)
            row[name] = f"{name}_{number}"
        row |= {words[each.name]: _constant_input(part, each.name) for each in content.held}
        yield row | ({"begin_time": float(part.times[0])} if has_time else {})


def _constant_input(part: Trajectory, name: str) -> float:
    """Return the value of an input along a trajectory; raises UsageError where it is not one."""
    values = np.unique(part.inputs.get(name, ()))
    if len(values) != 1 or not np.isfinite(values[0]):
        found = "is not known" if not len(values) else "changes"
        raise UsageError(
            f"the input '{name}' {found} along trajectory {part.name}; PEtab holds inputs that stay the same"
        )
    return float(values[0])


def _observables(words: Wording, noise: Mapping[str, _Noise]) -> Iterable[Row]:
    for state, its in noise.items():
        yield {
            "observableId": f"observable_{words[state]}",
            "observableFormula": words[state],
            "observableTransformation": "lin",
            "noiseFormula": its.formula(words[state]),
            "noiseDistribution": "normal",
        }


def _measurements(words: Wording, states: Sequence[str], trajectories: Sequence[Trajectory]) -> Iterable[Row]:
    for number, part in enumerate(trajectories, start=1):
        for state in states:
            times = (part.times - part.times[0]).tolist()
            for time, value in zip(times, part.values[state].tolist() if state in part.values else (), strict=False):
                if math.isfinite(value):
                    yield {
                        "observableId": f"observable_{words[state]}",
                        "simulationConditionId": f"trajectory_{number}",
                        "measurement": value,
                        "time": time,
                    }


def _parameters(
    content: Content, words: Wording, noise: Mapping[str, _Noise], trajectories: Sequence[Trajectory]
) -> Iterable[Row]:
    for constant in content.constants:
        yield _parameter(words[constant], f"constant {constant.name}", constant.value, _bounds(constant))
    for number, part in enumerate(trajectories, start=1):
        for state, value in zip(content.states, part.start, strict=True):
            name = f"{sbml.start_name(words, state.name)}_{number}"
            title = f"{state.column} at the beginning of {part.name}"
            reach = _width(state.name, trajectories)
            yield _parameter(name, title, value, (value - reach, value + reach))
    for state_name, its in noise.items():
        bounds = (its.sd / _REACH, its.sd * _REACH)
        yield _parameter(f"sd_{words[state_name]}", f"errors of {state_name}", its.sd, bounds, "log10")


def _width(state: str, trajectories: Sequence[Trajectory]) -> float:
    """Return how far a state has moved in all; of one that was not measured, how fast those that were have."""
    values = [part.values[state] for part in trajectories if state in part.values]
    if not values:
        values = [np.gradient(its, part.times) for part in trajectories for its in part.values.values()]
    found = np.concatenate(values)
    return float(np.nanmax(found) - np.nanmin(found)) or 1.0


def _bounds(its: Parameter) -> tuple[float, float]:
    """Return the bounds that were set for a constant, and on open sides those of its standard error."""
    reach = _REACH * (its.stderr or abs(its.value) or 1.0)
    low, high = its.bounds or (None, None)
    return its.value - reach if low is None else low, its.value + reach if high is None else high


def _parameter(name: str, title: str, value: float, bounds: tuple[float, float], scale: str = "lin") -> Row:
    return {
        "parameterId": name,
        "parameterName": title,
        "parameterScale": scale,
        "lowerBound": bounds[0],
        "upperBound": bounds[1],
        "nominalValue": value,
        "estimate": 1,
    }


def _table(rows: Iterable[Row]) -> str:
    its = list(rows)
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(its[0]), delimiter="\t", lineterminator="\n")
    writer.writeheader()
    for row in its:
        writer.writerow({name: repr(value) if isinstance(value, float) else value for name, value in row.items()})
    return stream.getvalue()


def export_petab(model: "Model", folder: str | Path, data: Sequence[Mapping[str, Any]] | None = None) -> None:
    """Write a PEtab problem into a folder; see `atoll.Model.to_petab`."""
    start, times = (None, None) if data is None else beginning(model, data)
    placeholders = dict.fromkeys(inputs_beside_time(model), 0.0)
    save(write(model, content_of(model, start, times, placeholders), data), folder)
