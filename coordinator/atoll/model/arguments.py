"""What Python users give as numbers: single ones, intervals, and rows by the names of columns or in order.

What is none is named in one sentence, with what was expected. Letters: D states, U inputs, N rows.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeGuard

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.trajectories.measurements import RADIANS_PER_DEGREE
from atoll_coordinator.data.trajectories.trajectories import unwrap
from atoll_core.config import DataConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.frames import plain_array
from atoll_core.errors import UsageError
from atoll_core.quoting import shown

if TYPE_CHECKING:
    from atoll.model.model import Model

Columns = Mapping[str, npt.ArrayLike]
"""Measured columns by name; a frame of pandas or polars does as well."""


def numbers(given: object, what: str, expected: str = "numbers") -> FloatArray:
    """Return an array of real numbers of any shape; raises UsageError, which says `what` it was to be."""
    try:
        plain = plain_array(given)
        if given is not None and plain.dtype.kind in "biufO":
            return np.asarray(plain, dtype=np.float64)
    except (TypeError, ValueError):  # rows of different lengths, or objects that are no numbers
        pass
    raise UsageError(f"{what} must be {expected}, but {shown(given)} was given")


def number(given: object, what: str) -> float:
    """Return one number; raises UsageError."""
    value = numbers(given, what, "a number")
    if value.ndim:
        raise UsageError(f"{what} must be a number, but {shown(given)} was given")
    return float(value)


def interval(given: object, what: str) -> tuple[float, float]:
    """Return a lower and an upper bound; raises UsageError where it is no finite interval."""
    bounds = numbers(given, what, "two numbers")
    if bounds.shape != (2,):
        raise UsageError(f"{what} must be two numbers, such as (0.0, 1.0), but {shown(given)} was given")
    if not (np.isfinite(bounds).all() and bounds[0] < bounds[1]):
        raise UsageError(f"{what} must have a lower bound, then an upper one, but {shown(given)} was given")
    return float(bounds[0]), float(bounds[1])


def by_name(given: object, what: str) -> Mapping[str, object]:
    """Return a mapping from names, empty for None; raises UsageError."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise UsageError(f"{what} must be given by name, such as {{'x': 1.0}}, but {shown(given)} was given")
    return given


# ---------------------------------------------------------------------------------------------- rows and columns


@dataclass(frozen=True, eq=False)
class ReadColumns(Mapping[str, npt.ArrayLike]):
    """Columns of one trajectory as a fit reads them: full turns are taken out of angles, which are in radians.

    `factors` are what columns are multiplied by, `wrapped` the names of those that are unwrapped then.
    """

    given: Columns
    factors: Mapping[str, float] = field(default_factory=dict)
    wrapped: frozenset[str] = frozenset()

    def __getitem__(self, name: str) -> FloatArray:
        if not has(self.given, name):
            raise KeyError(name)
        values = column(self.given, name)
        if name in self.factors:
            values = values * self.factors[name]
        return unwrap(values) if name in self.wrapped and values.ndim == 1 else values

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and has(self.given, name)

    def __iter__(self) -> Iterator[str]:
        return iter(getattr(self.given, "columns", self.given))

    def __len__(self) -> int:
        return sum(1 for _ in self)


def read_columns(model: "Model", part: Columns) -> ReadColumns:
    """Return the measured columns of one trajectory as the fit of the model has read them.

    All that takes a table after the fit takes it through here.
    """
    if isinstance(part, ReadColumns):
        return part
    data, symbols = DataConfig.model_validate(model.result.data_settings), model.result.symbols
    angles = {angle.column: RADIANS_PER_DEGREE if angle.degrees else 1.0 for angle in data.angles}
    wrapped = {*angles, *(symbols[name] for name in angles if name in symbols)}
    factors = {**angles, **{symbols[name]: factor for name, factor in angles.items() if name in symbols}}
    states = model.result.columns.states
    factors |= {
        rate: angles[name] for name, rate in zip(states, data.derivatives or (), strict=False) if name in angles
    }
    return ReadColumns(part, factors, frozenset(wrapped))


