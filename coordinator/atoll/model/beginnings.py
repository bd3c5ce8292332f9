"""Where a simulation begins and at which times it is wanted: as users say, else as was measured.

Letters: D states, N rows or times.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from atoll.model.arguments import number, numbers, rows_of
from atoll_coordinator.data.differentiation.inputs import InputCurve
from atoll_coordinator.result.base import Number
from atoll_coordinator.result.listed_trajectories import Recorded, Simulated
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.quoting import did_you_mean

if TYPE_CHECKING:
    from atoll.model.model import Model

ROWS: Final = 501
"""Times of a simulation whose end alone is given."""

Given = Mapping[str, float] | Sequence[float] | FloatArray
"""Numbers by name, or in the order of the states or inputs."""


@dataclass(frozen=True, eq=False)
class Beginning:
    """The beginning of a trajectory: its `name`, its initial state by column, its `times` (N,); empty where unknown."""

    name: str | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    times: FloatArray = field(default_factory=lambda: np.empty(0))


def beginning_of(model: "Model") -> Beginning:
    """Return that of the first simulated trajectory, of the ensemble of a process, else of the first measured one."""
    result = model.result
    for part in result.simulated:
        if part.start:
            return Beginning(part.name, _known(part.start), values_of_curve(part.times))
    if result.process is not None and result.process.ensemble is not None:
        ensemble = result.process.ensemble
        start = {name: curve[0] for name, curve in ensemble.mean.items() if curve}
        return Beginning(ensemble.trajectory, _known(start), values_of_curve(ensemble.times))
    measured = (measured_beginning(model, part) for part in result.recorded)
    return next(filter(None, measured), Beginning())


def measured_beginning(model: "Model", part: Recorded | Simulated) -> Beginning | None:
    """Return that of the whole rows of a measured trajectory; None where no row has all states."""
    columns = {name: values_of_curve(curve) for name, curve in part.measured.items()}
    times = values_of_curve(part.times)
    known = np.flatnonzero(np.isfinite([times, *columns.values()]).all(axis=0))
    if not len(known):
        return None
    rows = {name: values[known] for name, values in {model.time: times, **columns}.items()}
    names = model.result.columns_by_symbol
    start = {names[name]: value for name, value in rows_of(model, rows)[2].items()}
    return Beginning(part.name, start, rows[model.time])


def recorded_inputs(model: "Model") -> dict[str, InputCurve]:
    """Return the inputs recorded along the first trajectory, by symbol."""
    name = beginning_of(model).name
    part = next((part for part in model.result.recorded if part.name == name), None)
    return {} if part is None else input_curves(model.result, part)


def input_curves(result: Result, part: Recorded) -> dict[str, InputCurve]:
    """Return the inputs recorded along a trajectory, by symbol, between rows as the fit has taken them."""
    times, symbols, curves = values_of_curve(part.times), result.symbols, {}
    for column, values in part.inputs.items():
        known = np.isfinite(measured := values_of_curve(values))
        kind, slopes = result.columns.input_kinds.get(column), (part.input_slopes or {}).get(column)
        if not known.any():
            continue
        fitted = None if slopes is None else values_of_curve(slopes)[known]
        is_fitted = fitted is not None and (kind == "held" or np.isfinite(fitted).all())
        curve = InputCurve.through(times[known], measured[known], kind)
        curves[symbols.get(column, column)] = (
            replace(curve, slopes=fitted) if is_fitted and fitted is not None else curve
        )
    return curves


def start_of(model: "Model", x0: Given | None) -> FloatArray:
    """Return the initial state (D,) that is given, else the one that was measured; raises UsageError."""
    given = beginning_of(model).start if x0 is None else x0
    if x0 is None and not given:
        example = model.states[0]
        raise UsageError(
            "the result has no fitted initial state",
            python=f"give one, such as x0={{{example!r}: 1.0}}",
            command=f"give one, such as --initial {example}=1",
        )
    if not isinstance(given, Mapping):
        values = numbers(given, "an initial state")
        if values.shape != (len(model.states),):
            raise UsageError(f"an initial state has one number for each of {', '.join(model.states)}")
        return values
    symbols = model.result.symbols
    named = {symbols.get(name, name): value for name, value in given.items()}
    _require_states(model, named)
    return np.array([number(named[name], f"the initial value of {name!r}") for name in model.states])


def _require_states(model: "Model", named: Mapping[str, object]) -> None:
    unknown = next((name for name in named if name not in model.states), None)
    missing = next((name for name in model.states if name not in named), None)
    known = f"the states are {', '.join(model.states)}"
    if unknown is not None:
        hint = did_you_mean(unknown, model.states)
        raise UsageError(f"the initial state names {unknown!r}; {known}{hint}")
    if missing is not None:
        raise UsageError(f"the initial state lacks {missing!r}; {known}")


def times_of(model: "Model", t: npt.ArrayLike | float | None) -> FloatArray:
    """Return the times (N,) that are given, else those that were measured; raises UsageError."""
    first = beginning_of(model).times
    if t is None:
        if not len(first):
            raise UsageError(
                "the result has no simulated trajectory",
                python="give the times, such as t=10.0",
                command="give the last time, such as --until 10",
            )
        return first
    times = numbers(t, "times")
    if times.ndim:
        return times
    begin = float(first[0]) if len(first) else 0.0
    if not float(times) > begin:
        raise UsageError(f"a simulation begins at {model.time} = {begin:g} and ends later, but {t!r} was given")
    return np.linspace(begin, float(times), ROWS)


def values_of_curve(curve: Sequence[Number]) -> FloatArray:
    """Return a curve as an array, NaN where it is not known."""
    return np.array(curve, dtype=np.float64)


def _known(start: Mapping[str, float | None]) -> dict[str, float]:
    return {name: value for name, value in start.items() if value is not None}
