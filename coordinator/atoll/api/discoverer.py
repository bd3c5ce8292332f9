"""`Discoverer`: finds dx/dt = f(x, u), with PySINDy's conventions. Letters in shapes: N rows, D states, U inputs."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Self, cast

import numpy as np
import numpy.typing as npt
from pydantic import JsonValue

from atoll.api.discover import discover
from atoll.api.model import Model
from atoll.api.tables import numbers_of
from atoll.model.arguments import GivenInputs, numbers, read_columns
from atoll.model.equations import DIGITS, run_names
from atoll.model.given_sides import fitted_parameters
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import DataError, UsageError
from atoll_core.redaction import without_secrets

_TIME = "t"


class Discoverer:
    """Finds the equations of motion of measured states; takes the options of `atoll.discover`.

    After `fit`: `model_` is the `atoll.Model`, `equations_` has its right-hand sides by state, `front_` has the best
    expression of each size with its errors by state, `parameters_` has the values of the parameters of a template by
    name, `feature_names_in_` has the names of states and inputs,
    `n_features_in_` is the number of states.
    """

    def __init__(self, **options: object) -> None:
        """Set the options of `atoll.discover`, such as ``seed``, ``operators``, ``connect``, ``progress``."""
        self._options = dict(options)
        self.model_: Model | None = None

    def get_params(self, deep: bool = True) -> dict[str, object]:
        """Return the options, as tools of scikit-learn expect."""
        del deep
        return dict(self._options)

    def set_params(self, **options: object) -> Self:
        """Change options."""
        self._options |= options
        return self

    def __repr__(self) -> str:
        options = ", ".join(f"{name}={value!r}" for name, value in self._options.items())
        return without_secrets(f"Discoverer({options})")  # notebooks store the text

    def fit(
        self,
        x: npt.ArrayLike,
        t: npt.ArrayLike = 1.0,
        u: npt.ArrayLike | None = None,
        x_dot: npt.ArrayLike | None = None,
        feature_names: Sequence[str] | None = None,
    ) -> Self:
        """Find the equations.

        Args:
            x: states (N, D), as an array or a frame, or a list of these, one for each trajectory.
            t: times (N,), or the time between rows, or a list of these, one for each trajectory.
            u: inputs (N, U), or a list of these, one for each trajectory.
            x_dot: measured derivatives, in the form of `x`.
            feature_names: names of states, then inputs; None: the columns of frames, else x0, x1, … and u0, u1, ….

        Raises:
            DataError: the arrays do not match, or cannot be used.
            UsageError: an option is wrong.
        """
        names, inputs = _names(_parts(x)[0], None if u is None else _parts(u)[0], feature_names)
        dots = [f"{name}_dot" for name in names]
        trajectories = []
        for states, times, controls, slopes in _trajectories(x, t, u, x_dot):
            columns = {_TIME: times} | _columns(states, names, len(times), "x")
            if controls is not None:
                columns |= _columns(controls, inputs, len(times), "u")
            if slopes is not None:
                columns |= _columns(slopes, dots, len(times), "x_dot")
            trajectories.append(columns)
        roles: dict[str, object] = {"time": _TIME, "states": names, "inputs": inputs or None}
        if x_dot is not None:
            roles["derivatives"] = dots
        options: dict[str, Any] = {**roles, **self._options}  # `discover` checks each option
        self.model_ = discover(trajectories, **options)
        self.n_features_in_ = len(names)
        self.feature_names_in_ = np.array([*names, *inputs], dtype=object)
        return self

    @property
    def equations_(self) -> dict[str, str]:
        """The right-hand side of each state, with rounded constants."""
        return {equation.variable: equation.expression for equation in self._model.equations}

    @property
    def front_(self) -> dict[str, list[Mapping[str, JsonValue]]]:
        """The best expression of each complexity with its errors, by state."""
        equations = self._model.result.equations
        return {
            equation.variable: [member.model_dump(mode="json") for member in equation.front] for equation in equations
        }

    @property
    def parameters_(self) -> dict[str, float]:
        """The fitted values of the parameters of a template and of observed columns, by name; empty without them.

        A parameter that differs by run has a value for each: ``l[run 2]``.
        """
        params, result = self._model.params, self._model.result
        by_run = [name for equation in result.equations for name in run_names(equation)]
        return {name: params[name].value for name in (*fitted_parameters(result), *by_run)}

    def equations(self, precision: int = DIGITS) -> list[str]:
        """Return the right-hand sides, with constants of `precision` significant digits."""
        from atoll_core.expression.text.infix import to_infix
        from atoll_core.expression.text.parsing import from_infix

        names = list(self._model.result.names)
        return [
            to_infix(from_infix(equation.exact, names), names, digits=precision, is_given=equation.given is not None)
            for equation in self._model.equations
        ]

    def print(self, precision: int = DIGITS) -> None:
        """Print the equations."""
        for equation, text in zip(self._model.equations, self.equations(precision), strict=True):
            sys.stdout.write(f"{equation.lhs} = {text}\n")

    def predict(
        self, x: npt.ArrayLike, u: npt.ArrayLike | None = None, *, group: object = None
    ) -> FloatArray | list[FloatArray]:
        """Return the derivatives (N, D) at states (N, D), or a list of arrays for a list.

        Angles in `x` are read as in `fit`; results have radians. `group`: the group whose constants are used; with
        ``per_trajectory=True``, the number of a trajectory, from 1.
        """
        model = self._of(group)
        if isinstance(x, (list, tuple)) and np.ndim(x[0]) == 2:
            inputs = [None] * len(x) if u is None else _matching_parts(u, len(x), "u")
            return [
                model.predict(*self._as_in_fit(_rows(part), _rows_if_any(inputs[index])))
                for index, part in enumerate(x)
            ]
        return model.predict(*self._as_in_fit(_rows(x), _rows_if_any(u)))

    def simulate(
        self, x0: npt.ArrayLike, t: npt.ArrayLike, u: GivenInputs = None, *, group: object = None
    ) -> FloatArray:
        """Return the states (N, D) at the times `t` (N,) from `x0` (D,); NaN after an early end (see
        `model_.simulate`).

        For `group` see `predict`.
        """
        times = np.atleast_1d(numbers(t, "times"))
        simulation = self._of(group).simulate(numbers(x0, "an initial state"), times, u, has_bands=False)
        states = np.full((len(times), simulation.x.shape[1]), np.nan)
        states[: len(simulation.x)] = simulation.x
        return states

    def score(
        self,
        x: npt.ArrayLike,
        t: npt.ArrayLike = 1.0,
        u: npt.ArrayLike | None = None,
        x_dot: npt.ArrayLike | None = None,
        *,
        group: object = None,
    ) -> float:
        """Return the mean R2 of the predicted derivatives.

        They are compared with `x_dot`; if it is None, with finite differences of `x`.

        For `group` see `predict`.
        """
        measured, predicted = [], []
        for states, times, controls, slopes in _trajectories(x, t, u, x_dot):
            read, read_controls = self._as_in_fit(states, controls)
            measured.append(np.gradient(read, times, axis=0) if slopes is None else self._slopes_as_read(slopes))
            predicted.append(self._of(group).predict(read, read_controls))
        all_measured, all_predicted = np.concatenate(measured), np.concatenate(predicted)
        left = ((all_measured - all_predicted) ** 2).sum(axis=0)
        spread = ((all_measured - all_measured.mean(axis=0)) ** 2).sum(axis=0)
        return float(np.mean(1.0 - left / np.where(spread > 0.0, spread, np.inf)))

    def _as_in_fit(self, x: FloatArray, u: FloatArray | None) -> tuple[FloatArray, FloatArray | None]:
        """Return states (N, D) and inputs (N, U) as `fit` reads them: angles in radians, unwrapped."""
        model, columns = self._model, self._model.result.columns_by_symbol
        states, inputs = ([columns.get(name, name) for name in names] for names in (model.states, model.inputs))
        return self._read(x, states), None if u is None else self._read(u, inputs)

    def _slopes_as_read(self, slopes: FloatArray) -> FloatArray:
        derivatives = self._model.result.data_settings.get("derivatives")
        return self._read(slopes, [str(name) for name in derivatives]) if isinstance(derivatives, list) else slopes

    def _read(self, rows: FloatArray, names: Sequence[str]) -> FloatArray:
        if len(names) != rows.shape[1]:
            return rows  # a later check refuses it and names the expected number of columns
        columns = read_columns(self._model, dict(zip(names, rows.T, strict=True)))
        return np.column_stack([np.asarray(columns[name]) for name in names])

    def _of(self, group: object) -> Model:
        return self._model if group is None else self._model.of_group(group)

    @property
    def _model(self) -> Model:
        if self.model_ is None:
            raise UsageError("this Discoverer has no model yet; call fit first")
        return self.model_


def _parts(x: npt.ArrayLike) -> list[npt.ArrayLike]:
    """Return the trajectories in a list of arrays; a list of rows of numbers is one trajectory."""
    if not isinstance(x, (list, tuple)):
        return [x]
    if not x:
        raise DataError("the list of trajectories is empty; give one array for each trajectory")
    return (
        [x] if all(np.ndim(row) == 0 or (isinstance(row, (list, tuple)) and np.ndim(row) == 1) for row in x) else [*x]
    )


def _trajectories(
    x: npt.ArrayLike, t: npt.ArrayLike, u: npt.ArrayLike | None, x_dot: npt.ArrayLike | None
) -> Iterator[tuple[FloatArray, FloatArray, FloatArray | None, FloatArray | None]]:
    """Yield states (N, D), times (N,), inputs (N, U) and derivatives (N, D) of each trajectory."""
    parts = _parts(x)
    beside = [
        None if given is None else _matching_parts(given, len(parts), what)
        for given, what in ((u, "u"), (x_dot, "x_dot"))
    ]
    has_own_times = isinstance(t, (list, tuple)) and len(t) == len(parts) and np.ndim(t[0]) == 1
    for index, part in enumerate(parts):
        states = _rows(part)
        times = _times(cast(Sequence[npt.ArrayLike], t)[index] if has_own_times else t, len(states))
        controls, slopes = (None if given is None else _rows(given[index]) for given in beside)
        yield states, times, controls, slopes


def _matching_parts(given: npt.ArrayLike, count: int, what: str) -> list[npt.ArrayLike]:
    """Return the arrays of `count` trajectories; raises DataError."""
    parts = _parts(given)
    if len(parts) != count:
        raise DataError(f"{what} has {len(parts)} arrays, but x has {count} trajectories; give one array for each")
    return parts


def _rows(part: npt.ArrayLike) -> FloatArray:
    rows = numbers_of(part, "an array")
    rows = rows[:, np.newaxis] if rows.ndim == 1 else rows
    if rows.ndim != 2:
        raise DataError(f"an array has the shape {rows.shape}; rows by columns are expected")
    return rows


def _rows_if_any(part: npt.ArrayLike | None) -> FloatArray | None:
    return None if part is None else _rows(part)


def _times(t: npt.ArrayLike, rows: int) -> FloatArray:
    times = numbers(t, "times")
    if times.ndim == 0:
        return np.asarray(float(times) * np.arange(rows), dtype=np.float64)
    if times.shape != (rows,):
        raise DataError(
            f"t has {times.size} times, but x has {rows} rows; give one time for each row, or the time between rows"
        )
    return times


def _columns(values: FloatArray, names: Sequence[str], rows: int, what: str) -> dict[str, FloatArray]:
    if values.shape != (rows, len(names)):
        raise DataError(f"{what} has the shape {values.shape}, but ({rows}, {len(names)}) is expected")
    return dict(zip(names, values.T, strict=True))


def _names(x: npt.ArrayLike, u: npt.ArrayLike | None, given: Sequence[str] | None) -> tuple[list[str], list[str]]:
    """Return the names of states and of inputs."""
    states, inputs = _rows(x).shape[1], 0 if u is None else _rows(u).shape[1]
    if given is not None:
        if len(given) != states + inputs:
            raise UsageError(f"feature_names has {len(given)} names for {states} states and {inputs} inputs")
        return list(given[:states]), list(given[states:])
    return _own(x, "x", states), _own(u, "u", inputs)


def _own(part: npt.ArrayLike | None, letter: str, count: int) -> list[str]:
    columns = getattr(part, "columns", None)
    return [f"{letter}{index}" for index in range(count)] if columns is None else [str(column) for column in columns]
