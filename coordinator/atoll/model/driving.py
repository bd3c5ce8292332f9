"""Inputs of a simulation as functions of time: as users give them, else as they were recorded.

Letters: U inputs, N times.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from atoll.model.arguments import has, has_columns, number, numbers
from atoll.model.simulation import Inputs
from atoll_coordinator.data.differentiation.inputs import InputCurve
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.quoting import did_you_mean

if TYPE_CHECKING:
    from atoll.model.model import Model

_Course = Callable[[float], npt.ArrayLike]
_ByName = Mapping[str, npt.ArrayLike | _Course]
GivenInputs = _ByName | npt.ArrayLike | _Course | None
"""By name numbers, arrays or functions of time; an array (N, U); or a function of time that returns U numbers."""


@dataclass(frozen=True, eq=False)
class Driving:
    """All inputs (U,) of a simulation as one function of time."""

    courses: Sequence[Callable[[float], float]]

    def __call__(self, t: float) -> FloatArray:
        """Return the inputs at a time."""
        return np.array([course(t) for course in self.courses], dtype=np.float64)

    @cached_property
    def jumps(self) -> FloatArray:
        """The times at which a held input changes, ascending."""
        parts = [course.jumps for course in self.courses if isinstance(course, InputCurve)]
        return np.unique(np.concatenate(parts)) if parts else np.zeros(0)


def require_inputs(model: "Model", names: Iterable[str]) -> None:
    """Raise UsageError where one of `names`, symbols or columns, is no input."""
    symbols = model.result.symbols
    unknown = next((name for name in names if symbols.get(name, name) not in model.inputs), None)
    if unknown is not None:
        hint = did_you_mean(str(unknown), model.inputs)
        raise UsageError(f"there is no input {unknown!r}; the inputs are {', '.join(model.inputs) or 'none'}{hint}")


def inputs_along(
    model: "Model", u: GivenInputs, times: FloatArray, recorded: Mapping[str, InputCurve]
) -> Inputs | None:
    """Return all inputs as one function of time, those that `u` lacks as `recorded`; None of a model without inputs.

    Raises:
        UsageError: a name is no input, an input is not known, or a number of values does not fit.
    """
    if isinstance(u, Mapping):
        require_inputs(model, u)
    if not model.inputs:
        return None
    if callable(u):
        return lambda t: np.atleast_1d(numbers(u(t), "what u returns"))
    given: _ByName = {}
    if has_columns(u):
        given = u
    elif u is not None:
        given = dict(zip(model.inputs, _rows(model, u, times).T, strict=True))
    return Driving([_input(model, name, given, times, recorded.get(name)) for name in model.inputs])


def _rows(model: "Model", u: object, times: FloatArray) -> FloatArray:
    values = numbers(u, "inputs")
    values = values.reshape(len(times), -1) if values.ndim and len(values) == len(times) else values
    if values.shape != (len(times), len(model.inputs)):
        shape = f"({len(times)}, {len(model.inputs)})"
        raise UsageError(f"inputs have the shape {values.shape}, expected {shape}: rows by {model.inputs}")
    return values


def _input(
    model: "Model", name: str, given: _ByName, times: FloatArray, recorded: InputCurve | None
) -> Callable[[float], float]:
    column = model.result.columns_by_symbol[name]
    key = next((key for key in (name, column) if has(given, key)), None)
    if key is None:
        if column == model.time:
            return lambda t: t
        if recorded is not None:
            return recorded
        raise UsageError(
            f"the model has the input {name!r}, of which nothing is given",
            python="name it in u",
            command=f"give a number, such as --hold {name}=1, or a file with its column as --initial",
        )
    value = given[key]
    if isinstance(value, InputCurve):
        return value
    if callable(value):
        return lambda t: number(value(t), f"what the function of the input {name!r} returns")
    values = numbers(value, f"the input {name!r}")
    if values.ndim == 0:
        return lambda _: float(values)
    if values.shape != times.shape:
        raise UsageError(f"the input {name!r} has {values.size} values for {len(times)} times; give one for each")
    return InputCurve.through(times, values, model.input_kind(name))