def rows_of(model: "Model", part: Columns) -> tuple[FloatArray, dict[str, FloatArray], dict[str, float]]:
    """Return the times (N,) of measured rows, the measured states (N,) by name, and the state of the first row.

    Velocities of equations of second order that were not measured are those of the first rows.

    Raises:
        UsageError: a column is missing, or a state of the first row is.
    """
    columns, positions = model.result.columns_by_symbol, _positions(model)
    times = column(part, model.time)
    measured = [name for name in model.states if name not in positions or has(part, columns[name])]
    values = {name: column(part, columns[name]) for name in measured}
    stacked([times, *values.values()])
    start = {}
    for name in model.states:
        if name in values:
            start[name] = float(values[name][0]) if len(times) else np.nan
        else:
            start[name] = _slope(times, column(part, columns[positions[name]]), positions[name])
    unknown = next((name for name, value in start.items() if not np.isfinite(value)), None)
    if unknown is not None:
        raise UsageError(f"the first row has no finite {unknown!r}; begin with a row that has every state")
    return times, values, start


def inputs_of(model: "Model", part: Columns) -> dict[str, FloatArray]:
    """Return those inputs (N,) of measured rows that have a column, by name."""
    columns = model.result.columns_by_symbol
    return {name: column(part, columns[name]) for name in model.inputs if has(part, columns[name])}


def points_of(model: "Model", given: object, names: Sequence[str]) -> FloatArray:
    """Return rows (N, len(names)) from an array or from columns by name."""
    if has_columns(given):
        columns = model.result.columns_by_symbol
        return stacked([column(given, columns.get(name, name), name) for name in names]).T
    rows = numbers(given, f"rows of {', '.join(names)}")
    rows = rows[:, np.newaxis] if rows.ndim == 1 and len(names) == 1 else np.atleast_2d(rows)
    if rows.ndim != 2 or rows.shape[1] != len(names):
        raise UsageError(f"rows of {len(names)} numbers ({', '.join(names)}) are expected, found {rows.shape}")
    return rows


def has_columns(given: object) -> TypeGuard[Columns]:
    """Tell whether something has columns by name: a mapping, or a frame of pandas or polars."""
    return isinstance(given, Mapping) or hasattr(given, "columns")


def has(given: Mapping[str, object], name: str) -> bool:
    """Tell whether there is a column of this name."""
    return name in getattr(given, "columns", given) or _is_index(given, name)


def column(given: Columns, *names: str) -> FloatArray:
    """Return the column of the first of these names that there is; raises UsageError."""
    name = next((name for name in names if has(given, name)), None)
    if name is None:
        raise UsageError(f"the data have no column {names[0]!r}; give one, by that name")
    values = getattr(given, "index", None) if _is_index(given, name) else given[name]
    return numbers(values, f"column {name!r}")


def stacked(columns: Sequence[FloatArray]) -> FloatArray:
    """Return columns (N,) as one array (K, N); raises UsageError where their lengths differ."""
    shapes = {values.shape for values in columns}
    if len(shapes) > 1 or any(values.ndim != 1 for values in columns):
        lengths = sorted(str(values.shape[0] if values.ndim == 1 else values.shape) for values in columns)
        raise UsageError(f"columns have {', '.join(lengths)} rows; one number of rows is expected")
    return np.stack(columns)


def _is_index(given: object, name: str) -> bool:
    """Tell whether a name is that of the index of a pandas frame."""
    index = getattr(given, "index", None)
    return index is not None and not callable(index) and getattr(index, "name", None) == name


def _positions(model: "Model") -> dict[str, str]:
    """Return the position of each velocity of equations of second order, by name; empty for other models."""
    half = len(model.states) // 2
    is_second = all(equation.lhs.startswith(f"d2{equation.variable}/") for equation in model.result.equations)
    return dict(zip(model.states[half:], model.states[:half], strict=True)) if is_second else {}


def _slope(times: FloatArray, position: FloatArray, name: str) -> float:
    """Return the slope of a position (N,) at the first row, NaN where it is not known there; raises UsageError."""
    stacked([times, position])
    if len(times) < 3:
        raise UsageError(f"a velocity is estimated from 3 rows of {name!r} or more, but the data have {len(times)}")
    return float(np.gradient(position, times, edge_order=2)[0])
